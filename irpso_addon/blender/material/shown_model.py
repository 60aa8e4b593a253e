"""What materials say of the solve that has wired them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import bpy
import numpy as np

from ...core.data import Coat, Maps, Solution
from .shader_nodes import find_shader
from .solved_socket import DIFFUSE_ROUGHNESS, LEVEL, METALLIC, coat_of
from .tags import TAG, prior_of
from .two_lobe import is_two_lobe, parked


def shown_solution(obj: bpy.types.Object, maps: Maps) -> Solution:
    """A solution without figures, of the object's materials and ``maps``."""
    shown = {slot.material.name: _model(slot.material) for slot in obj.material_slots if slot.material is not None}
    priors = {slot.material.name: prior for slot in obj.material_slots
              if slot.material is not None and (prior := prior_of(slot.material)) is not None}
    painted = [name for name, found in shown.items() if found.painted and maps.metallic is not None]
    solution = Solution.of_maps(
        maps, {name: found.model for name, found in shown.items()},
        {name: found.level for name, found in shown.items() if found.level is not None},
        next((found.ndf for found in shown.values() if found.ndf == "beckmann"), "ggx"), why="as its material has it",
        metallic={name: _metal(maps) if name in painted else found.metallic for name, found in shown.items()
                  if found.metallic is not None},
        paint={name: float(np.mean(maps.metallic == 0)) for name in painted},
        coats={name: found.coat for name, found in shown.items() if found.coat is not None},
        diffuse_roughness={name: found.diffuse for name, found in shown.items() if found.diffuse > 0})
    return replace(solution, priors=priors)


def _metal(maps: Maps) -> float:
    """Metallic of a metal beside paint."""
    assert maps.metallic is not None
    return float(np.median(maps.metallic[maps.metallic > 0])) if np.any(maps.metallic > 0) else 0.0


class _Wired(NamedTuple):
    """What ``shader_nodes.wire`` has left on a material."""

    model: str
    level: float | None = None  # its one Specular IOR Level, where there is one
    metallic: float | None = None  # where it was solved for
    painted: bool = False  # whether that is a map
    ndf: str = "ggx"
    coat: Coat | None = None
    diffuse: float = 0.0  # Diffuse Roughness, where it was solved for


def _model(material: bpy.types.Material) -> _Wired:
    shader = find_shader(material.node_tree) if material.node_tree is not None else None
    if shader is not None and is_two_lobe(shader):
        beckmann = str(shader.node_tree.get(TAG)).startswith("beckmann")
        return _Wired("two-lobe", ndf="beckmann" if beckmann else "ggx")
    principled = shader or parked(material.node_tree) if material.node_tree is not None else None
    if principled is None:
        return _Wired("one-lobe")
    socket = principled.inputs[LEVEL.name]
    level, coat = float(socket.default_value) if LEVEL.tag in principled else None, coat_of(principled)
    if METALLIC.tag in principled:
        own = principled.inputs[METALLIC.name]
        painted = any(link.from_node.get(TAG) == METALLIC.role for link in own.links)
        return _Wired("one-lobe-metallic", level, float(own.default_value), painted, coat=coat)
    if coat is not None:
        return _Wired("one-lobe-specular", level, coat=coat)
    diffuse = 0.0
    if DIFFUSE_ROUGHNESS.tag in principled:
        diffuse = min(max(float(principled.inputs[DIFFUSE_ROUGHNESS.name].default_value), 0.0), 1.0)
    if level is None:
        return _Wired("one-lobe", diffuse=diffuse)
    if any(link.from_node.get(TAG) == LEVEL.role for link in socket.links):
        return _Wired("one-lobe-specular", diffuse=diffuse)
    return _Wired("lambert") if level == 0.0 else _Wired("one-lobe-specular", level, diffuse=diffuse)
