"""The float64 BRDF against Cycles' pixels."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from irpso_addon.core.shading import brdf, lights
from tests.blender import cycles_rig as rig
from tests.blender.measure_brdf import (
    COATS,
    LEVELS,
    METALLICS,
    ROUGHNESSES,
    Pixels,
    conductor_is_exact,
    measure,
    measure_two_lobes,
)


@pytest.fixture(scope="module")
def found() -> list[Pixels]:
    return list(measure(pixels=64, few=True))


@pytest.mark.parametrize("roughness", ROUGHNESSES)
def test_principled_equals_the_pixels_to_75_degrees(found, roughness):
    """0.5 % at any pixel and 0.05 % on average; from roughness 0.2 on, where Cycles' own float32 is finer, a tenth."""
    parts = [p for p in found if p.roughness == roughness]
    error = np.concatenate([p.error[(p.degrees < 75) & ~p.peak] for p in parts])
    assert len(error) > 4000
    finer = 1 if roughness < 0.2 else 10
    assert error.max() < 0.005 / finer
    assert error.mean() < 0.0005 / finer


def test_principled_equals_the_pixels_beyond(found):
    error = np.concatenate([p.error[(p.degrees >= 75) & ~p.peak] for p in found])
    assert len(error) > 4000
    assert error.max() < 0.01
    assert error.mean() < 0.0002


def test_the_peak_is_right_too(found):
    error = np.concatenate([p.error[p.peak] for p in found])
    assert len(error) > 20
    assert error.max() < 0.02


@pytest.fixture(scope="module")
def found_by_level() -> list[Pixels]:
    return list(measure(pixels=48, few=True, roughnesses=(0.3, 0.7), levels=LEVELS))


@pytest.mark.parametrize("level", LEVELS)
def test_specular_level_equals_the_pixels(found_by_level, level):
    """As at level 0.5: 0.05 % at any pixel and 0.005 % on average to 75 degrees, 1 % and 0.02 % beyond."""
    parts = [p for p in found_by_level if p.level == level]
    error, degrees = (np.concatenate([getattr(p, k) for p in parts]) for k in ("error", "degrees"))
    assert len(error) > 4000
    assert error[degrees < 75].max() < 5e-4
    assert error[degrees < 75].mean() < 5e-5
    assert error[degrees >= 75].max() < 0.01
    assert error[degrees >= 75].mean() < 2e-4


@pytest.fixture(scope="module")
def found_by_metallic() -> list[Pixels]:
    return list(measure(pixels=48, few=True, roughnesses=(0.1, 0.3, 0.6, 1.0), levels=(0.2, 0.5), metallics=METALLICS))


@pytest.mark.parametrize("metallic", METALLICS)
def test_metallic_equals_the_pixels(found_by_metallic, metallic):
    """Of a metal and of a mixture: 0.02 % at any pixel and 0.002 % on average from roughness 0.3 on, 0.3 % below."""
    parts = [p for p in found_by_metallic if p.metallic == metallic]
    error, rough = (np.concatenate(x) for x in zip(*[(p.error, np.full(len(p.error), p.roughness)) for p in parts],
                                                   strict=True))
    assert len(error) > 4000
    assert error[rough >= 0.3].max() < 2e-4
    assert error[rough >= 0.3].mean() < 2e-5
    assert error[rough < 0.3].max() < 3e-3
    assert error[rough < 0.3].mean() < 1e-4


@pytest.mark.parametrize("coat", COATS)
def test_a_coat_equals_the_pixels(coat):
    """Above a dielectric and a metal: 0.02 % at any pixel and 0.002 % on average to 75 degrees, 0.1 % beyond."""
    parts = list(measure(pixels=48, few=True, roughnesses=(0.4, 0.8), levels=(0.3,), metallics=(0.0, 0.5), coat=coat))
    error, degrees = (np.concatenate([getattr(p, k) for p in parts]) for k in ("error", "degrees"))
    assert len(error) > 4000
    assert error[degrees < 75].max() < 2e-4
    assert error[degrees < 75].mean() < 2e-5
    assert error.max() < 1e-3


@pytest.mark.parametrize("ndf", ["ggx", "beckmann"])
def test_two_lobes_equal_the_pixels(ndf):
    if ndf == "beckmann" and not conductor_is_exact():
        pytest.skip("this Blender's physical conductor has no exact Fresnel")
    parts = list(measure_two_lobes(ndf, pixels=64, few=True))
    error, degrees, peak = (np.concatenate([getattr(p, k) for p in parts]) for k in ("error", "degrees", "peak"))
    assert len(error) > 4000
    assert error[(degrees < 75) & ~peak].max() < 0.002
    assert error[(degrees < 75) & ~peak].mean() < 5e-5
    assert error.mean() < 2e-4


def test_beckmann_without_fresnel_equals_glossy_in_every_version():
    """The Glossy BSDF is D G2 / (4 cos_l cos_v)."""
    rig.scene(48)
    rig.principled(rig.plane(), (1, 1, 1), 0.5)
    rig.camera((0, -2, 1.2))
    light = rig.as_light(rig.lamp("POINT", (0.4, 0.8, 1.1)))
    tree = bpy.data.materials["material"].node_tree
    glossy = tree.nodes.new("ShaderNodeBsdfAnisotropic")
    glossy.distribution = "BECKMANN"
    glossy.inputs["Color"].default_value, glossy.inputs["Roughness"].default_value = (1, 1, 1, 1), 0.6
    tree.links.new(glossy.outputs[0], next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL").inputs["Surface"])
    image = rig.render()
    P, N = image["position"], image["normal"]
    view, toward = np.array([0, -2, 1.2]) - P, lights.light_sample(light, P, 0, 1)[0]
    V, L = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (view, toward))
    at = brdf.angles(L, V, N)
    lobe = brdf.specular_beckmann(0.6, at.sin2h, 0.0, at.cos_l, at.cos_v, at.cos_vh) / brdf.F_dielectric(at.cos_vh)
    expected = lobe * lights.light_irradiance(light, P, N) * light.power[0]
    bright = (N[..., 2] > 0.5) & (expected > 1e-5 * expected.max())
    assert bright.mean() > 0.4
    np.testing.assert_allclose(image["rgb"][bright][:, 0], expected[bright], rtol=5e-4)


def test_specular_level_zero_is_lambert():
    """What the model "lambert" assumes: base / pi, nothing taken by a specular layer."""
    rig.scene(48)
    rig.principled(rig.plane(), (0.2, 0.5, 0.9), 0.3, specular=0.0)
    rig.camera((0, -2, 1.2))
    light = rig.as_light(rig.lamp("POINT", (0.4, 0.8, 1.1)))
    image = rig.render()
    irradiance = lights.light_irradiance(light, image["position"], image["normal"])
    expected = irradiance[..., None] * light.power * np.array([0.2, 0.5, 0.9]) / np.pi
    lit = image["normal"][..., 2] > 0.5
    assert lit.mean() > 0.5
    np.testing.assert_allclose(image["rgb"][lit], expected[lit], rtol=2e-5)
