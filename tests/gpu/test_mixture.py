"""Intervals where pixels mix texels: what is added to the variance of roughness."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.gpu.maps.finish_maps import mixture

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
