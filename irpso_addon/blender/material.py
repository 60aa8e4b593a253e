"""Maps onto an object's materials: image datablocks and the nodes that show them.

This is the only file that writes ``bpy.data``.  Images and nodes made here are found again by what
they are, not by their names: nodes carry the custom property ``irpso`` (their role), and the object's
custom property ``irpso`` points to its images.  So running twice leaves one set, also after renaming.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import bpy
import numpy as np

from ..core.data import F32, Maps, Solution
from ..core.errors import BadInput
from ..core.export import write_maps as export_maps

TAG = "irpso"  # custom property on objects (their images) and nodes (their role)
SPECULAR_TAG = "irpso_specular"  # custom property on a Principled: its Specular IOR Level before we set it to 0
SUFFIXES = {"base_color": "basecolor"}  # role -> end of the name, where they differ
SOCKETS = {"base_color": "Base Color", "roughness": "Roughness"}
NAME_BYTES = 63  # of a datablock in Blender 4.5; 5.x allows more


def write_maps(
    obj: bpy.types.Object, solution: Solution, *, packed: bool = True, directory: Path | None = None,
) -> tuple[str, ...]:
    """Wires the maps of ``solution`` into Base Color and Roughness of every material slot it covers.

    The images are packed into the .blend, or, with ``packed`` False, saved as EXR files in ``directory``.
    Returns what the user should know, one line each.  Raises BadInput, before anything is changed, when
    the object or one of its materials cannot take the maps.
    """
    if obj.type != "MESH":
        raise BadInput(f"{obj.name}: is not a mesh; choose a mesh object")
    _require_editable(obj, "object")
    targets = _targets(obj, solution.model)
    for slot, _ in targets:
        _check_material(slot.material)
    if packed:
        images = write_images(obj, _layers(solution.maps))
    else:
        if directory is None:
            raise ValueError("packed=False needs a directory")
        images = _load_saved(obj, solution.maps, directory)
    messages: list[str] = []
    copies: dict[bpy.types.Material, bpy.types.Material] = {}
    models: dict[bpy.types.Material, str] = {}
    for slot, model in targets:
        models[_own_material(obj, slot, copies, messages)] = model
    for material, model in models.items():
        messages += [f"material '{material.name}': {text}" for text in _wire(material, images, model)]
    return tuple(messages)


# ---- images


def write_images(obj: bpy.types.Object, layers: Mapping[str, F32]) -> dict[str, bpy.types.Image]:
    """Float images ``<object>_<role>``, packed; ``layers`` holds (h, w) or (h, w, 3) arrays, row 0 bottom.

    Base colour is tagged Linear Rec.709, everything else Non-Color, so that nothing is converted.  An
    image of the same role that the object already has is replaced wherever it is used.
    """
    images = {}
    for role, array in layers.items():
        height, width = array.shape[:2]
        rgba = np.ones((height, width, 4), np.float32)
        rgba[..., :3] = array if array.ndim == 3 else array[..., None]
        image = bpy.data.images.new(obj.name, width, height, float_buffer=True, is_data=role != "base_color")
        _set_colorspace(image, role)
        image.pixels.foreach_set(rgba.ravel())
        image.update()
        image.pack()
        images[role] = _adopt(obj, role, image)
    return images


def _load_saved(obj: bpy.types.Object, maps: Maps, directory: Path) -> dict[str, bpy.types.Image]:
    """Saves the maps as EXR files and loads those."""
    images = {}
    paths = {path.stem.rsplit("_", 1)[1]: path for path in export_maps(maps, obj.name, directory, "exr")}
    for role in _layers(maps):
        path = str(paths[SUFFIXES.get(role, role)].resolve())
        image = bpy.data.images.load(path)
        if bpy.data.filepath:
            image.filepath = bpy.path.relpath(path)
        _set_colorspace(image, role)
        images[role] = _adopt(obj, role, image)
    return images


def _layers(maps: Maps) -> dict[str, F32]:
    return {
        "base_color": maps.base_color, "roughness": maps.roughness,
        "confidence": maps.confidence, "error": maps.error,
    }


def _set_colorspace(image: bpy.types.Image, role: str) -> None:
    if role == "base_color":
        image.colorspace_settings.name = "Linear Rec.709"
    else:
        image.colorspace_settings.is_data = True


def _adopt(obj: bpy.types.Object, role: str, image: bpy.types.Image) -> bpy.types.Image:
    """Makes ``image`` the object's one image of this role: named, owned, in place of the one before."""
    if TAG not in obj:
        obj[TAG] = {}
    before = obj[TAG].get(role)
    # A duplicated object points to the images of its original: those are not ours to replace.
    shared = any(other is not obj and before in dict(other.get(TAG, {})).values() for other in bpy.data.objects)
    if before is not None and not shared:
        before.user_remap(image)
        bpy.data.images.remove(before)
    suffix = "_" + SUFFIXES.get(role, role)
    image.name = obj.name.encode()[: NAME_BYTES - len(suffix)].decode(errors="ignore") + suffix
    obj[TAG][role] = image  # counts as a user: confidence and error have no node that would keep them
    return image


