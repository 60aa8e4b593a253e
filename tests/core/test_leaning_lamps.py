"""Suns that are believed elsewhere come back where the diffuse is not Lambert's: they do not lean to make up for it."""

from __future__ import annotations

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
    lit = balls.directions(np.random.default_rng(1), 800, 24)[1]
    lights = sample.rig.rig.lights(judged.found.change)
    left = [balls.degrees_between(lights[f"Sun {n}"].matrix[:3, 2], way) for n, way in enumerate(lit)]
    assert np.median(left) < off


def test_right_suns_stay_beside_a_rough_diffuse() -> None:
    """Without its number all 24 suns leant by 6 degrees."""
    sample, _ = balls.sphere(glossy(rough(0.5)), texels=800, noise=0.01)
    assert run_to_end(calibrate(sample.rig, lamps=True, exposures=True), lambda progress: None) is None
