"""Maps onto an object's materials: image datablocks and the nodes that show them.

Only this file, `material_sharing`, `shader_nodes` and `two_lobe` write ``bpy.data``.  Images and nodes made here are
found again by what they are, not by their names: nodes carry the custom property ``irpso`` (their role), and the
object's custom property ``irpso`` points to its images.  So running twice leaves one set, also after renaming.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.data import F32, Maps, Solution
from ...core.errors import BadInput
from ...core.maps.export import file_name, layers
from ...core.maps.export import write_maps as export_maps
from ...core.maps.map_set import UDIM, MapFiles
from ...core.tiled.uv_blocks import FIRST_UDIM
from .material_preflight import check_material, check_object
from .material_sharing import Own, is_shared, or_open_scene
from .shader_nodes import find_shader, has_nodes, wire
from .slot_names import solved_slots
from .tags import TAG, maps_of, tag_prior

SUFFIXES = {"base_color": "basecolor"}  # role -> end of the name, where they differ
UNKEPT = "filled"  # the layer without an image: the confidence tells which texels were filled
# Roles that only some models have, and those that the maps of a running solve lack.
OPTIONAL = ("specular", "metallic", "normal", "roughness_sigma", "basecolor_sigma")
NAME_BYTES = 63  # of a datablock in Blender 4.5; 5.x allows more


@dataclass(frozen=True)
class _Target:
    """A slot to write to, and the name it was solved under."""

    slot: bpy.types.MaterialSlot
    solved: str


def write_maps(
    obj: bpy.types.Object, solution: Solution, *, packed: bool = True, directory: Path | None = None,
) -> tuple[str, ...]:
    """Wires the maps of ``solution`` into every material slot it covers, each by its own model.

    The images are packed into the .blend, or, with ``packed`` False, saved as EXR files in ``directory``.
    Returns what the user should know, one line each.  Raises BadInput, before anything is changed, when
    the object or one of its materials cannot take the maps.
    """
    check(obj, solution)
    if packed:
        images = write_images(obj, layers_of(solution.maps))
    else:
        if directory is None:
            raise ValueError("packed=False needs a directory")
        export_maps(solution.maps, obj.name, directory, "exr")
        images = link_images(obj, files_of(obj.name, solution.maps, directory, "exr", (FIRST_UDIM,)))
    return wire_maps(obj, solution, images)


def link_maps(
    obj: bpy.types.Object, solution: Solution, directory: Path, kind: str, udims: tuple[int, ...],
) -> tuple[str, ...]:
    """As `write_maps`, of a large solve, whose maps are (or are about to be) files in ``directory``.

    ``solution`` tells models and layers; ``udims``: with more than one or another than 1001, a file for each.
    """
    return link_files(obj, solution, files_of(obj.name, solution.maps, directory, kind, udims))


def link_files(
    obj: bpy.types.Object, solution: Solution, files: MapFiles, share: bool | None = None,
) -> tuple[str, ...]:
    """The same of files by any names.  ``share``: as in `wire_maps`."""
    check(obj, solution)
    return wire_maps(obj, solution, link_images(obj, files, share), share)


def wire_maps(
    obj: bpy.types.Object, solution: Solution, images: Mapping[str, bpy.types.Image], share: bool | None = None,
) -> tuple[str, ...]:
    """As `write_maps`, with images that are there already, by role.

    ``share``: whether materials that other objects show too show the maps there as well; None: as the open scene says.
    """
    messages: list[str] = []
    targets = check(obj, solution)
    own = Own(obj, or_open_scene(share))
    solved = {own.material(target.slot, target.solved): target.solved for target in targets}
    messages += own.messages
    for material, name in solved.items():
        found = wire(material, images, model=solution.model[name], lobes=solution.maps.lobes is not None,
                     level=solution.levels.get(name), coat=solution.coats.get(name), ndf=solution.ndf,
                     diffuse_roughness=solution.diffuse_roughness.get(name),
                     metallic=None if name in solution.paint else solution.metallic.get(name, 0.0))
        messages += [f"material '{material.name}': {text}" for text in found]
        tag_prior(material, solution.priors.get(name))
    _drop_others(obj, images)
    if obj.override_library is not None:
        messages.append(f"{obj.name}: is a library override, which keeps its materials but not its result when the "
                        "file is opened again; export the maps, or make it local (Object > Relations)")
    return tuple(messages)


def check(obj: bpy.types.Object, solution: Solution) -> list[_Target]:
    """The slots to write to.  Raises BadInput when one cannot take the maps."""
    check_object(obj)
    targets = _targets(obj, solution.model)
    for target in targets:
        check_material(target.slot.material)
    return targets


# ---- images


def write_images(obj: bpy.types.Object, layers: Mapping[str, F32]) -> dict[str, bpy.types.Image]:
    """Float images ``<object>_<role>``, packed; ``layers`` holds (h, w) or (h, w, 3) arrays, row 0 bottom.

    Base colour is tagged Linear Rec.709, everything else Non-Color, so that nothing is converted.  An
    image of the same role that the object already has is replaced wherever it is used.
    """
    return {role: put_image(obj, role, array) for role, array in layers.items()}


def put_image(obj: bpy.types.Object, role: str, array: F32, share: bool | None = None) -> bpy.types.Image:
    """One of them.  ``share``: as in `wire_maps`."""
    image = loose_image(obj, role, array.shape[0])
    set_pixels(image, array)
    image.pack()
    return _adopt(obj, role, image, share)


def loose_image(obj: bpy.types.Object, role: str, size: int, encoded: bool = False) -> bpy.types.Image:
    """A new float image for `adopt`; nothing points to it yet.  ``encoded``: base colour is sRGB in its file."""
    image = bpy.data.images.new(obj.name, size, size, float_buffer=True, is_data=role != "base_color")
    if role == "base_color":
        image.colorspace_settings.name = "sRGB" if encoded else "Linear Rec.709"
    else:
        image.colorspace_settings.is_data = True
    return image


def set_pixels(image: bpy.types.Image, array: F32) -> None:
    """(h, w) or (h, w, 3) as the image's pixels; not packed."""
    rgba = np.ones((*array.shape[:2], 4), np.float32)
    rgba[..., :3] = array if array.ndim == 3 else array[..., None]
    image.pixels.foreach_set(rgba.ravel())
    image.update()


