"""What Cycles says: the sheen's table, which nobody publishes as text, and how far ``model.py`` is from its pixels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from irpso_addon.core.data import F64
from irpso_addon.core.shading import lights
from tests.blender import cycles_rig as rig

from .model import SHEEN_NODES, Geometry, Numbers, principled

SOCKETS = {
    "roughness": "Roughness", "level": "Specular IOR Level", "metallic": "Metallic", "coat": "Coat Weight",
    "diffuse_roughness": "Diffuse Roughness", "coat_roughness": "Coat Roughness", "sheen": "Sheen Weight",
    "sheen_roughness": "Sheen Roughness",
}
FLATTEST = 2  # node along the cosine: 2/31 is below the least cosine that is observed
STRIP, LONG = 0.1, 16  # metres that a strip is wide; pixels along it
CHECKS = {  # one rung each, and all at once
    "base, level": Numbers(roughness=0.4, level=0.8),
    "metallic": Numbers(roughness=0.4, metallic=0.6),
    "diffuse roughness": Numbers(roughness=0.6, level=0.2, diffuse_roughness=0.7),
    "coat": Numbers(roughness=0.7, level=0.3, coat=0.6, coat_roughness=0.3),
    "sheen": Numbers(roughness=0.6, level=0.2, sheen=0.7, sheen_roughness=0.45),
    "specular tint": Numbers(roughness=0.5, level=0.9, metallic=0.4, tint=np.array([0.9, 0.5, 0.2])),
    "all": Numbers(roughness=0.5, level=0.8, metallic=0.3, diffuse_roughness=0.5, coat=0.5, coat_roughness=0.35,
                   sheen=0.4, sheen_roughness=0.6, tint=np.array([1.0, 0.7, 0.4])),
}
BASE = np.array([0.05, 0.4, 0.9])


def sheen_table() -> F64:
    """(32, 32, 3) a, b and albedo at roughness i/31 and cosine to the viewer j/31; below FLATTEST that of FLATTEST.

    A strip of a plane for each roughness, seen from infinity, one lamp near it.  The lobe's inverse square root is
    linear in x^2 + y^2, x z and z^2 of the direction to the lamp, which gives a, b and the albedo in closed form.
    """
    table = np.zeros((SHEEN_NODES, SHEEN_NODES, 3))
    half = STRIP * SHEEN_NODES / 2
    rig.scene(SHEEN_NODES)
    scene = bpy.context.scene
    node = rig.principled(_strips(), (0, 0, 0), 0.5, specular=0.0)
    attribute = bpy.data.materials["material"].node_tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "sheen"
    bpy.data.materials["material"].node_tree.links.new(attribute.outputs["Fac"], node.inputs["Sheen Roughness"])
    node.inputs["Sheen Weight"].default_value = 1.0
    light = rig.as_light(rig.lamp("POINT", (0.1, 0.2, 0.7 * half)))
    for j in range(FLATTEST, SHEEN_NODES):
        V = np.array([0.0, np.sqrt(1 - (j / 31) ** 2), j / 31])
        if scene.camera:
            bpy.data.objects.remove(scene.camera)
        rig.camera(50 * V + 1e-6)
        scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 2 * half
        image = rig.render()
        P, f = image["position"], image["rgb"][..., 0]
        L = lights.light_sample(light, P, 0, 1)[0]
        L = L / np.linalg.norm(L, axis=-1, keepdims=True)
        N = np.broadcast_to([0.0, 0.0, 1.0], L.shape)
        f = f / np.maximum(lights.light_irradiance(light, P, N) * light.power[0], 1e-12)
        strip = np.clip(np.floor(P[..., 0] / STRIP + SHEEN_NODES / 2).astype(int), 0, SHEEN_NODES - 1)
        known = (image["normal"][..., 2] > 0.5) & (L[..., 2] > 0.1) & (f > 1e-6)
        for i in range(SHEEN_NODES):
            table[i, j] = _transform(L[known & (strip == i)], f[known & (strip == i)])
    table[:, :FLATTEST] = table[:, FLATTEST : FLATTEST + 1]
    return table


def _transform(L: F64, f: F64) -> F64:
    """a, b, albedo of a lobe that is seen from the +y side; zeros where there is none."""
    if len(L) < 8:
        return np.zeros(3)
    columns = np.stack([L[:, 0] ** 2 + L[:, 1] ** 2, L[:, 1] * L[:, 2], L[:, 2] ** 2], 1)
    root = np.sqrt(np.pi * f)  # errors of float32 are relative: rows are weighted by it
    flat, slant, up = np.linalg.lstsq(columns * root[:, None], np.ones(len(root)), rcond=None)[0]
    albedo = 1 / (flat * up - slant**2 / 4)
    return np.array([flat * np.sqrt(albedo), slant / 2 * np.sqrt(albedo), albedo])


def _strips() -> Any:
    """A plane of strips along y, each with its own "sheen" from 0 to 1."""
    edges, far = (np.arange(SHEEN_NODES + 1) - SHEEN_NODES / 2) * STRIP, 40.0
    mesh = bpy.data.meshes.new("strips")
    points = [(x, y, 0) for x in edges for y in (-far, far)]
    mesh.from_pydata(points, [], [(2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1) for i in range(SHEEN_NODES)])
    values = mesh.attributes.new("sheen", "FLOAT", "FACE").data
    for i in range(SHEEN_NODES):
        values[i].value = i / (SHEEN_NODES - 1)
    made = bpy.data.objects.new("strips", mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def errors(table: F64, pixels: int) -> Iterator[tuple[str, F64]]:
    """Each rung's |twin / Cycles - 1| at the pixels of a sphere under a lamp, to 75 degrees."""
    rig.scene(pixels)
    node = rig.principled(rig.sphere(), BASE, 0.5)
    rig.camera(eye := (0.0, -4.0, 1.0), degrees=32)
    light = rig.as_light(rig.lamp("POINT", (2, -3, 3)))
    for name, numbers in CHECKS.items():
        numbers = replace(numbers, base=BASE)
        for field, socket in SOCKETS.items():
            node.inputs[socket].default_value = getattr(numbers, field)
        node.inputs["Specular Tint"].default_value = (*numbers.tint, 1)
        image = rig.render()
        seen = np.linalg.norm(image["normal"], axis=-1) > 0.5
        P, N, rgb = (image[k][seen] for k in ("position", "normal", "rgb"))
        N = N / np.linalg.norm(N, axis=-1, keepdims=True)
        L, V = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (
            lights.light_sample(light, P, 0, 1)[0], np.array(eye) - P))
        steep = np.minimum((L * N).sum(-1), (V * N).sum(-1)) > np.cos(np.radians(75))
        E = lights.light_irradiance(light, P, N)[:, None] * light.power
        f = principled(Geometry.of(L[steep], V[steep], N[steep]), numbers, table)
        yield name, np.abs(f * E[steep] / rgb[steep] - 1)
