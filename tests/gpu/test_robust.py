"""The robust loss: solve/robust.glsl against brute force in float64, and what it does for texels with outliers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.solve import neighbours
from irpso_addon.gpu.solve.solver import Solver
from tests.support.texel_problem import Problem, Spec, make
from tests.support.texels import Texels, Twin, evaluate, finish, of_problem

OUTLIER = 0.0025  # as in solve/robust.glsl
NOISE = 0.01 / np.sqrt(3)  # of a mean of three channels


def cost(square: np.ndarray) -> np.ndarray:
    """Minus twice the logarithm of a contaminated normal's density, relative to a perfect fit's."""
    return np.asarray(-2 * np.log((np.exp(-0.5 * square) + OUTLIER) / (1 + OUTLIER)))


def brute_force(twin: Twin, r: np.ndarray, variance: float) -> np.ndarray:
    """(texels,) least cost at roughness r over all means of the diffuse part: every observation's own, refined."""
    _, s = twin.parts(r)
    d, w = twin.f - s, twin.weight / variance
    best = np.full(len(d), np.inf)
    span = 3 / np.sqrt(w.max(-1))
    for start in d.T:
        near = start[:, None] + span[:, None] * np.linspace(-1, 1, 241)
        value = cost(w[:, None] * (d[:, None] - near[..., None]) ** 2).sum(-1)
        best = np.minimum(best, value.min(-1))
    return variance * best


def spoiled(**more: object) -> tuple[Problem, Texels]:
    problem = make(Spec("one-lobe", 10, 24, noise=0.01, **more))  # type: ignore[arg-type]
    return problem, of_problem(problem)


@pytest.mark.one_python
def test_cost_is_the_least_of_brute_force(on_gl):
    """Reweighting under a falling scale finds the best base colour, outliers or not, at true and other roughness."""
    problem, texels = spoiled(outliers=0.15)
    twin, variance = Twin(texels, 0.0), NOISE**2
    for factor in (1.0, 1.25, 0.8):
        r = np.clip(problem.truth.roughness * factor, 0.06, 1).astype(np.float32)
        at = np.stack([r, np.full_like(r, variance)], -1)
        fit, more = on_gl(lambda d, at=at: evaluate(d, texels, "fit_robust.kernel", at, 2, ROBUST="1"))
        expected = brute_force(twin, r.ravel().astype(np.float64), variance)
        got = fit[..., 0].ravel()
        assert (got > expected * 0.995 - 1e-6).all()  # never below what is possible
        if factor != 1.0:  # several base colours compete where nothing fits: seldom is a much worse one taken
            assert (got < expected * 1.2 + 1e-5).mean() > 0.95
        else:
            assert (got < expected * 1.02 + 1e-5).mean() > 0.97
            truth = make(replace(problem.spec, noise=0.0, outliers=0.0)).rgb.mean(-1)
            off = np.abs(problem.rgb.mean(-1) - truth) > 6 * NOISE * truth
            seen = problem.quality > 0
            # A contaminated normal doubts a hundredth of normal noise too.
            expected_count = (off & seen).sum() + 0.011 * (~off & seen).sum()
            assert more[..., 0].sum() == pytest.approx(expected_count, rel=0.1)


def test_slope_is_that_of_the_cost(on_gl):
    """Where trust moves smoothly the reweighted gradient is the slope of the least cost."""
    problem, texels = spoiled(outliers=0.15)
    variance, step = (3 * NOISE) ** 2, 2e-3
    r = problem.truth.roughness.astype(np.float32) * np.float32(1.1)

    def at(shift: float) -> np.ndarray:
        numbers = np.stack([r + np.float32(shift), np.full_like(r, variance)], -1)
        return on_gl(lambda d: evaluate(d, texels, "fit_robust.kernel", numbers, 2, ROBUST="1"))[0]

    slope = (at(step)[..., 0] - at(-step)[..., 0]) / (2 * step)
    off = np.abs(-2 * at(0.0)[..., 1] - slope)
    scale = np.maximum(np.abs(slope), 0.02)
    assert np.median(off / scale) < 0.01
    assert np.quantile(off / scale, 0.9) < 0.1


@pytest.mark.parametrize(("metallic", "wide"), [(0.0, 5), (0.4, 100)])  # the second's errors are the model's
def test_without_outliers_it_is_the_squares(on_gl, metallic, wide):
    """All trust is near 1 where nothing is off: cost, slope and curvature are those of least squares."""
    problem, texels = spoiled()
    r = problem.truth.roughness.astype(np.float32)
    at = np.stack([r, np.full_like(r, (wide * NOISE) ** 2)], -1)  # noise far below what is expected
    robust = on_gl(lambda d: evaluate(d, texels, "fit_robust.kernel", at, 2, metallic=metallic, ROBUST="1"))[0]
    plain = on_gl(lambda d: evaluate(d, texels, "fit_one.kernel", at, 2, metallic=metallic))[0]
    assert np.allclose(robust[..., :3], plain[..., :3], rtol=0.03 if metallic else 0.01, atol=1e-5)


@pytest.mark.one_python
@pytest.mark.parametrize(("noise", "share_of", "found"), [
    (0.0, 0.0, False), (0.002, 0.0, False), (0.01, 0.0, False), (0.05, 0.0, False),
    (0.002, 0.05, True), (0.01, 0.1, True), (0.05, 0.1, True), (0.01, 0.3, True)])