def adopt(obj: bpy.types.Object, images: Mapping[str, bpy.types.Image], share: bool | None = None) -> None:
    """Makes them the object's images, by role.  ``share``: as in `wire_maps`.

    Until the next undo step is made Blender does not know of it: Undo would free what the object points to.
    """
    before = maps_of(obj)
    for role, image in images.items():
        if before.get(role) != image:
            _adopt(obj, role, image, share)
        else:  # the object may have been renamed since
            image.name = _image_name(obj, role)


def files_of(name: str, maps: Maps, directory: Path, kind: str, udims: tuple[int, ...]) -> MapFiles:
    """The files of an object's maps as `core.maps.export` and `core.maps.block_merge` name them."""
    token = "" if udims == (FIRST_UDIM,) else f".{UDIM}"
    return MapFiles({layer: directory.resolve() / file_name(name, f"{layer}{token}", kind) for layer in layers(maps)},
                    udims)


def link_images(obj: bpy.types.Object, files: MapFiles, share: bool | None = None) -> dict[str, bpy.types.Image]:
    """Images by role that are files, which need not be there yet; paths are relative where the .blend was saved.

    ``share``: as in `wire_maps`.
    """
    images, roles = {}, {suffix: role for role, suffix in SUFFIXES.items()}
    for layer, path in files.paths.items():
        if layer == UNKEPT:
            continue
        role = roles.get(layer, layer)
        image = loose_image(obj, role, 1, encoded=files.kind != "exr")
        image.filepath = _relative(path)
        image.source = "TILED" if files.tiled else "FILE"
        if files.tiled:
            _set_tiles(image, files.udims)
        images[role] = _adopt(obj, role, image, share)
    return images


