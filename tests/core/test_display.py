"""Figures of two results, marks of a chart's axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import Maps
from irpso_addon.core.evaluation.chart_data import linear_ticks, log_ticks
from irpso_addon.core.evaluation.display import apart, reduced, white


@pytest.fixture
def maps() -> Maps:
    """Eight by eight texels: the lowest row outside the islands, the next one filled."""
    rng = np.random.default_rng(3)
    some = rng.random((8, 8)).astype(np.float32)
    filled, coverage = np.zeros((8, 8), bool), np.ones((8, 8), bool)
    coverage[0], filled[:2] = False, True
    return Maps(base_color=rng.random((8, 8, 3)).astype(np.float32), roughness=some, confidence=some, error=some,
                filled=filled, coverage=coverage, roughness_sigma=some, base_sigma=some)


def test_a_result_does_not_differ_from_itself(maps):
    same = apart(maps, maps)
    assert (same.base_rms, same.rough_mean, same.rough_high) == (0, 0, 0)
    assert same.texels == pytest.approx(6 / 7)  # the filled row is left out


def test_known_differences_are_told(maps):
    """What is filled or outside may differ as it likes."""
    rough = maps.roughness + np.float32(0.03)
    rough[:2] += 10
    rough[2, 0] += np.float32(0.5)
    told = apart(maps, replace(maps, roughness=rough, base_color=maps.base_color - np.float32(0.02)))
    assert told.base_rms == pytest.approx(0.02, rel=1e-4)
    assert told.rough_mean == pytest.approx(0.03 + 0.5 / 48, rel=1e-4)
    assert told.rough_high == pytest.approx(0.03, rel=1e-4)  # one texel of 48 lies above


def test_sizes_may_differ(maps):
    """A map and the same at twice the size are one result."""
    large = Maps(**{name: np.kron(array, np.ones((2, 2) + (1,) * (array.ndim - 2), array.dtype))
                    for name, array in vars(maps).items() if array is not None})
    assert apart(large, maps).rough_high == 0 and apart(maps, large).base_rms == 0


def test_nothing_in_common_is_no_figure(maps):
    nowhere = replace(maps, coverage=np.zeros((8, 8), bool))
    assert np.isnan(apart(maps, nowhere).base_rms) and apart(maps, nowhere).texels == 0


def test_a_few_bright_pixels_do_not_darken_the_picture():
    picture = np.full((20, 20, 3), 0.25, np.float16)
    picture[0, :5] = 60.0
    picture[1:3] = np.nan
    assert white(picture) == pytest.approx(0.25)
    assert white(np.full((2, 2, 3), np.nan, np.float16)) == 1.0


@pytest.mark.parametrize(("size", "side"), [(64, 64), (65, 33), (300, 60)])
def test_reduced_fits(size, side):
    assert reduced(np.zeros((size, size // 2), np.float32), 64).shape[0] == side


def test_marks_are_round_and_within():
    assert log_ticks(0.9, 60.0) == pytest.approx([1, 2, 5, 10, 20, 50])
    assert log_ticks(0.02, 300.0) == pytest.approx([0.1, 1, 10, 100])
    assert linear_ticks(0.0, 7.2) == pytest.approx([0, 2, 4, 6])
    assert linear_ticks(0.0, 1.0) == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1.0])
