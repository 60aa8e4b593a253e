"""What is written back re-renders as solved: Cycles' pixels against the float64 model, for each model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
import pytest

from irpso_addon.blender.material import material
from irpso_addon.core.data import F64, Coat, Maps, Solution
from irpso_addon.core.shading import brdf, lights
from tests.blender import cycles_rig as rig

LAMPS = {"beside": (2, -3, 3), "behind": (3.2, 1.2, 1.0)}  # the second: grazing, half vectors far from the viewer
EXACT_METAL = bpy.app.version >= (5, 0)  # 4.5's Metallic BSDF approximates the conductor's Fresnel
TEXELS = 8
Model = Callable[[F64, F64, F64, dict[str, F64]], F64]  # (L, V, N, the maps at the pixels) -> 1/sr


def solution(model: str, values: dict[str, Any], *, level: float | None = None, ndf: str = "ggx") -> Solution:
    """``values``: "base" (..., 3), "lobes" (..., 3) or "roughness", "specular"; (TEXELS, TEXELS, ...) or constant."""
    def layer(name: str, *channels: int) -> np.ndarray:
        shape = (TEXELS, TEXELS, *channels)
        return np.ascontiguousarray(np.broadcast_to(np.asarray(values.get(name, 0.0), "f4"), shape))

    maps = Maps(
        base_color=layer("base", 3), roughness=layer("lobes", 3)[..., 0] if "lobes" in values else layer("roughness"),
        confidence=layer("none"), error=layer("none"), filled=layer("none") > 0, coverage=layer("none") == 0,
        roughness_sigma=layer("none"), base_sigma=layer("none"),
        lobes=layer("lobes", 3) if "lobes" in values else None,
        specular=layer("specular") if "specular" in values else None)
    return Solution(
        maps=maps, model={"material": model}, why={}, texels={}, seconds={}, residual=0.0, views_used=(),
        views_skipped=(), warnings=(), device={}, levels={} if level is None else {"material": level}, ndf=ndf)


def stage(shape: str, lamp: Any, eye: Any = (0, -4, 1), degrees: float = 32.0, pixels: int = 40) -> Any:
    """A sphere or a square of 2 x 2 with UVs, one lamp of radius 0, a camera at ``eye``."""
    rig.scene(pixels)
    obj = rig.sphere() if shape == "sphere" else rig.plane(1.0)
    if shape == "square":
        layer = obj.data.uv_layers.new(name="UVMap")
        for corner, uv in zip(layer.data, [(0, 0), (1, 0), (1, 1), (0, 1)], strict=True):
            corner.uv = uv
    rig.principled(obj, (0.5, 0.5, 0.5), 0.5)
    rig.camera(eye, degrees=degrees)
    rig.lamp("POINT", lamp)
    return obj


def at(values: dict[str, Any], position: F64) -> dict[str, F64]:
    """The maps at points of the square: bilinear between texel centres, repeating."""
    found = {}
    for name, array in values.items():
        texels = np.asarray(array, "f4").astype("f8")
        if texels.ndim < 2:  # constant
            found[name] = np.broadcast_to(texels, (*position.shape[:1], *texels.shape))
            continue
        place = (position[:, :2] + 1) / 2 * TEXELS - 0.5
        low = np.floor(place).astype(int)
        t = (place - low).reshape(-1, 2, *[1] * (texels.ndim - 2))
        (x, y), (x1, y1) = low.T % TEXELS, (low.T + 1) % TEXELS
        below = texels[y, x] * (1 - t[:, 0]) + texels[y, x1] * t[:, 0]
        above = texels[y1, x] * (1 - t[:, 0]) + texels[y1, x1] * t[:, 0]
        found[name] = below * (1 - t[:, 1]) + above * t[:, 1]
    return found


def errors(values: dict[str, Any], model: Model) -> F64:
    """|twin / Cycles - 1| of each lit pixel and channel, up to 85 degrees to light and viewer."""
    image = rig.render()
    seen = np.linalg.norm(image["normal"], axis=-1) > 0.5
    P, N, rgb = (image[name][seen] for name in ("position", "normal", "rgb"))
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    light = rig.as_light(bpy.data.objects["lamp"])
    L = lights.light_sample(light, P, 0, 1)[0]
    V = np.array(bpy.context.scene.camera.matrix_world.translation) - P
    L, V = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (L, V))
    lit = np.minimum((L * N).sum(-1), (V * N).sum(-1)) > np.cos(np.radians(85))
    assert lit.sum() > 60
    irradiance = lights.light_irradiance(light, P, N)[:, None] * light.power
    twin = model(L[lit], V[lit], N[lit], at(values, P[lit])) * irradiance[lit]
    return np.abs(twin / rgb[lit] - 1)


def two_lobe(ndf: str) -> Model:
    return lambda L, V, N, maps: brdf.two_lobe(maps["base"], np.moveaxis(maps["lobes"], -1, 0), L, V, N, ndf)


def limits(ndf: str) -> tuple[float, float]:
    """Largest and mean error.  Blender 4.5's Beckmann lobes: the fit of the Fresnel, 1 % of the specular part."""
    return (0.001, 0.00002) if EXACT_METAL or ndf == "ggx" else (0.0105, 0.006)


