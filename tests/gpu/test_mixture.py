"""Intervals where pixels mix texels or paints meet: what is added to the variances of roughness and base colour."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.maps.mixture import between_paints, mixture

N = 60
Y, X = np.mgrid[:N, :N].astype(np.float32)
SOLVED = np.ones((N, N), bool)
INSIDE = np.s_[8:-8, 8:-8]


def test_a_plane_mixes_nothing() -> None:
    roughness = 0.2 + 0.004 * X + 0.002 * Y
    assert mixture(roughness, np.full((N, N), 1e-4, np.float32), SOLVED, 3.0)[INSIDE].max() < 1e-7


def test_pixels_that_are_smaller_than_texels_mix_nothing() -> None:
    checks = (0.2 + 0.5 * ((X + Y) % 2)).astype(np.float32)
    assert not mixture(checks, np.zeros((N, N), np.float32), SOLVED, 0.6).any()


def test_noise_that_the_standard_error_knows_adds_little() -> None:
    sigma = np.full((N, N), 0.03, np.float32)
    noisy = (0.4 + 0.03 * np.random.default_rng(2).standard_normal((N, N))).astype(np.float32)
    assert np.median(mixture(noisy, sigma, SOLVED, 2.0)[INSIDE]) < 0.5 * 0.03**2


@pytest.mark.parametrize("pixel", [1.0, 2.0, 3.0])
def test_variance_that_no_standard_error_knows_counts_twice(pixel: float) -> None:
    spread = 0.1
    rough = (0.4 + spread * np.random.default_rng(3).standard_normal((N, N))).astype(np.float32)
    found = mixture(rough, np.full((N, N), 1e-4, np.float32), SOLVED, pixel)[INSIDE]
    assert found.mean() == pytest.approx(2 * spread**2, rel=0.1)


def test_what_is_not_solved_says_nothing() -> None:
    solved = SOLVED.copy()
    solved[:, 30:] = False
    rough = np.where(solved, np.float32(0.3), np.float32(0.9))
    assert not mixture(rough, np.full((N, N), 1e-4, np.float32), solved, 2.0).any()


def interpolated(size: int, points: int) -> np.ndarray:
    """(points, size): a row of texels of a texture with linear interpolation, looked up at ``points``."""
    at = (np.arange(points) + 0.5) * size / points - 0.5
    low, share = np.floor(at).astype(int), at - np.floor(at)
    rows = np.zeros((points, size))
    np.add.at(rows, (np.arange(points), np.clip(low, 0, size - 1)), 1 - share)
    np.add.at(rows, (np.arange(points), np.clip(low + 1, 0, size - 1)), share)
    return rows


@pytest.mark.parametrize("slope", [0.21, 0.37, 0.62, 0.83])
def test_where_paints_meet_intervals_hold_the_mean_of_a_texel(slope: float) -> None:
    """The texture that fits stripes of two paints best is off by what is added."""
    finer = 8
    y, x = (np.mgrid[:finer * N, :finer * N] + 0.5) / finer
    fine = np.where((x + slope * y) % 17 < 7, 0.2, 0.7)
    fit = np.linalg.pinv(interpolated(N, finer * N))
    base = np.repeat((fit @ fine @ fit.T)[..., None], 3, -1).astype(np.float32)
    truth = fine.reshape(N, finer, N, finer).mean((1, 3))
    added = between_paints(base, np.full((N, N), 1e-4, np.float32), SOLVED, 0.5)
    off = np.abs(base[..., 0] - truth)[INSIDE]
    border = off > 0.01
    assert border.mean() > 0.2
    assert np.mean(off[border] < 1.645 * np.sqrt(added[INSIDE][border])) > 0.6
    assert np.sqrt(np.mean(off**2) / added[INSIDE].mean()) == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("wave", [10.0, 16.0])
def test_paint_that_bends_steadily_adds_little(wave: float) -> None:
    """A thirtieth of what waves of the same height and width with hard borders add, or less."""
    smooth = np.sin(2 * np.pi * (X + 0.37 * Y) / wave)
    sigma = np.full((N, N), 1e-4, np.float32)
    bases = [np.repeat((0.5 + 0.25 * tone)[..., None], 3, -1).astype(np.float32) for tone in (smooth, np.sign(smooth))]
    added = [float(between_paints(base, sigma, SOLVED, 1.0)[INSIDE].mean()) for base in bases]
    assert 0 <= added[0] < added[1] / 30


def test_a_slope_of_base_colour_and_what_is_not_solved_add_nothing() -> None:
    base = np.repeat((0.1 + 0.004 * X + 0.006 * Y)[..., None], 3, -1)
    solved = SOLVED.copy()
    solved[:, 30:] = False
    base[:, 30:] = 0.9
    sigma = np.full((N, N), 1e-4, np.float32)
    added = between_paints(base, sigma, solved, 1.0)
    assert added[8:-8, 8:29].max() < 1e-7
    assert not added[:, 30:].any()
