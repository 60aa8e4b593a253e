"""Vignetting that cameras show of the same texels: how much of it is believed where they share few of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.calibration.falloff import edge_falloff
from irpso_addon.core.calibration.rig import Rig
from irpso_addon.core.calibration.rig_fit import fit_rig
from irpso_addon.core.calibration.rig_numbers import Free
from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.job import run_to_end
from tests.support import synthetic as syn
from tests.support import tilted_sphere as balls

BESIDE = 0.9, 0.0, 0.0  # where the second camera looks, past the sphere
PLACE = 0.0, 0.0, 3.0
OFF = 0.05  # relative: by how much the two cameras' pixels differ in a cluster of texels


def two_cameras(shared: int, power: float, seed: int) -> RigSample:
    """A matt sphere of which two cameras at one place, that look elsewhere, share a number of clusters of texels."""
    rng = np.random.default_rng(seed)
    one = balls.sphere(lambda way, normal: balls.BASE / np.pi + 0 * normal, lamps=8, noise=0.003, seed=seed)[0].rig
    both = balls.seen_twice(one, np.zeros(8), np.zeros(16))
    cameras = [syn.camera(PLACE, target, degrees=50, name=name)
               for target, name in (((0, 0, 0), "Camera"), (BESIDE, "Other"))]
    rig = Rig.of([replace(view, camera=cameras[n // 8]) for n, view in enumerate(both.rig.views)], np.zeros(3))
    both = replace(both, rig=rig)
    clusters, of = np.unique(both.cluster, return_inverse=True)
    order = rng.permutation(len(clusters))
    part = np.where(order < shared, 2, order % 2)[of]  # 2: seen by both
    seen = (part[:, None] == 2) | (part[:, None] == both.texels.camera)
    off = np.where(both.texels.camera == 1, OFF * rng.standard_normal(len(clusters))[of][:, None], 0.0)
    radiance = both.texels.reflected * np.exp(off + power * both.geometry.cosine)[..., None]
    return replace(both, texels=replace(both.texels, reflected=radiance, quality=both.texels.quality * seen))


def falloff(sample: RigSample):
    found = run_to_end(fit_rig(sample, Free(False, False), rounds=1), lambda progress: None)
    return edge_falloff(sample, found)


@pytest.mark.parametrize("shared", [3, 5])
def test_a_few_shared_places_show_no_vignetting(shared: int) -> None:
    """Five numbers are fitted: the scatter that as few clusters leave over is no measure of what they are off by."""
    assert not [seed for seed in range(6) if falloff(two_cameras(shared, 0.0, seed)) is not None]


def test_many_shared_places_show_it() -> None:
    for seed in range(3):
        found = falloff(two_cameras(60, 3.0, seed))
        assert found is not None and abs(found.power - 3.0) < 3 * found.error < 3.0
