"""The nodes of one material that show the maps.

Nodes made here carry the custom property ``irpso`` (their role), so running twice leaves one set.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import bpy

from ...core.data import Coat
from . import two_lobe
from .solved_socket import DIFFUSE_ROUGHNESS, LEVEL, METALLIC, NORMAL, set_coat
from .tags import NORMAL_ROLE, TAG


def wire(
    material: bpy.types.Material, images: Mapping[str, bpy.types.Image], *,
    model: str, lobes: bool, level: float | None, metallic: float | None, coat: Coat | None, ndf: str,
    diffuse_roughness: float | None,
) -> list[str]:
    """Image Texture nodes into the Principled BSDF, or the group in its place; the rest of the tree stays.

    ``lobes``: the roughness image holds (roughness1, roughness2, weight).  ``level``: the material's one Specular
    IOR Level; None: the image's, where there is one.  ``metallic``: of model one-lobe-metallic; None: the image's.
    ``coat``, ``diffuse_roughness``: of one lobe; None: there is none.
    Returns what the user should know.

    The textures need no UV Map node: by itself an Image Texture takes the UV map that `scene.read_scene` reads,
    the one whose camera icon is on.
    """
    if not has_nodes(material):
        material.use_nodes = True
    tree = material.node_tree
    shader, principled = _principled(tree)
    textures = _Textures(tree, shader, images)
    level_source: bpy.types.NodeSocket | float | None = None
    if model == "lambert":
        level_source = 0.0
    elif model == "one-lobe-specular":
        solved = level is None and "specular" in images
        level_source = textures.add("specular", LEVEL.name, 2).outputs["Color"] if solved else level
    metallic_source: bpy.types.NodeSocket | float | None = None
    if model == "one-lobe-metallic":
        solved = metallic is None and "metallic" in images
        level_source, metallic_source = level, (
            textures.add("metallic", METALLIC.name, 4).outputs["Color"] if solved else metallic)
    messages = LEVEL.set(tree, principled, level_source)
    messages += METALLIC.set(tree, principled, metallic_source)
    NORMAL.set(tree, principled, textures.normal() if "normal" in images else None)  # it holds what was linked there
    if "normal" not in images:
        _remove(tree, NORMAL_ROLE)
        _remove(tree, "normal")
    messages += set_coat(tree, principled, coat)
    messages += DIFFUSE_ROUGHNESS.set(tree, principled, diffuse_roughness)
    if not isinstance(level_source, bpy.types.NodeSocket):
        _remove(tree, "specular")
    if not isinstance(metallic_source, bpy.types.NodeSocket):
        _remove(tree, "metallic")
    shader, more = _wire_roughness(tree, principled, textures, model, lobes, ndf)
    base = textures.add("base_color", "Base Color", 0)
    tree.links.new(base.outputs["Color"], shader.inputs["Base Color"])
    if tree.nodes.active is None or tree.nodes.active.bl_idname != base.bl_idname:
        tree.nodes.active = base  # what Solid view with textures shows, and what is painted on
    return messages + more


def _wire_roughness(
    tree: bpy.types.ShaderNodeTree, principled: bpy.types.Node, textures: _Textures, model: str, lobes: bool, ndf: str,
) -> tuple[bpy.types.Node, list[str]]:
    """The roughness of one lobe or of two; the shader that shows it, and what the user should know."""
    roughness = textures.add("roughness", "Roughness", 1)
    channels = textures.separate(roughness).outputs if lobes else []
    if not lobes:
        _remove(tree, "separate")
    if model != "two-lobe":
        two_lobe.unpark(principled)
        _remove(tree, two_lobe.ROLE)
        tree.links.new(channels[0] if lobes else roughness.outputs["Color"], principled.inputs["Roughness"])
        return principled, []
    shader = _stand_in(tree, principled, ndf)
    for name, channel in zip(two_lobe.LOBES, channels, strict=True):
        tree.links.new(channel, shader.inputs[name])
    animated = tree.animation_data is not None
    return shader, ["its nodes are animated; the node group keeps their present values"] if animated else []


def has_nodes(material: bpy.types.Material) -> bool:
    """Whether the material's nodes are in use."""
    # From 5.0 on every material has nodes, and asking for use_nodes is deprecated.
    return material.node_tree is not None and (bpy.app.version >= (5, 0) or material.use_nodes)


def find_shader(tree: bpy.types.ShaderNodeTree) -> bpy.types.Node | None:
    """What the maps feed: the Principled BSDF or the two-lobe group behind the active output.

    The first one met, through mix and add shaders.
    """
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
            if node.mute:  # it hands on one of its inputs, or nothing
                waiting += [inner.from_socket for inner in node.internal_links]
            elif node.bl_idname == "ShaderNodeBsdfPrincipled" or two_lobe.is_two_lobe(node):
                return node
            else:
                waiting += [i for i in reversed(node.inputs) if i.type == "SHADER" or node.bl_idname == "NodeReroute"]
    return None


