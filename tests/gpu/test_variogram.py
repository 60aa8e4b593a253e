"""Variance of a roughness that a texel has from its neighbours: against fields whose variogram is known."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.gpu.maps.variogram import DISTANCES, KINDS, borrowed_variance, colour_kinds, variogram

N = 96
Y, X = np.mgrid[:N, :N]
SLOTS = np.zeros((N, N), np.int32)
NOTHING = np.zeros((N, N), np.float32)
GREY = np.full((N, N, 3), 0.3, np.float32)


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
    found, known = borrowed_variance(stripes(4), NOTHING, np.ones((N, N), np.float32), SLOTS, 1.5, GREY)
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
    found, _ = borrowed_variance(np.where(share > 0, truth, nearest), NOTHING, share, SLOTS, 1.0, GREY)
    inside = (share == 0) & (X < N - 3) & (Y < N - 3)
    error, sigma = np.abs(nearest - truth)[inside], np.sqrt(found)[inside]
    assert 0.85 < np.mean(error <= 1.645 * sigma) <= 1.0
    assert np.sqrt(np.mean(sigma**2)) < 3 * np.sqrt(np.mean(error**2))


def test_farther_from_data_is_less_sure() -> None:
    share = np.where(X < 32, informed(1), 0).astype(np.float32)
    found, _ = borrowed_variance(stripes(16), NOTHING, share, SLOTS, 1.0, GREY)
    near, far = found[40, 34], found[40, 60]
    assert 0 < near < far and far >= 0.5 * 0.16 * 0.9


def test_texels_of_one_pixel_repeat_each_other() -> None:
    """Informed texels in the width of a pixel count once, and no data are nearer than a pixel."""
    share = np.full((N, N), 0.9, np.float32)
    fine, coarse = (borrowed_variance(stripes(16), NOTHING, share, SLOTS, pixel, GREY)[0] for pixel in (1.0, 4.0))
    assert np.median(coarse) > 2 * np.median(fine) > 0


def test_materials_do_not_tell_of_each_other() -> None:
    """One varies, one does not; of a third nothing is known, because none of its texels is informed."""
    slots = np.select([Y < 32, Y < 64], [0, 1], 2).astype(np.int32)
    rough = np.where(slots == 0, stripes(4), np.float32(0.3)).astype(np.float32)
    share = np.where(slots == 2, 0, informed(2)).astype(np.float32)
    found, known = borrowed_variance(rough, NOTHING, share, slots, 1.0, GREY)
    empty = share == 0
    assert np.sqrt(found[(slots == 0) & empty]).mean() > 0.1 and found[slots == 1].max() < 1e-6
    np.testing.assert_array_equal(known, slots != 2)
    unsolved, told = borrowed_variance(rough, NOTHING, share, np.full((N, N), -1, np.int32), 1.0, GREY)
    assert not unsolved.any() and told.all()


def paints(rough: np.ndarray, seed: int = 5) -> np.ndarray:
    """(N, N, 3) base colour: red where roughness is 0.2, green where it is 0.6, each with clouds of a sixth."""
    clouds = 1 + 0.15 * np.random.default_rng(seed).standard_normal((N, N, 1))
    base = np.where(rough[..., None] < 0.4, [0.55, 0.12, 0.08], [0.12, 0.4, 0.15]) * clouds
    return np.asarray(np.clip(base, 0.01, 0.9), np.float32)


def test_kinds_of_colour_part_two_paints() -> None:
    """No kind holds texels of both, though each paint has shades; what is not of the material has none."""
    mine = Y < 80
    kinds = colour_kinds(paints(stripes(6)), mine)
    assert np.all(kinds[~mine] == -1) and np.all(kinds[mine] >= 0) and kinds.max() < KINDS
    for kind in np.unique(kinds[mine]):
        assert len(np.unique(stripes(6)[mine & (kinds == kind)])) == 1
    one = colour_kinds(GREY, mine)
    assert len(np.unique(one[mine])) == 1


def test_where_colour_tells_roughness_its_own_colour_is_what_a_texel_borrows_from() -> None:
    """Stripes of two paints, of which the lower half is informed: above, a texel's own paint is near."""
    rough, share = stripes(6), np.where(Y < 48, 0.9, 0).astype(np.float32)
    noise = np.random.default_rng(8).normal(0, 0.01, (N, N)).astype(np.float32)
    sigma = np.full((N, N), 0.01, np.float32)
    plain, coloured = (borrowed_variance(rough + noise, sigma, share, SLOTS, 1.0, base)[0]
                       for base in (GREY, paints(rough)))
    near = (Y >= 48) & (Y < 64)
    assert np.sqrt(plain[near]).min() > 0.1 and np.sqrt(coloured[near]).max() < 0.05  # five times the noise
    np.testing.assert_array_equal(coloured <= plain, True)


def test_without_data_of_its_own_colour_a_texel_is_as_unsure_as_the_whole_material() -> None:
    """Only red texels are informed there: what they say does not make the green ones sure."""
    rough = stripes(6)
    share = np.where((Y < 32) | (rough < 0.4), 0.9, 0).astype(np.float32)
    plain, coloured = (borrowed_variance(rough, NOTHING, share, SLOTS, 1.0, base)[0] for base in (GREY, paints(rough)))
    far = (Y > 80) & (rough > 0.4)
    np.testing.assert_array_equal(coloured[far], plain[far])
    assert np.sqrt(plain[far]).min() > 0.1


def test_colours_that_tell_nothing_of_roughness_change_nothing() -> None:
    rough, share = stripes(6), informed(3)
    other = paints(stripes(6).T)  # across
    plain, coloured = (borrowed_variance(rough, NOTHING, share, SLOTS, 1.0, base)[0] for base in (GREY, other))
    np.testing.assert_array_equal(coloured, plain)
