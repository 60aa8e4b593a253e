"""Suns that are believed elsewhere come back where the diffuse is not Lambert's: they do not lean to make up for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.calibration.calibrate import calibrate
from irpso_addon.core.calibration.finish import Judged
from irpso_addon.core.job import run_to_end
from irpso_addon.core.shading import brdf
from tests.support import tilted_sphere as balls

pytestmark = pytest.mark.one_python

TURNED = np.radians(20.0)  # as where they were placed by eye


def bent(toward_light: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """As the matt figurine of the photographs reflects, about."""
    return balls.BASE / np.pi * np.clip((normal * toward_light).sum(-1), 1e-3, 1)[:, None] ** 0.15


def glossy(diffuse: balls.Reflect) -> balls.Reflect:
    """With the highlight of Principled, roughness 0.4."""
    black = balls.principled(0.4, 0 * balls.BASE)
    return lambda toward_light, normal: diffuse(toward_light, normal) + black(toward_light, normal)


def rough(roughness: float) -> balls.Reflect:
    """As the Principled BSDF with Diffuse Roughness."""
    def reflect(toward_light: np.ndarray, normal: np.ndarray) -> np.ndarray:
        both = np.full(len(normal), float(toward_light @ balls.TOWARD))
        return brdf.diffuse_rough(balls.BASE, normal @ toward_light, normal @ balls.TOWARD, both, roughness)
    return reflect


def off_in_the_median(sample: balls.TiltSample, judged: object) -> float:
    """Degrees by which 24 suns are off, as found."""
    assert isinstance(judged, Judged)
    lights = sample.rig.rig.lights(judged.found.change)
    lit = balls.directions(np.random.default_rng(1), 800, 24)[1]
    return float(np.median([balls.degrees_between(lights[f"Sun {n}"].matrix[:3, 2], way) for n, way in enumerate(lit)]))


@pytest.mark.parametrize(("diffuse", "off", "numbers"), [
    (balls.principled(0.4), 0.1, "lambert's"),
    (glossy(bent), 0.1, "cosine"),  # degrees; 3.5 without the numbers of a diffuse, here and in the next
    (glossy(balls.dielectric_diffuse), 0.4, "diffuse"),
    (glossy(rough(0.25)), 0.1, "diffuse"),  # 4.9 without the number of a rough surface
])
def test_suns_come_back(diffuse: balls.Reflect, off: float, numbers: str) -> None:
    sample, _ = balls.sphere(diffuse, texels=800, noise=0.01, turned=TURNED)
    judged = run_to_end(calibrate(sample.rig, lamps=True, exposures=True), lambda progress: None)
    assert isinstance(judged, Judged)
    found = {"cosine": judged.free.cosine, "diffuse": judged.free.diffuse, "lambert's": True}
    assert next(name for name, is_free in found.items() if is_free) == numbers
    assert off_in_the_median(sample, judged) < off


def test_suns_come_back_where_their_power_makes_base_colors_larger_than_1() -> None:
    """Base colors that ended at 1 made predictions too dark, and hid which suns were right: none came back."""
    sample, _ = balls.sphere(lambda light, normal: np.broadcast_to(3.2 * balls.BASE / np.pi, normal.shape), texels=800,
                             noise=0.01, turned=np.radians(3.0))
    texels = sample.rig.texels
    weak = replace(texels, reflected=1.25 * texels.reflected, irradiance=texels.irradiance / 1.25)  # red: 1.2
    sample = replace(sample, rig=replace(sample.rig, texels=weak))
    judged = run_to_end(calibrate(sample.rig, lamps=True, exposures=True), lambda progress: None)
    assert off_in_the_median(sample, judged) < 0.3  # 0.14


def test_right_suns_stay_beside_a_rough_diffuse() -> None:
    """Without its number all 24 suns leant by 6 degrees."""
    sample, _ = balls.sphere(glossy(rough(0.5)), texels=800, noise=0.01)
    assert run_to_end(calibrate(sample.rig, lamps=True, exposures=True), lambda progress: None) is None