def test_outliers_are_noticed_and_noise_is_not(on_gl, noise, share_of, found):
    """By the tails of what fits leave; the noise without outliers is told within a quarter."""
    problem = make(Spec("one-lobe", 12, 32, noise=noise, outliers=share_of))

    def run(device):
        solver = Solver(device, of_problem(problem).source(device), SolveSettings(size=32, loss="auto"))
        maps = finish(solver.solve())
        for thing in (maps.roughness, maps.detail, solver, solver.source):
            thing.release()
        return solver.robust, solver.noise

    robust, told = on_gl(run)
    assert robust == found
    if noise >= 0.002:
        assert told == pytest.approx(noise / np.sqrt(3), rel=0.3)


def test_outliers_are_those_of_the_noise_itself(on_gl):
    """However much more it counts: a third of the observations are outliers, which more noise would hide."""
    problem = make(Spec("one-lobe", 12, 32, noise=0.002, outliers=0.3))

    def told(device, misfit):
        source = of_problem(problem).source(device)
        source.misfit = misfit
        solver = Solver(device, source, SolveSettings(size=32, loss="auto"))
        maps = finish(solver.solve())
        for thing in (maps.roughness, maps.detail, solver, source):
            thing.release()
        assert solver.robust
        return solver.noise

    plain, wary = (on_gl(lambda device, m=misfit: told(device, m)) for misfit in (0.0, 0.002))
    assert wary == pytest.approx(np.hypot(plain, 0.002), rel=1e-3)


def solved(device, problem: Problem, loss: str):
    solver = Solver(device, of_problem(problem).source(device), SolveSettings(size=problem.spec.size, loss=loss))
    maps = finish(solver.solve())
    base = finish(solver.albedo(maps.roughness))
    found = device.read(maps.roughness).copy(), device.read(base)[..., :3].copy()
    for thing in (maps.roughness, maps.detail, base, solver, solver.source):
        thing.release()
    return found


def test_a_tenth_of_outliers_costs_little(on_gl):
    """Failures at most twice those without, base colour nearly as good; squares lose fivefold."""
    failures, albedo = {}, {}
    for outliers, loss in ((0.0, "auto"), (0.1, "squares"), (0.1, "auto")):
        problem = make(Spec("one-lobe", 12, 64, noise=0.01, outliers=outliers))
        rough, base = on_gl(lambda d, p=problem, how=loss: solved(d, p, how))
        failures[outliers, loss] = (np.abs(rough[..., 0] - problem.truth.roughness) > 0.1).mean()
        albedo[outliers, loss] = np.quantile(np.abs(base - problem.truth.base).max(-1), 0.9)
    assert failures[0.1, "auto"] <= 2 * failures[0.0, "auto"]
    assert albedo[0.1, "auto"] < 1.5 * albedo[0.0, "auto"]
    assert albedo[0.1, "squares"] > 5 * albedo[0.0, "auto"]


def test_clean_data_are_left_alone_bit_for_bit(on_gl):
    problem = make(Spec("one-lobe", 8, 32, noise=0.01))
    rough, base = on_gl(lambda d: solved(d, problem, "auto"))
    rough2, base2 = on_gl(lambda d: solved(d, problem, "squares"))
    assert (rough == rough2).all() and (base == base2).all()


@pytest.mark.one_python
@pytest.mark.parametrize(("spec", "robust"), [
    (Spec("one-lobe", 12, 160, noise=0.01, outliers=0.1), True), (Spec("two-lobe", 24, 160, noise=0.002), False)])
def test_some_squares_of_a_large_map_decide_as_the_whole(on_gl, monkeypatch, spec, robust):
    """The same maps bit for bit; where errors are the model's, no other texels are searched again."""
    problem = make(spec)
    searched, wary = [], Solver._wary

    def counted(self, chosen, plain, outputs, share, texels):
        searched.append(int(texels.sum()))
        return wary(self, chosen, plain, outputs, share, texels)

    monkeypatch.setattr(Solver, "_wary", counted)
    by_squares = on_gl(lambda d: solved(d, problem, "auto"))
    few, *whole = searched
    assert few < 0.4 * 160**2
    assert len(whole) == robust
    monkeypatch.setattr("irpso_addon.gpu.solve.solver.SAMPLED", 160**2)
    searched.clear()
    at_once = on_gl(lambda d: solved(d, problem, "auto"))
    assert len(searched) == 1
    assert searched[0] > few
    assert all((one == other).all() for one, other in zip(by_squares, at_once, strict=True))


@pytest.mark.parametrize(("degrees", "tilts"), [((1.0, 2.0), False), ((0.5, 0.9), True)])
def test_noise_of_too_few_degrees_of_freedom_is_not_judged(degrees, tilts):
    """Infinite: then nothing is an outlier."""
    variance, outliers = neighbours.clean_noise(np.array([1.0, 2.0], np.float32), np.array(degrees, np.float32), tilts)
    assert variance == np.inf and not outliers


@pytest.mark.parametrize("degrees", [1.5, 2.5])
def test_outliers_show_among_texels_of_few_degrees_of_freedom(degrees):
    """Two lamps a camera: tilts of the normal explain most of what their observations differ by."""
    rng = np.random.default_rng(3)
    clean = 1e-4 * rng.chisquare(degrees, 5000)
    gross = np.where(rng.uniform(size=5000) < 0.15, 0.1, clean)
    for residual, expected in ((clean, False), (gross, True)):
        variance, outliers = neighbours.clean_noise(
            residual.astype(np.float32), np.full(5000, degrees, np.float32), tilts=True)
        assert outliers is expected
        assert 0.5e-4 < variance < 4e-4
