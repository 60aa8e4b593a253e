"""What the texels that know their roughness say of all, and of those of their colour."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.tiled.tiled_plan import Typical
from irpso_addon.gpu.solve.texel_records import WELL_KNOWN
from irpso_addon.gpu.solve.typical import UNKNOWN, WIDER, typical

DARK, LIGHT = np.array([0.1, 0.16, 0.3]), np.array([0.6, 0.5, 0.4])


def of_colour(found: tuple[Typical, ...], base: np.ndarray) -> Typical:
    """What counts for this base colour."""
    return min(found, key=lambda kind: float(np.square(np.sqrt(base) - kind.colour).sum()))


def test_one_for_all_where_colour_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    known = 0.4 + 0.05 * rng.standard_normal(20000)
    roughness = np.concatenate([known, rng.uniform(0.05, 1, 40000)]).astype(np.float32)
    sigma = np.concatenate([np.full(20000, 0.005), np.full(40000, 0.05)]).astype(np.float32)
    base = np.asarray(DARK + (LIGHT - DARK) * rng.uniform(size=(60000, 1)), np.float32)
    found, = typical(roughness, sigma, base)
    assert found.roughness == pytest.approx(0.4, abs=0.002)
    assert np.sqrt(found.variance) == pytest.approx(WIDER * 0.05, rel=0.05)
    patch = np.where(np.arange(60000) % 20 == 0, np.float32(0.9), roughness)  # of another roughness: 5 %
    found, = typical(patch, sigma, base)
    assert np.sqrt(found.variance) > 0.9 * WIDER * 0.5 / 4.1
    assert typical(roughness[:40], sigma[:40], base[:40]) == (UNKNOWN,)
    assert typical(roughness, sigma + 1, base) == (UNKNOWN,)
    even, = typical(np.full(100, 0.3, np.float32), np.zeros(100, np.float32), base[:100])
    assert even.roughness == pytest.approx(0.3)
    assert np.sqrt(even.variance) == pytest.approx(WELL_KNOWN, rel=0.02)


def paints(noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Dark paint of roughness 0.2 with a tenth of light paint of 0.8: (light, roughness, base colour)."""
    rng = np.random.default_rng(2)
    light = np.arange(20000) % 10 == 0
    roughness = np.where(light, 0.8, 0.2) + noise * rng.standard_normal(20000)
    base = np.where(light[:, None], LIGHT, DARK) * rng.uniform(0.8, 1.2, (20000, 1))
    return light, roughness.astype(np.float32), base.astype(np.float32)


def test_one_for_each_colour_where_colours_differ_in_roughness() -> None:
    _, roughness, base = paints(0.02)
    found = typical(roughness, np.full(20000, 0.005, np.float32), base)
    for shade in (0.85, 1.0, 1.15):
        for paint, wanted in ((DARK, 0.2), (LIGHT, 0.8)):
            here = of_colour(found, shade * paint)
            assert here.roughness == pytest.approx(wanted, abs=0.005)
            assert np.sqrt(here.variance) == pytest.approx(WIDER * 0.02, rel=0.1)


def test_a_colour_that_knows_little_may_be_of_another_roughness() -> None:
    """Glossy dark paint under highlights, and matt light paint, of which no texel knows its roughness well."""
    light, roughness, base = paints(0.02)
    found = typical(roughness, np.where(light, np.float32(0.03), np.float32(0.005)), base)
    for shade in (0.85, 1.0, 1.15):
        glossy, matt = of_colour(found, shade * DARK), of_colour(found, shade * LIGHT)
        assert glossy.roughness == pytest.approx(0.2, abs=0.005)
        assert np.sqrt(glossy.variance) == pytest.approx(WIDER * 0.02, rel=0.1)
        assert matt.variance == UNKNOWN.variance


def test_colours_of_one_roughness_that_varies_say_the_same() -> None:
    _, _, base = paints(0.0)
    rng = np.random.default_rng(3)
    roughness = (0.45 + 0.1 * rng.standard_normal(20000)).astype(np.float32)
    found, = typical(roughness, np.full(20000, 0.005, np.float32), base)
    assert found.roughness == pytest.approx(0.45, abs=0.01)
    assert np.sqrt(found.variance) == pytest.approx(WIDER * 0.1, rel=0.1)
