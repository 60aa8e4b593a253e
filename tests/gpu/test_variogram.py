"""Variance of a roughness that a texel has from its neighbours: against fields whose variogram is known."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.gpu.maps.variogram import DISTANCES, borrowed_variance, variogram

N = 96
Y, X = np.mgrid[:N, :N]
SLOTS = np.zeros((N, N), np.int32)
NOTHING = np.zeros((N, N), np.float32)


def stripes(width: int) -> np.ndarray:
    """Roughness 0.2 and 0.6 in turn."""
    return np.where(X // width % 2 == 1, 0.6, 0.2).astype(np.float32)


def informed(step: int) -> np.ndarray:
    """Every so manyth texel in both directions is determined by its own data."""
    return ((X % step == 0) & (Y % step == 0)).astype(np.float32)


def test_variogram_of_stripes_by_hand() -> None:
    """Over 5 edges between stripes of 16, 5 d of 96 - d pairs that are d apart differ, by 0.4; along them none."""
    found = variogram(stripes(16).astype(np.float64), np.zeros((N, N)), np.ones((N, N)))
    assert found is not None
    for apart, value in zip(DISTANCES[:5], found, strict=False):
        assert value == pytest.approx(0.5 * 0.16 * 5 * apart / (N - apart), rel=1e-6)
    assert found[5] == found[4]  # 32 apart stripes are alike again; the curve never falls


def test_the_texels_own_errors_are_not_counted() -> None:
    noise = np.random.default_rng(1).normal(0.4, 0.05, (N, N))
    found = variogram(noise, np.full((N, N), 0.05), np.ones((N, N)))
    assert found is not None and found.max() < 0.2 * 2 * 0.05**2  # of what it is where no error is known
    unknown = variogram(noise, np.zeros((N, N)), np.ones((N, N)))
    assert unknown is not None and unknown[0] == pytest.approx(2 * 0.05**2, rel=0.05)


def test_what_its_own_data_determine_borrows_nothing() -> None:
    found, known = borrowed_variance(stripes(4), NOTHING, np.ones((N, N), np.float32), SLOTS, 1.5)
    assert not found.any() and known.all()


def test_intervals_of_borrowed_roughness_hold_the_truth() -> None:
    """A random field of which every fourth texel is known in each direction; the others take the nearest one's.

    90 % intervals by these variances hold 85 % and more, and are not much wider than the errors."""
    rng = np.random.default_rng(3)
    field = sum(np.cos(2 * np.pi * (rng.uniform(-3, 3) * X + rng.uniform(-3, 3) * Y) / N + rng.uniform(0, 6.3))
                for _ in range(12))
    truth = (0.4 + 0.04 * np.asarray(field)).astype(np.float32)
    share = informed(4)
    nearest = truth[(Y + 2) // 4 * 4 % N, (X + 2) // 4 * 4 % N]
    found, _ = borrowed_variance(np.where(share > 0, truth, nearest), NOTHING, share, SLOTS, 1.0)
    inside = (share == 0) & (X < N - 3) & (Y < N - 3)
    error, sigma = np.abs(nearest - truth)[inside], np.sqrt(found)[inside]
    assert 0.85 < np.mean(error <= 1.645 * sigma) <= 1.0
    assert np.sqrt(np.mean(sigma**2)) < 3 * np.sqrt(np.mean(error**2))


def test_farther_from_data_is_less_sure() -> None:
    share = np.where(X < 32, informed(1), 0).astype(np.float32)
    found, _ = borrowed_variance(stripes(16), NOTHING, share, SLOTS, 1.0)
    near, far = found[40, 34], found[40, 60]
    assert 0 < near < far and far >= 0.5 * 0.16 * 0.9


def test_texels_of_one_pixel_repeat_each_other() -> None:
    """Informed texels in the width of a pixel count once, and no data are nearer than a pixel."""
    share = np.full((N, N), 0.9, np.float32)
    fine, coarse = (borrowed_variance(stripes(16), NOTHING, share, SLOTS, pixel)[0] for pixel in (1.0, 4.0))
    assert np.median(coarse) > 2 * np.median(fine) > 0


def test_materials_do_not_tell_of_each_other() -> None:
    """One varies, one does not; of a third nothing is known, because none of its texels is informed."""
    slots = np.select([Y < 32, Y < 64], [0, 1], 2).astype(np.int32)
    rough = np.where(slots == 0, stripes(4), np.float32(0.3)).astype(np.float32)
    share = np.where(slots == 2, 0, informed(2)).astype(np.float32)
    found, known = borrowed_variance(rough, NOTHING, share, slots, 1.0)
    empty = share == 0
    assert np.sqrt(found[(slots == 0) & empty]).mean() > 0.1 and found[slots == 1].max() < 1e-6
    np.testing.assert_array_equal(known, slots != 2)
    unsolved, told = borrowed_variance(rough, NOTHING, share, np.full((N, N), -1, np.int32), 1.0)
    assert not unsolved.any() and told.all()
