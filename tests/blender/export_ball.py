"""A ball with maps for the tests of exports: what is exported, and how like two renderings of it are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from irpso_addon.blender import files
from irpso_addon.blender.export_object import export_object
from irpso_addon.blender.material.surfaces import shown_surfaces
from irpso_addon.core.data import Maps, Solution
from tests.blender import cycles_rig
from tests.blender.materials import make_material, principled_of

TEXELS, PIXELS, SAMPLES = 256, 96, 16
# Mean difference of pixels over their mean.  Measured: 8 bits 0.003 to 0.005; 16 bits 0.0007, most of it by Cycles,
# which interpolates sRGB values before it decodes them.  Maps upside down make 0.18.
TOLERANCE = {8: 0.008, 16: 0.0015}


def smooth_maps(specular: bool = False) -> Maps:
    """Waves of base colour and roughness, without symmetry: a flip shows."""
    v, u = np.mgrid[0:TEXELS, 0:TEXELS].astype("f4") / TEXELS
    base = np.stack([0.2 + 0.6 * u, 0.1 + 0.7 * v * u, 0.5 + 0.3 * np.sin(9 * v)], -1)
    roughness = 0.25 + 0.5 * v * (0.5 + 0.5 * np.sin(7 * u))
    none = np.zeros_like(u)
    return Maps(base, roughness, none + 1, none, none > 0, none < 1, none, none,
                specular=0.1 + 0.4 * u * v if specular else None)


def solution(model: str, maps: Maps | None = None, **values: Any) -> Solution:
    return replace(Solution.of_maps(smooth_maps() if maps is None else maps, {"Skin": model}), **values)


def ball(normal_map: bool = False) -> bpy.types.Object:
    """A smooth sphere with UVs, turned, in an empty scene with a camera and two lamps."""
    cycles_rig.scene(PIXELS, SAMPLES)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, rotation=(0.3, -0.4, 1.1), location=(0.2, 0.1, 0))
    obj = bpy.context.object
    obj.name = "Ball"
    obj.data.shade_smooth()
    obj.data.materials.append(make_material("Skin"))
    if normal_map:
        add_normal_map(obj.data.materials[0])
    cycles_rig.camera((0, -4, 1), (0.2, 0.1, 0), 35)
    cycles_rig.lamp("POINT", (2, -3, 2), energy=400)
    cycles_rig.lamp("POINT", (-3, -2, 1), energy=200)
    return obj


def add_normal_map(shader: bpy.types.Material, strength: float = 0.7, seed: float = 0.0) -> np.ndarray:
    """A bumpy normal map on a material; its pixels."""
    v, u = np.mgrid[0:48, 0:32].astype("f4")
    normals = np.stack([0.3 * np.sin(u / 3 + seed), 0.2 + 0.2 * np.cos(v / 4), np.ones_like(u)], -1)
    normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True) * 0.5 + 0.5).astype("f4")
    image = bpy.data.images.new("Bumps", 32, 48, float_buffer=True, is_data=True)
    image.pixels.foreach_set(np.concatenate([normals, np.ones((48, 32, 1), "f4")], -1).ravel())
    image.pack()
    nodes, links = shader.node_tree.nodes, shader.node_tree.links
    texture, node = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeNormalMap")
    texture.image, node.inputs["Strength"].default_value = image, strength
    links.new(texture.outputs["Color"], node.inputs["Color"])
    links.new(node.outputs["Normal"], principled_of(shader).inputs["Normal"])
    return normals


def export(obj: bpy.types.Object, target: str, out: Path) -> list[str]:
    """As the command line does it; the lines that say what is lost."""
    lost: list[str] = []
    _, more = export_object(obj, files.read_maps(obj), shown_surfaces(obj, lost.append), target, out)
    return lost + more


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference over the mean, where the picture shows the object."""
    there = a.sum(-1) > 0
    assert there.mean() > 0.2
    return float(np.abs(a - b)[there].mean() / a[there].mean())