@pytest.mark.parametrize("ndf", ["ggx", "beckmann"])
@pytest.mark.parametrize("lamp", LAMPS)
@pytest.mark.parametrize("lobes", [(0.15, 0.6, 0.7), (0.3, 0.9, 0.25), (0.4, 0.4, 1.0), (0.2, 0.5, 0.0)])
def test_two_lobes_on_a_sphere(ndf: str, lamp: str, lobes: tuple[float, float, float]) -> None:
    obj = stage("sphere", LAMPS[lamp])
    values = {"base": (0.05, 0.4, 0.9), "lobes": lobes}
    material.write_maps(obj, solution("two-lobe", values, ndf=ndf))
    error = errors(values, two_lobe(ndf))
    largest, mean = limits(ndf)
    assert error.max() < largest and error.mean() < mean, (error.max(), error.mean())


@pytest.mark.parametrize("ndf", ["ggx", "beckmann"])
def test_two_lobes_from_maps(ndf: str) -> None:
    """Each channel of the image lands where it belongs: other values at every texel."""
    rng = np.random.default_rng(2)
    rough = np.sort(rng.uniform(0.2, 0.9, (TEXELS, TEXELS, 2)), axis=-1)
    values = {"base": rng.uniform(0.05, 0.9, (TEXELS, TEXELS, 3)),
              "lobes": np.concatenate([rough, rng.uniform(0, 1, (TEXELS, TEXELS, 1))], axis=-1)}
    obj = stage("square", (0.4, 0.8, 1.1), eye=(0, -2, 1.2), degrees=50)
    material.write_maps(obj, solution("two-lobe", values, ndf=ndf))
    error = errors(values, two_lobe(ndf))
    largest, mean = limits(ndf)
    assert error.max() < largest and error.mean() < mean, (error.max(), error.mean())


def test_one_lobe_beside_two() -> None:
    """A one-lobe material whose roughness image holds (r, r, 1), because another material has two lobes."""
    rng = np.random.default_rng(4)
    rough = rng.uniform(0.2, 0.9, (TEXELS, TEXELS))
    values = {"base": rng.uniform(0.05, 0.9, (TEXELS, TEXELS, 3)),
              "lobes": np.stack([rough, rough, np.ones_like(rough)], axis=-1)}
    obj = stage("square", (0.4, 0.8, 1.1), eye=(0, -2, 1.2), degrees=50)
    material.write_maps(obj, solution("one-lobe", values))
    error = errors(values, lambda L, V, N, maps: brdf.principled(maps["base"], maps["lobes"][:, 0], L, V, N))
    assert error.max() < 0.001 and error.mean() < 0.00002


@pytest.mark.parametrize("level", [0.0, 0.2, 0.5, 0.8, 1.0, None])
def test_specular_level(level: float | None) -> None:
    """One value for the material, or a map (None)."""
    rng = np.random.default_rng(5)
    values = {"base": rng.uniform(0.05, 0.9, (TEXELS, TEXELS, 3)),
              "roughness": rng.uniform(0.2, 0.9, (TEXELS, TEXELS)),
              "specular": rng.uniform(0, 1, (TEXELS, TEXELS)) if level is None else level}
    obj = stage("square", (0.4, 0.8, 1.1), eye=(0, -2, 1.2), degrees=50)
    material.write_maps(obj, solution("one-lobe-specular", values, level=level))
    error = errors(values, lambda L, V, N, maps: brdf.principled(
        maps["base"], maps["roughness"], L, V, N, level=maps["specular"]))
    assert error.max() < 0.001 and error.mean() < 0.00002, (error.max(), error.mean())


@pytest.mark.parametrize(("metallic", "level"), [(0.3, None), (0.6, 0.8), (1.0, None)])
def test_metallic(metallic: float, level: float | None) -> None:
    """One value for the material, with a Specular IOR Level that was found too, or the usual one."""
    rng = np.random.default_rng(6)
    values = {"base": rng.uniform(0.05, 0.9, (TEXELS, TEXELS, 3)),
              "roughness": rng.uniform(0.2, 0.9, (TEXELS, TEXELS))}
    obj = stage("square", (0.4, 0.8, 1.1), eye=(0, -2, 1.2), degrees=50)
    found = replace(solution("one-lobe-metallic", values, level=level), metallic={"material": metallic})
    material.write_maps(obj, found)
    error = errors(values, lambda L, V, N, maps: brdf.principled(
        maps["base"], maps["roughness"], L, V, N, level=0.5 if level is None else level, metallic=metallic))
    assert error.max() < 0.001 and error.mean() < 0.00002, (error.max(), error.mean())