def _relative(path: Path) -> str:
    """As the .blend stores it."""
    if not bpy.data.filepath:
        return str(path)
    try:
        return str(bpy.path.relpath(str(path)))
    except ValueError:  # on another drive of Windows
        return str(path)


def _set_tiles(image: bpy.types.Image, udims: Sequence[int]) -> None:
    """Exactly these: Blender adds those whose files it finds, of earlier solves perhaps, and always has one."""
    for number in udims:
        if image.tiles.get(number) is None:
            image.tiles.new(tile_number=number)
    for tile in [tile for tile in image.tiles if tile.number not in udims]:
        image.tiles.remove(tile)


def layers_of(maps: Maps) -> dict[str, F32]:
    """The maps that the file keeps, by role.  Which texels were filled is in the confidence: 0."""
    roles = {suffix: role for role, suffix in SUFFIXES.items()}
    return {roles.get(suffix, suffix): array for suffix, array in layers(maps).items() if suffix != UNKEPT}


def _adopt(obj: bpy.types.Object, role: str, image: bpy.types.Image, share: bool | None) -> bpy.types.Image:
    """Makes ``image`` the object's one image of this role: named, owned, in place of the one before."""
    before = maps_of(obj).get(role)
    if not hasattr(obj.get(TAG), "items"):
        obj[TAG] = {}
    if before is not None and not _is_others(obj, role, before, share):
        before.user_remap(image)
        bpy.data.images.remove(before)
    image.name = _image_name(obj, role)
    obj[TAG][role] = image  # counts as a user: confidence and error have no node that would keep them
    return image


def _image_name(obj: bpy.types.Object, role: str) -> str:
    suffix = "_" + SUFFIXES.get(role, role)
    return obj.name.encode()[: NAME_BYTES - len(suffix)].decode(errors="ignore") + suffix


def _is_others(obj: bpy.types.Object, role: str, image: bpy.types.Image, share: bool | None) -> bool:
    """Whether another object has the map, so that it is not ours to replace there.

    A duplicated object points to the images of its original.  Where others keep their materials, those show them.
    """
    if any(found == image and (other, key) != (obj, role)
           for other in bpy.data.objects for key, found in maps_of(other).items()):
        return True
    return not or_open_scene(share) and any(
        is_shared(obj, material) for material in bpy.data.materials if has_nodes(material)
        and any(getattr(node, "image", None) == image for node in material.node_tree.nodes))


def _drop_others(obj: bpy.types.Object, images: Mapping[str, bpy.types.Image]) -> None:
    """Forgets maps of an earlier solve that this one does not have."""
    for role in OPTIONAL:
        if role in obj[TAG] and role not in images:
            image = obj[TAG][role]
            del obj[TAG][role]
            if image is not None and image.users == 0:
                bpy.data.images.remove(image)


# ---- materials


def _targets(obj: bpy.types.Object, model: Mapping[str, str]) -> list[_Target]:
    """The slots that the solution covers; an object that was solved without a slot gets one."""
    if not obj.material_slots and "" in model:
        obj.data.materials.append(None)
    found = [_Target(slot, name) for slot, name in solved_slots(obj, model)]
    if not found:
        solved = ", ".join(f"'{name}'" for name in model if name)
        if not solved:
            raise BadInput(f"{obj.name}: none of its materials was solved; solve again")
        raise BadInput(f"{obj.name}: none of its materials was solved ({solved}); give it one of that name and press "
                       "Write to Material, or solve again")
    return found


def are_shown(obj: bpy.types.Object) -> bool:
    """Whether a material of the object shows its base colour by our node."""
    image = maps_of(obj).get("base_color")
    if image is None:
        return False
    return any(node.get(TAG) == "base_color" and node.bl_idname == "ShaderNodeTexImage" and node.image == image
               and any(link.to_node == find_shader(slot.material.node_tree) for link in node.outputs["Color"].links)
               for slot in obj.material_slots if slot.material is not None and has_nodes(slot.material)
               for node in slot.material.node_tree.nodes)
