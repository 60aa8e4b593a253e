"""What materials say beside the maps, for an export: as they show it, or as a solution has it."""

from __future__ import annotations

from collections.abc import Callable

import bpy

from ...core.data import Coat, Solution
from ...core.maps.target_export import Surface
from ...core.maps.targets import DIELECTRIC
from . import two_lobe
from .shader_nodes import find_shader, has_nodes
from .slot_names import solved_name
from .solved_socket import COAT_ROUGHNESS, COAT_WEIGHT, DIFFUSE_ROUGHNESS, LEVEL, METALLIC, SolvedSocket
from .tags import TAG

Warn = Callable[[str], None]


def shown_surfaces(obj: bpy.types.Object, warn: Warn) -> tuple[Surface, ...]:
    """Of each slot, as its nodes say."""
    return tuple(_shown(slot.material, warn) for slot in obj.material_slots) or (Surface(),)


def solved_surfaces(obj: bpy.types.Object, solution: Solution) -> tuple[Surface, ...]:
    """Of each slot, as ``solution`` says, whatever its material shows by now."""
    return tuple(_solved(solved_name(slot, solution.model), solution) for slot in obj.material_slots) or (
        _solved("", solution),)


def _shown(material: bpy.types.Material | None, warn: Warn) -> Surface:
    node = find_shader(material.node_tree) if material is not None and has_nodes(material) else None
    if node is None:
        return Surface("" if material is None else material.name)
    lobes = ""
    if two_lobe.is_two_lobe(node):
        lobes = "beckmann" if str(node.node_tree.get(TAG)).startswith("beckmann") else "ggx"
    metallic, level = _value(material, node, METALLIC, 0.0, warn), _value(material, node, LEVEL, DIELECTRIC, warn)
    coat = _value(material, node, COAT_WEIGHT, 0.0, warn)
    diffuse = _value(material, node, DIFFUSE_ROUGHNESS, 0.0, warn)
    rough = _value(material, node, COAT_ROUGHNESS, 0.0, warn) if coat else 0.0
    return Surface(material.name, metallic, level, lobes, coat or 0.0, diffuse or 0.0, rough or 0.0)  # without maps


def _value(
    material: bpy.types.Material, node: bpy.types.Node, solved: SolvedSocket, default: float, warn: Warn,
) -> float | None:
    """Of an input; None: our map feeds it."""
    socket = node.inputs.get(solved.name)
    if socket is None:  # Beckmann's group has none
        return default
    if not socket.is_linked:
        return min(max(float(socket.default_value), 0.0), 1.0)
    if socket.links[0].from_node.get(TAG) == solved.role:
        return None
    warn(f"material '{material.name}': {solved.name} is linked to nodes that are not exported; {default:g} is written")
    return default


def _solved(name: str | None, solution: Solution) -> Surface:
    """By the model, as `shader_nodes.wire` puts it on a material."""
    model = None if name is None else solution.model.get(name)
    if name is None or model is None:
        return Surface("")
    level: float | None = DIELECTRIC
    if model == "lambert":
        level = 0.0
    elif model == "one-lobe-specular":
        level = solution.levels.get(name, None if solution.maps.specular is not None else DIELECTRIC)
    elif model == "one-lobe-metallic":
        level = solution.levels.get(name, DIELECTRIC)
    metallic: float | None = 0.0
    if model == "one-lobe-metallic":
        metallic = None if name in solution.paint else solution.metallic.get(name, 0.0)
    coat = solution.coats.get(name, Coat(0.0, 0.0))
    return Surface(name, metallic, level, solution.ndf if model == "two-lobe" else "", coat.weight,
                   solution.diffuse_roughness.get(name, 0.0), coat.roughness)