# ---- materials


def _require_editable(data: bpy.types.ID, kind: str) -> None:
    if not data.is_editable:
        raise BadInput(f"{data.name}: this {kind} is linked from a library; make it local first (Object > Relations)")


def _targets(obj: bpy.types.Object, model: Mapping[str, str]) -> list[tuple[bpy.types.MaterialSlot, str]]:
    """The slots that the solution covers; an object that was solved without a slot gets one."""
    if not obj.material_slots and "" in model:
        _require_editable(obj.data, "mesh")
        obj.data.materials.append(None)
    found = []
    for slot in obj.material_slots:
        name = slot.material.name if slot.material else ""
        # A material that we made or copied for the slot has another name than when it was solved.
        keys = [key for key in (name, slot.material.get(TAG) if slot.material else None) if key in model]
        if keys:
            found.append((slot, model[keys[0]]))
    if not found:
        solved = ", ".join(f"'{name}'" for name in model) or "none"
        raise BadInput(f"{obj.name}: none of its materials is one that was solved ({solved}); solve again")
    return found


def _check_material(material: bpy.types.Material | None) -> None:
    """Raises BadInput when the maps cannot be wired into the material."""
    if material is None:
        return
    _require_editable(material, "material")
    if not _has_nodes(material) or find_principled(material.node_tree) is not None:
        return
    output = material.node_tree.get_output_node("CYCLES")
    if output is not None and output.inputs["Surface"].is_linked:
        raise BadInput(
            f"material '{material.name}': no Principled BSDF feeds its output; connect one to Surface, not in a group")


def _has_nodes(material: bpy.types.Material) -> bool:
    # From 5.0 on every material has nodes, and asking for use_nodes is deprecated.
    return material.node_tree is not None and (bpy.app.version >= (5, 0) or material.use_nodes)


def _own_material(
    obj: bpy.types.Object, slot: bpy.types.MaterialSlot,
    copies: dict[bpy.types.Material, bpy.types.Material], messages: list[str],
) -> bpy.types.Material:
    """The slot's material, made if there is none, copied if another object shows it too."""
    material = slot.material
    if material is not None and material not in copies and not _is_shared(obj, material):
        return material
    if obj.data.users > 1:
        slot.link = "OBJECT"  # else the slots of the other objects with this mesh would change as well
    if material is None:
        slot.material = bpy.data.materials.new(obj.name)
        slot.material[TAG] = ""
        messages.append(f"{obj.name}: had an empty material slot; made material '{slot.material.name}'")
    else:
        if material not in copies:
            copies[material] = material.copy()
            copies[material][TAG] = material.get(TAG, material.name)
            messages.append(
                f"material '{material.name}': other objects use it too; made '{copies[material].name}' for {obj.name}")
        slot.material = copies[material]
    return slot.material


