"""Whether maps can go onto an object's materials: asked before a solve, so that no result is homeless after it."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.data import I32
from ...core.errors import BadInput
from .shader_nodes import find_shader, has_nodes


def why_not(obj: bpy.types.Object) -> str | None:
    """Why the maps cannot go onto ``obj``, as far as a panel can tell on every redraw; None: they can."""
    try:
        check_object(obj)
        if len(obj.material_slots) == 1:  # which of several have faces takes a look at all faces
            check_material(obj.material_slots[0].material)
    except BadInput as error:
        return str(error)
    return None


def check(obj: bpy.types.Object, slots: I32) -> None:
    """Raises BadInput when maps cannot go onto ``obj``, whose faces have these ``slots``; those without need none."""
    check_object(obj)
    for index in np.unique(slots):
        if index < len(obj.material_slots):
            check_material(obj.material_slots[int(index)].material)


def check_object(obj: bpy.types.Object) -> None:
    """Raises BadInput when ``obj`` is not a mesh of this file."""
    if obj.type != "MESH":
        raise BadInput(f"{obj.name}: is not a mesh; choose a mesh object")
    require_editable(obj, "object")
    if not obj.material_slots:
        require_editable(obj.data, "mesh")  # it gets a slot


def check_material(material: bpy.types.Material | None) -> None:
    """Raises BadInput when the maps cannot be wired into ``material``; an empty slot gets one."""
    if material is None:
        return
    require_editable(material, "material")
    if material.override_library is not None:
        raise BadInput(f"{material.name}: this material is a library override, whose nodes Blender does not save; make "
                       "it local first (Object > Relations)")
    if not has_nodes(material) or find_shader(material.node_tree) is not None:
        return
    output = material.node_tree.get_output_node("CYCLES")
    if output is None and any(node.bl_idname == "ShaderNodeOutputMaterial" for node in material.node_tree.nodes):
        raise BadInput(f"material '{material.name}': its Material Output is for EEVEE alone; set its Target to All")
    if output is not None and output.inputs["Surface"].is_linked:
        raise BadInput(f"material '{material.name}': {_obstacle(output)}")


def require_editable(data: bpy.types.ID, kind: str) -> None:
    """Raises BadInput when ``data`` belongs to another file."""
    if not data.is_editable:
        raise BadInput(f"{data.name}: this {kind} is linked from a library; make it local first (Object > Relations)")


def _obstacle(output: bpy.types.Node) -> str:
    """What keeps the maps from a Principled BSDF, and what to do."""
    for node in _behind(output):
        if node.bl_idname == "ShaderNodeBsdfPrincipled":
            return "its Principled BSDF, or a link or node after it, is muted; unmute it"
        if node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None and _holds_principled(node.node_tree, 0):
            return (f"its Principled BSDF is inside node group '{node.node_tree.name}'; ungroup it (Ctrl+Alt+G), "
                    "or connect one to Surface")
    return "no Principled BSDF feeds its output; connect one to Surface"


def _behind(output: bpy.types.Node) -> list[bpy.types.Node]:
    """Every node that a link leads from to the output's surface, muted or not."""
    waiting, found = [output.inputs["Surface"]], []
    while waiting:
        for link in waiting.pop().links:
            if link.from_node not in found:
                found.append(link.from_node)
                waiting += list(link.from_node.inputs)
    return found


def _holds_principled(tree: bpy.types.ShaderNodeTree, depth: int) -> bool:
    return depth < 8 and any(
        node.bl_idname == "ShaderNodeBsdfPrincipled"
        or (getattr(node, "node_tree", None) is not None and _holds_principled(node.node_tree, depth + 1))
        for node in tree.nodes)
