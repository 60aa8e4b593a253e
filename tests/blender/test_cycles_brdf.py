"""The float64 BRDF against Cycles' pixels."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("bpy")

from irpso_addon.core import lights
from tests.blender import cycles_rig as rig
from tests.blender.measure_brdf import ROUGHNESSES, Pixels, measure


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
