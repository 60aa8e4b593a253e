"""Texels of which the model leaves more than of their material's others: they are less sure than their own data say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.gpu.maps.finish_maps import unexplained
from tests.support import synthetic as syn
from tests.support.shoots import SIZE, errors, rig, run

SHADOW, HALF = 0.62, 0.1  # middle of a square of the map, both ways, and half its side
Z90 = 1.645
CONTRADICT = "of its solved texels contradict each other"


@pytest.mark.parametrize("observations", [4, 8, 24, 96])
def test_noise_alone_leaves_texels_as_sure_as_they_are(observations: int) -> None:
    """Residuals that chance spreads: one texel in fifty is doubted at the most, and by little."""
    rng = np.random.default_rng(5)
    count = np.full((100, 100), observations, np.float32)
    left = np.sqrt(1e-4 * rng.chisquare(observations - 2, count.shape) / observations).astype(np.float32)
    found = unexplained(left, count, np.zeros(count.shape, np.int32))
    assert (found > 1).mean() < 0.02
    assert np.quantile(found, 0.999) < 2


def test_each_material_is_its_own_measure() -> None:
    """A material that is explained ten times worse, everywhere: no texel of it is worse than the others."""
    slots = np.zeros((20, 20), np.int32)
    slots[10:] = 1
    left = np.where(slots == 1, np.float32(0.1), np.float32(0.01))
    left[3, 3] = 0.1
    found = unexplained(left, np.full(left.shape, 24, np.float32), slots)
    assert 100 / 2.2 < found[3, 3] < 100 / 1.8  # of 22 degrees of freedom, chi-squared is seldom twice its median
    assert (np.delete(found.ravel(), 3 * 20 + 3) == 1).all()


def test_what_was_not_solved_does_not_count() -> None:
    left = np.full((8, 8), 0.01, np.float32)
    left[0] = 5.0
    slots = np.zeros(left.shape, np.int32)
    slots[0] = -1
    assert (unexplained(left, np.full(left.shape, 24, np.float32), slots) == 1).all()


@pytest.mark.one_python
def test_shadows_that_the_mesh_does_not_cast_are_said_and_spoil_no_interval() -> None:
    """A square that half of the views show in a shadow which the scene does not explain.

    Its base colour is off by 0.07, and the errors of fits to 12 dark and 12 light observations said 0.004: no 90 %
    interval of it held the truth.
    """
    made = syn.shoot(syn.PATCHES, rig(12, 2))
    assert not any(CONTRADICT in line for line in run(made).warnings)
    rng = np.random.default_rng(1)
    images = {}
    for n, view in enumerate(made.scene.views):
        image = made.images[view.image.name]
        noise = 1 + 0.01 * rng.standard_normal(image.rgb.shape)
        height, width = image.rgb.shape[:2]
        shown = syn.plane_uv(syn.meet_plane(*syn.pixel_rays(view.camera, width, height)))
        dark = (np.abs(shown - SHADOW) < HALF).all(-1) & (n % 2 == 0)
        images[view.image.name] = replace(
            image, rgb=(image.rgb * noise * np.where(dark, 0.03, 1)[..., None]).astype(np.float32))
    found = run(replace(made, images=images))
    v, u = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    inside = (np.abs(u - SHADOW) < 0.7 * HALF) & (np.abs(v - SHADOW) < 0.7 * HALF) & ~found.maps.filled
    off = np.abs((found.maps.base_color - syn.PATCHES.base(u, v)).mean(-1))
    held = off <= Z90 * found.maps.base_sigma
    assert off[inside].mean() > 0.03  # else this shows nothing
    assert held[inside].mean() > 0.85
    assert not found.maps.confidence[inside].any()
    assert 0.85 < held[~inside & ~found.maps.filled].mean() < 0.97
    assert errors(found, syn.PATCHES).share > 0.99
    assert any(CONTRADICT in line for line in found.warnings)
    assert 0.04 <= found.checks.contradicted < 0.06  # a square of 0.2, and pixels at its edge


@pytest.mark.one_python
def test_smoother_than_is_searched() -> None:
    """Roughness 0.03: the search ends at 0.05, and the standard errors of the surest do not contain 0.03."""
    smooth = replace(syn.PATCHES, roughness=lambda u, v: np.full_like(np.asarray(u, np.float64), 0.03))
    maps = run(syn.shoot(smooth, rig(12, 4), (64, 64), samples=4, noise=0.003), model="one-lobe", size=64).maps
    ended = maps.coverage & ~maps.filled & (maps.roughness < 0.0501)
    assert ended.mean() > 0.2  # else this shows nothing
    assert (np.abs(maps.roughness - 0.03) <= Z90 * maps.roughness_sigma)[ended].mean() > 0.95
    assert 0.028 < maps.roughness_sigma[ended].min() < 0.035