def _principled(tree: bpy.types.ShaderNodeTree) -> tuple[bpy.types.Node, bpy.types.Node]:
    """What is shown, and the Principled BSDF, which from here on feeds the output: a group only stands in for it."""
    shader = find_shader(tree)
    if shader is None:
        output = tree.get_output_node("CYCLES") or tree.nodes.new("ShaderNodeOutputMaterial")
        shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
        shader.location = (output.location_absolute.x - 300.0, output.location_absolute.y)
        tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    if not two_lobe.is_two_lobe(shader):
        return shader, shader
    principled = two_lobe.parked(tree)
    if principled is None:  # the user deleted it
        principled = tree.nodes.new("ShaderNodeBsdfPrincipled")
        principled.parent = shader.parent
        principled.location_absolute = shader.location_absolute
    two_lobe.bring_back(shader, principled)
    return shader, principled


def _stand_in(tree: bpy.types.ShaderNodeTree, principled: bpy.types.Node, ndf: str) -> bpy.types.Node:
    """The two-lobe group in the place of ``principled``."""
    place = principled.location_absolute
    # Below the Principled, which is collapsed to one line.
    node = _node(tree, "ShaderNodeGroup", two_lobe.ROLE, principled.parent, (place.x, place.y - 60.0))
    before, node.node_tree = node.node_tree, two_lobe.group_for(principled, ndf)
    node.width = max(node.width, principled.width)
    if before is not None and before.users == 0 and before.get(TAG):
        bpy.data.node_groups.remove(before)
    two_lobe.park(principled, node)
    return node


class _Textures:
    """Our texture nodes, in one frame left of the user's nodes."""

    def __init__(
        self, tree: bpy.types.ShaderNodeTree, shader: bpy.types.Node, images: Mapping[str, bpy.types.Image],
    ) -> None:
        self._tree, self._images = tree, images
        left = min(node.location_absolute.x for node in tree.nodes if node.get(TAG) is None)
        self._place = (left - 500.0, shader.location_absolute.y)
        self._frame = _node(tree, "NodeFrame", "frame", None, (left - 520.0, self._place[1]))
        self._frame.label = "IRPSO"

    def add(self, role: str, label: str, row: int) -> bpy.types.Node:
        """The texture of that role."""
        place = (self._place[0], self._place[1] - 300.0 * row)
        texture = _node(self._tree, "ShaderNodeTexImage", role, self._frame, place)
        texture.image, texture.label = self._images[role], label
        return texture

    def normal(self) -> bpy.types.NodeSocket:
        """What a Normal Map node makes of the texture of the normals."""
        texture = self.add("normal", "Normal", 3)
        node = _node(self._tree, "ShaderNodeNormalMap", NORMAL_ROLE, self._frame,
                     (self._place[0] + 280.0, self._place[1] - 900.0))
        node.space, node.uv_map = "TANGENT", ""
        node.inputs["Strength"].default_value = 1.0
        self._tree.links.new(texture.outputs["Color"], node.inputs["Color"])
        return node.outputs["Normal"]

    def separate(self, texture: bpy.types.Node) -> bpy.types.Node:
        """Its three channels, each by itself."""
        node = _node(self._tree, "ShaderNodeSeparateColor", "separate", self._frame,
                     (self._place[0] + 280.0, self._place[1] - 300.0))
        self._tree.links.new(texture.outputs["Color"], node.inputs[0])
        return node


def _ours(tree: bpy.types.ShaderNodeTree, role: str) -> Iterator[bpy.types.Node]:
    return (node for node in tree.nodes if node.get(TAG) == role)


def _node(
    tree: bpy.types.ShaderNodeTree, kind: str, role: str, frame: bpy.types.Node | None, place: tuple[float, float],
) -> bpy.types.Node:
    """Our node of this role: the one from last time, where the user left it, or a new one at ``place``."""
    for node in _ours(tree, role):
        if node.bl_idname == kind:
            return node
    node = tree.nodes.new(kind)
    node[TAG] = role
    node.parent = frame
    node.location_absolute = place
    node.select = False
    return node


def _remove(tree: bpy.types.ShaderNodeTree, role: str) -> None:
    """Takes our nodes of this role away, and the group of which none is left."""
    for node in list(_ours(tree, role)):
        group = getattr(node, "node_tree", None)
        tree.nodes.remove(node)
        if group is not None and group.users == 0 and group.get(TAG):
            bpy.data.node_groups.remove(group)
