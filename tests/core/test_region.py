"""How a region fades, against distances by brute force; resampling, against a formula."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from irpso_addon.core.data import Maps
from irpso_addon.core.maps import region

SIZE = 256  # where the seam has its full width


def sheet(size: int = SIZE, gap: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Positions of a flat sheet of 2 m, and what is covered; a ``gap`` tears the map, not the sheet, in the middle."""
    at = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(at, at)
    covered = np.ones((size, size), bool)
    if gap:  # an island of its own: the map is torn in the middle, the sheet is not
        covered[:, size // 2 - gap:size // 2 + gap] = False
        x = x - np.sign(x) * 2 * gap / size
    return np.stack([x, y, np.zeros_like(x)], -1).astype(np.float32), covered


@pytest.mark.parametrize("gap", [0, 20])
def test_fades_over_the_seam_also_across_a_tear_of_the_map(gap: int) -> None:
    position, covered = sheet(gap=gap)
    inside = covered & (np.hypot(position[..., 0] - 0.1, position[..., 1]) < 0.4)
    weight = region.fade(position, covered, inside)
    texel = 2 / SIZE
    # By brute force: the distance in space from each texel to the nearest inside.
    whole = inside.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            whole &= np.roll(inside, step, axis)
    border = position[inside & ~whole]
    far = np.zeros(covered.shape)
    for row in range(SIZE):
        far[row] = np.linalg.norm(position[row, :, None] - border, axis=-1).min(1) / texel
    far[inside] = 0
    assert (weight[inside] == 1).all() and (weight[~covered] == 0).all()
    assert (weight[covered & (far > 2.1 * region.SEAM)] == 0).all()
    assert (weight[covered & (far < 0.3 * region.SEAM)] > 0.3).all()
    assert 0.2 < np.median(weight[covered & (np.abs(far - 0.5 * region.SEAM) < 0.5)]) < 0.8
    # No step from texel to neighbouring texel, on the sheet: a soft seam.
    step = np.abs(np.diff(weight, axis=1))[(covered & ~inside)[:, 1:] & (covered & ~inside)[:, :-1]]
    assert step.max() < 0.35


def test_what_touches_nothing_does_not_fade() -> None:
    position, covered = sheet(32)
    np.testing.assert_array_equal(region.fade(position, covered, covered), 1)
    np.testing.assert_array_equal(region.fade(position, covered, ~covered), 0)


@pytest.mark.parametrize("size", [5, 16, 40])
def test_resampled_at_texel_centres(size: int) -> None:
    h, w = 12, 20
    y, x = np.mgrid[:h, :w]
    plane = (2 + 3 * (x + 0.5) / w - 5 * (y + 0.5) / h)[..., None] * np.array([1.0, 2.0])
    u, v = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size)
    between = (np.abs(u - 0.5) < 0.5 - 0.5 / w) & (np.abs(v - 0.5) < 0.5 - 0.5 / h)
    found = region.resampled(plane.astype(np.float32), size)
    want = (2 + 3 * u - 5 * v)[..., None] * np.array([1.0, 2.0])
    np.testing.assert_allclose(found[between], want[between], atol=1e-5)
    assert plane.min() - 1e-6 < found.min() and found.max() < plane.max() + 1e-6  # a roughness stays one at the rim


def test_resized_maps_know_nothing_next_to_what_was_filled() -> None:
    n = 8
    rng = np.random.default_rng(0)
    grey = {f.name: rng.random((n, n)).astype(np.float32) for f in fields(Maps)}
    filled = np.zeros((n, n), bool)
    filled[2, 3] = True
    maps = Maps(**{**grey, "base_color": rng.random((n, n, 3)).astype(np.float32), "filled": filled,
                   "coverage": np.ones((n, n), bool), "lobes": None, "specular": None})
    assert region.resized(maps, n) is maps
    large = region.resized(maps, 2 * n)
    assert large.filled.dtype == bool and large.lobes is None and large.base_color.shape == (2 * n, 2 * n, 3)
    rows, columns = np.nonzero(large.filled)
    assert set(rows) == {3, 4, 5, 6} and set(columns) == {5, 6, 7, 8}
    assert abs(large.roughness.mean() - maps.roughness.mean()) < 0.02