@pytest.mark.parametrize("metallic", [0.0, 0.6])
def test_coat(metallic: float) -> None:
    """Above the maps; the IOR and the tint that the user's coat had are not this one's."""
    rng = np.random.default_rng(7)
    values = {"base": rng.uniform(0.05, 0.9, (TEXELS, TEXELS, 3)),
              "roughness": rng.uniform(0.3, 0.9, (TEXELS, TEXELS))}
    obj = stage("square", (0.4, 0.8, 1.1), eye=(0, -2, 1.2), degrees=50)
    principled = next(n for n in obj.data.materials[0].node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    principled.inputs["Coat IOR"].default_value = 2.0
    principled.inputs["Coat Tint"].default_value = (0.2, 0.9, 0.4, 1)
    coat, model = Coat(0.7, 0.3), "one-lobe-metallic" if metallic else "one-lobe-specular"
    found = replace(solution(model, values, level=0.4), metallic={"material": metallic}, coats={"material": coat})
    material.write_maps(obj, found)
    error = errors(values, lambda L, V, N, maps: brdf.principled(
        maps["base"], maps["roughness"], L, V, N, level=0.4, metallic=metallic, coat=coat))
    assert error.max() < 0.001 and error.mean() < 0.00002, (error.max(), error.mean())


@pytest.mark.parametrize("diffuse", [0.25, 1.0])
def test_diffuse_roughness(diffuse: float) -> None:
    """Below the maps of one lobe at a level; the one that the user had is not this one's."""
    rng = np.random.default_rng(8)
    values = {"base": rng.uniform(0.05, 0.9, (TEXELS, TEXELS, 3)),
              "roughness": rng.uniform(0.3, 0.9, (TEXELS, TEXELS))}
    obj = stage("square", (0.4, 0.8, 1.1), eye=(0, -2, 1.2), degrees=50)
    principled = next(n for n in obj.data.materials[0].node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    principled.inputs["Diffuse Roughness"].default_value = 0.6
    material.write_maps(obj, replace(solution("one-lobe-specular", values, level=0.4),
                                     diffuse_roughness={"material": diffuse}))
    error = errors(values, lambda L, V, N, maps: brdf.principled(
        maps["base"], maps["roughness"], L, V, N, level=0.4, diffuse_roughness=diffuse))
    assert error.max() < 0.001 and error.mean() < 0.00002, (error.max(), error.mean())


@pytest.mark.parametrize("linked", [True, False])
def test_all_other_settings_carry_over(linked: bool) -> None:
    """Two equal lobes render as the one Principled did, whatever else is set or linked on it.

    Not linked, Normal and Tangent are the surface's own, not the zero vector of the group's input.
    """
    obj = stage("sphere", LAMPS["beside"])
    tree = obj.data.materials[0].node_tree
    nodes, links = tree.nodes, tree.links
    principled = next(n for n in nodes if n.type == "BSDF_PRINCIPLED")
    plain = rig.render()["rgb"]
    if linked:
        noise, bump, turn = (nodes.new(f"ShaderNode{kind}") for kind in ("TexNoise", "Bump", "Tangent"))
        links.new(noise.outputs[0], bump.inputs["Height"])
        links.new(bump.outputs["Normal"], principled.inputs["Normal"])
        links.new(bump.outputs["Normal"], principled.inputs["Coat Normal"])
        links.new(turn.outputs["Tangent"], principled.inputs["Tangent"])
        links.new(noise.outputs[0], principled.inputs["Sheen Weight"])
    for name, value in {"Coat Weight": 0.6, "Coat Roughness": 0.3, "Anisotropic": 0.5, "Metallic": 0.2, "IOR": 1.4,
                        "Emission Strength": 0.01, "Specular Tint": (0.9, 0.5, 0.4, 1)}.items():
        principled.inputs[name].default_value = value
    one = {"base": (0.3, 0.5, 0.2), "roughness": 0.4}
    two = {"base": (0.3, 0.5, 0.2), "lobes": (0.4, 0.4, 0.3)}
    material.write_maps(obj, solution("one-lobe", one))
    expected = rig.render()["rgb"]
    assert np.abs(expected - plain).max() > 0.01
    material.write_maps(obj, solution("two-lobe", two))
    np.testing.assert_allclose(rig.render()["rgb"], expected, rtol=1e-4, atol=1e-6)
    material.write_maps(obj, solution("one-lobe", one))
    np.testing.assert_array_equal(rig.render()["rgb"], expected)
