"""Base colours that are drawn to their material's, where bumps that no mesh has change more than base colour does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import JointPrior, Solution
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.maps.drawn_base import draw_bases
from irpso_addon.gpu.solve import prediction_trials
from tests.support import synthetic as syn
from tests.support.shoots import rig, run

RED = np.array([0.45, 0.08, 0.15])
WAVES = np.random.default_rng(3).uniform(20, 60, (24, 2)) * np.random.default_rng(4).choice([-1, 1], (24, 2))
PHASES = np.random.default_rng(5).uniform(0, 2 * np.pi, (24, 2))
SLOPE = 0.35  # root mean square


def rough_and_tilts(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(..., 3) roughness, and how far bumps tilt the normal."""
    u, v = (np.asarray(x, np.float64)[..., None] for x in (u, v))
    along = u * WAVES[:, 0] + v * WAVES[:, 1]
    tilts = [SLOPE * np.sqrt(2 / len(WAVES)) * np.sin(along + PHASES[:, k]).sum(-1) for k in (0, 1)]
    return np.stack([np.full(tilts[0].shape, 0.4), *tilts], -1)


def bumpy(base: np.ndarray, rough: np.ndarray, L: np.ndarray, V: np.ndarray, N: np.ndarray) -> np.ndarray:
    """As the renderer lights it by the mesh's normals, of which the bumps know nothing."""
    n = N + np.stack([rough[..., 1], rough[..., 2], 0 * rough[..., 0]], -1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    lit, given = (np.maximum((L * x).sum(-1), 0) for x in (n, N))
    shown = brdf.principled(base, rough[..., 0], L, V, n)
    return np.asarray(shown * (lit / np.maximum(given, 1e-6))[..., None])


CLOTH = syn.Truth(lambda u, v: np.broadcast_to(RED, (*np.shape(u), 3)), rough_and_tilts, reflect=bumpy)
PRINT = replace(CLOTH, base=syn.PATCHES.base)


def solved(truth: syn.Truth) -> Solution:
    return run(syn.shoot(truth, rig(1, 8), noise=0.01), model="auto")


def off(solution: Solution, truth: syn.Truth) -> np.ndarray:
    """Errors of base colour over solved texels."""
    at = (np.arange(len(solution.maps.base_color)) + 0.5) / len(solution.maps.base_color)
    own = solution.maps.coverage & ~solution.maps.filled
    return np.asarray(np.abs(solution.maps.base_color - truth.base(*np.meshgrid(at, at)))[own])


@pytest.mark.one_python
def test_base_colour_is_drawn_where_bumps_are_all_that_differs(monkeypatch) -> None:
    found = solved(CLOTH)
    prediction, prior = found.predictions["Paint"], found.priors["Paint"]
    plain, _, strength = prediction.taken.partition(", base color prior ")
    assert prior.base_strength == float(strength) and prior.one_value
    assert prediction.error.relative_rms < 0.95 * prediction.tried[plain].relative_rms
    monkeypatch.setattr(prediction_trials, "BASE_STRENGTHS", ())
    before = solved(CLOTH)
    assert "base color" not in before.predictions["Paint"].taken
    assert off(found, CLOTH).mean() < 0.7 * off(before, CLOTH).mean()


@pytest.mark.one_python
def test_base_colours_that_differ_stay_apart() -> None:
    found = solved(PRINT)
    assert "base color" not in found.predictions["Paint"].taken
    assert found.priors.get("Paint", JointPrior(0.5, 1.0)).base == ()


def test_a_texel_counts_by_its_observations() -> None:
    base = np.full((2, 3, 4), 0.2, np.float32)
    slots, count = np.array([[0, 0, 1], [0, -1, 1]], np.int32), np.array([[0, 8, 8], [2, 8, 8]], np.float32)
    prior = JointPrior(0.3, 1e5, base=(0.6, 0.4, 0.2), base_strength=8.0)
    drawn = draw_bases(base, count, slots, ["Cloth", "Steel"], {"Cloth": prior, "Steel": JointPrior(0.3, 1e5)})
    np.testing.assert_allclose(drawn[0, 0], (0.6, 0.4, 0.2, 0.2), atol=1e-6)
    np.testing.assert_allclose(drawn[0, 1], (0.4, 0.3, 0.2, 0.2), atol=1e-6)
    np.testing.assert_allclose(drawn[1, 0], (0.52, 0.36, 0.2, 0.2), atol=1e-6)
    assert (drawn[slots != 0] == base[slots != 0]).all()
