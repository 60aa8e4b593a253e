"""Base colours that are drawn to their material's, where bumps that no mesh has change more than base colour does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import ONE_BASE, JointPrior, Solution
from irpso_addon.core.evaluation import folds
from irpso_addon.core.evaluation.sampled_texels import common_base, predicted, under_strengths
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.maps.drawn_base import draw_bases, drawn_sigmas
from irpso_addon.gpu.solve import drawn_base_trials, prediction_trials
from tests.support import synthetic as syn
from tests.support import tilted_sphere as balls
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
    return run(syn.shoot(truth, rig(1, 8), noise=0.01), model="auto", size=32)


def off(solution: Solution, truth: syn.Truth) -> np.ndarray:
    """Errors of base colour over solved texels."""
    at = (np.arange(len(solution.maps.base_color)) + 0.5) / len(solution.maps.base_color)
    own = solution.maps.coverage & ~solution.maps.filled
    return np.asarray(np.abs(solution.maps.base_color - truth.base(*np.meshgrid(at, at)))[own])


@pytest.mark.one_python
def test_base_colour_is_drawn_where_bumps_are_all_that_differs(monkeypatch) -> None:
    found = solved(CLOTH)
    prediction, prior = found.predictions["Paint"], found.priors["Paint"]
    plain, drawn, _ = prediction.taken.partition(", base color prior ")
    assert drawn and prior.one_value
    named = prediction_trials.drawn_name(plain, prior.base_strength)
    assert prediction.taken.removesuffix(", settled by prediction") == named
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


@pytest.mark.parametrize("strength", [2.0, 8.0, 128.0])
@pytest.mark.parametrize("texture", [0.0, 0.02, 0.1])
def test_standard_errors_know_what_drawing_takes_from_a_texture(strength: float, texture: float) -> None:
    """``texture``: standard deviation of true base colours about the material's.  Own ones are off by 0.04."""
    rng = np.random.default_rng(11)
    count = rng.integers(4, 20, (80, 80)).astype(np.float32)
    truth = 0.5 + texture * rng.standard_normal((80, 80, 3))
    noise = np.float32(0.04)
    own = truth + noise * rng.standard_normal(truth.shape)
    base = np.concatenate([own, np.ones((80, 80, 1))], -1).astype(np.float32)
    slots = np.zeros((80, 80), np.int32)
    prior = {"Cloth": JointPrior(0.3, 1e5, base=(0.5, 0.5, 0.5), base_strength=strength)}
    drawn = draw_bases(base, count, slots, ["Cloth"], prior)[..., :3]
    stated = drawn_sigmas(np.full((80, 80), noise), base, count, slots, ["Cloth"], prior)
    error = np.sqrt(((drawn - truth) ** 2).mean())
    assert np.sqrt((stated**2).mean()) == pytest.approx(error, rel=0.05, abs=5e-4)
    few = count < 8
    assert np.sqrt((stated[few] ** 2).mean()) == pytest.approx(
        np.sqrt(((drawn - truth)[few] ** 2).mean()), rel=0.08, abs=8e-4)


@pytest.mark.parametrize("texture", [0.0, 0.02, 0.1])
def test_one_base_colour_is_that_of_all_texels(texture: float) -> None:
    """It is off by what true ones scatter about it."""
    rng, noise = np.random.default_rng(2), np.float32(0.04)
    own = 0.5 + texture * rng.standard_normal((80, 80, 3)) + noise * rng.standard_normal((80, 80, 3))
    base = np.concatenate([own, np.ones((80, 80, 1))], -1).astype(np.float32)
    slots, many = np.zeros((80, 80), np.int32), np.full((80, 80), 100, np.float32)
    prior = {"Cloth": JointPrior(0.3, 1e5, base=(0.5, 0.5, 0.5), base_strength=ONE_BASE)}
    np.testing.assert_allclose(draw_bases(base, many, slots, ["Cloth"], prior)[..., :3], 0.5, atol=1e-4)
    stated = drawn_sigmas(np.full((80, 80), noise), base, many, slots, ["Cloth"], prior)
    chance = 3 * float(noise) ** 2 * (2 / own.size) ** 0.5  # of a variance that is known from so many numbers
    assert (stated**2).mean() == pytest.approx(texture**2, rel=0.1, abs=chance)


