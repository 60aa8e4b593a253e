"""Where a light seems to stand, by the errors of brightness that it leaves."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.checks.light_checks import place_fit
from irpso_addon.core.checks.warnings import EXPLAINED

MOVE = np.array([0.03, -0.02, 0.01])


def places(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slopes on eight facets, whose places are alike, the facet of each, and half of the cells."""
    rng = np.random.default_rng(seed)
    facet = np.sort(rng.integers(0, 8, count))
    slopes = rng.standard_normal((8, 3))[facet] + 0.2 * rng.standard_normal((count, 3))
    return slopes, facet, rng.integers(0, 2, count) == 1


@pytest.mark.parametrize("seed", range(3))
def test_a_light_that_is_off_shows_in_both_halves(seed: int) -> None:
    slopes, _, odd = places(600, seed)
    noise = 0.02 * np.random.default_rng(seed + 9).standard_normal(600)
    move, explained = place_fit(slopes @ MOVE + noise, slopes, odd)
    np.testing.assert_allclose(move, MOVE, atol=0.005)
    assert explained > EXPLAINED


@pytest.mark.parametrize("seed", range(3))
def test_a_few_places_say_nothing(seed: int) -> None:
    """What a few facets have wrong looks like a move of 3 % to their 72 places."""
    slopes, facet, odd = places(72, seed)
    error = 0.05 * np.random.default_rng(seed + 5).standard_normal(8)[facet]
    assert place_fit(error, slopes, odd)[1] < EXPLAINED