def _is_shared(obj: bpy.types.Object, material: bpy.types.Material) -> bool:
    return any(
        slot.material == material for other in bpy.data.objects if other != obj for slot in other.material_slots)


# ---- nodes


def find_principled(tree: bpy.types.ShaderNodeTree) -> bpy.types.Node | None:
    """The Principled BSDF that feeds the active output: the first one met, through mix and add shaders."""
    output = tree.get_output_node("CYCLES")
    waiting = [output.inputs["Surface"]] if output is not None else []
    seen = set()
    while waiting:
        socket = waiting.pop()
        for link in socket.links:
            node = link.from_node
            if link.is_muted or node in seen:
                continue
            seen.add(node)
            if node.bl_idname == "ShaderNodeBsdfPrincipled":
                return node
            waiting += [i for i in reversed(node.inputs) if i.type == "SHADER" or node.bl_idname == "NodeReroute"]
    return None


def _wire(material: bpy.types.Material, images: Mapping[str, bpy.types.Image], model: str) -> list[str]:
    """Image Texture nodes into the Principled's Base Color and Roughness; the rest of the tree stays.

    They need no UV Map node: by itself an Image Texture takes the UV map that `scene.read_scene` reads,
    the one whose camera icon is on.
    """
    if not _has_nodes(material):
        material.use_nodes = True
    tree = material.node_tree
    principled = find_principled(tree) or _add_principled(tree)
    left = min(node.location_absolute.x for node in tree.nodes if node.get(TAG) is None)
    top = principled.location_absolute.y
    frame = _node(tree, "NodeFrame", "frame", None, (left - 340.0, top))
    frame.label = "IRPSO"
    for row, (role, socket) in enumerate(SOCKETS.items()):
        texture = _node(tree, "ShaderNodeTexImage", role, frame, (left - 320.0, top - 300.0 * row))
        texture.image = images[role]
        texture.label = socket
        tree.links.new(texture.outputs["Color"], principled.inputs[socket])
    return _set_specular(tree, principled, model)


def _add_principled(tree: bpy.types.ShaderNodeTree) -> bpy.types.Node:
    output = tree.get_output_node("CYCLES") or tree.nodes.new("ShaderNodeOutputMaterial")
    principled = tree.nodes.new("ShaderNodeBsdfPrincipled")
    principled.location = (output.location_absolute.x - 300.0, output.location_absolute.y)
    tree.links.new(principled.outputs["BSDF"], output.inputs["Surface"])
    return principled


def _node(
    tree: bpy.types.ShaderNodeTree, kind: str, role: str, frame: bpy.types.Node | None, place: tuple[float, float],
) -> bpy.types.Node:
    """Our node of this role: the one from last time, where the user left it, or a new one at ``place``."""
    for node in tree.nodes:
        if node.get(TAG) == role and node.bl_idname == kind:
            return node
    node = tree.nodes.new(kind)
    node[TAG] = role
    node.parent = frame
    node.location_absolute = place
    node.select = False
    return node


def _set_specular(tree: bpy.types.ShaderNodeTree, principled: bpy.types.Node, model: str) -> list[str]:
    """Specular IOR Level 0 for a surface without highlight, else what it was before; says if a link went."""
    socket = principled.inputs["Specular IOR Level"]
    links = list(socket.links) if model == "lambert" else []
    if model == "lambert":
        if SPECULAR_TAG not in principled:
            principled[SPECULAR_TAG] = socket.default_value
        for link in links:
            tree.links.remove(link)
        socket.default_value = 0.0
    elif SPECULAR_TAG in principled:
        socket.default_value = principled[SPECULAR_TAG]
        del principled[SPECULAR_TAG]
    return ["Specular IOR Level was linked; unlinked and set to 0"] if links else []