def test_what_no_prior_draws_keeps_its_standard_error() -> None:
    sigma, base = np.full((4, 4), 0.03, np.float32), np.full((4, 4, 4), 0.5, np.float32)
    slots = np.repeat(np.arange(4, dtype=np.int32)[:, None] - 1, 4, 1)
    priors = {"Wood": JointPrior(0.3, 1e5), "Cloth": JointPrior(0.3, 1e5, base=(0.5, 0.5, 0.5), base_strength=8.0)}
    found = drawn_sigmas(sigma, base, np.full((4, 4), 8, np.float32), slots, ["Wood", "Cloth", "Tin"], priors)
    np.testing.assert_array_equal(found[slots != 1], sigma[slots != 1])
    np.testing.assert_allclose(found[slots == 1], 0.015, rtol=1e-6)  # half of it: all have the material's colour


def test_one_colour_for_all_may_be_wrong_by_what_all_may_be_wrong_by_alike() -> None:
    """Colours that scatter less than their standard errors say have an error in common."""
    base = np.full((4, 4, 4), 0.5, np.float32) + 0.01 * np.sign(np.arange(16) % 2 - 0.5).reshape(4, 4, 1)
    priors = {"Cloth": JointPrior(0.3, 1e5, base=(0.5, 0.5, 0.5), base_strength=ONE_BASE)}
    drawing = np.full((4, 4), 8, np.float32), np.zeros((4, 4), np.int32), ["Cloth"], priors
    alike, apart = (drawn_sigmas(np.full((4, 4), own, np.float32), base.astype(np.float32), *drawing)
                    for own in (0.03, 0.006))
    np.testing.assert_allclose(alike, (0.03**2 - 0.01**2) ** 0.5, rtol=1e-4)
    np.testing.assert_allclose(apart, (0.01**2 - 0.006**2) ** 0.5, rtol=1e-4)


@pytest.mark.parametrize(("worse", "taken"), [
    ((1.0, 1.004, 1.008, 1.01, 1.011), ONE_BASE),  # the strongest predicts about as well
    ((1.0, 1.004, 1.008, 1.011, 1.02), 128.0),
    ((1.0, 1.004, 1.008, 1.02, 1.03), 32.0),
    ((1.004, 1.0, 1.02, 1.03, 1.03), 8.0),
    ((1.0, 1.02, 1.04, 1.06, 1.08), 2.0),  # texture is lost
])
def test_the_strongest_prior_that_predicts_about_as_well_is_taken(worse: tuple[float, ...], taken: float) -> None:
    """``worse``: both errors of each strength, relative to the best."""
    sample, _ = balls.sphere(balls.principled(0.4), lamps=12)
    judge = folds.Judge(sample.texels, folds.split(sample.texels), sample.rig.cluster)
    drawn = prediction_trials.with_drawn_base(prediction_trials.UNIFORM[0])
    ratios = {"lambert": 3.0, "one value": 1.1} | {trial.name: of for trial, of in zip(drawn, worse, strict=True)}
    for name, ratio in ratios.items():
        even = np.full(len(sample.texels.cos_v), ratio**2)
        judge.candidates[name] = folds.Candidate(even, even)
    contest = object.__new__(drawn_base_trials.DrawnBaseTrials)
    contest.judge = judge
    contest.trials = {trial.name: trial for trial in (prediction_trials.UNIFORM[0], *drawn)}
    found = contest._drawn_best("one value")
    assert found is not None and found.base_strength == taken


def test_strengths_at_once_are_strengths_one_by_one() -> None:
    sample, _ = balls.sphere(balls.principled(0.4), lamps=6, texels=50)
    known = np.arange(6) % 3 > 0
    together = under_strengths(sample.texels, None, known, (0.0, 2.0, 32.0))
    for strength, values in zip((0.0, 2.0, 32.0), together, strict=True):
        np.testing.assert_array_equal(values, predicted(sample.texels, None, known, drawn=strength))


def test_the_common_base_colour_explains_what_is_bright() -> None:
    """What shines although little light meets it counts little: light below the surface, round a terminator."""
    sample, _ = balls.sphere(balls.principled(1.0), lamps=8, texels=200)
    texels, usable = sample.texels, sample.texels.usable()
    grazing = texels.irradiance.mean(-1) < np.quantile(texels.irradiance.mean(-1)[usable], 0.15)
    glowing = replace(texels, reflected=np.where(grazing[..., None], 2 * texels.reflected, texels.reflected))
    plain = [np.average(of.reflected[of.usable()], axis=0, weights=of.quality[of.usable()]) for of in (texels, glowing)]
    found = [np.array(common_base(of, None)) for of in (texels, glowing)]
    assert (found[1] / found[0] - 1).max() < 0.6 * (plain[1] / plain[0] - 1).min()
