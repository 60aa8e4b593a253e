"""Standard errors against true errors, and when neighbours are asked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.solve.solver import Solver
from tests.support import shoots
from tests.support.texels import Texels, exact, finish

NINETY = 1.6449  # standard deviations that hold 90 % of a normal distribution


def solve(
    on_gl: Any, texels: Texels, lobes: int = 1, misfit: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Solver]:
    """(roughness map, detail map, base colour, the solver)."""

    def job(device: Device) -> tuple[np.ndarray, np.ndarray, np.ndarray, Solver]:
        source = texels.source(device)
        source.misfit = misfit
        solver = Solver(device, source, SolveSettings(size=texels.quality.shape[0]))
        maps = finish(solver.solve_two() if lobes == 2 else solver.solve())
        found = maps.roughness if maps.pairs is None else maps.pairs
        albedo = finish(solver.albedo(found, lobes))
        result = tuple(device.read(t).astype(np.float64) for t in (maps.roughness, maps.detail, albedo))
        for thing in {found, maps.roughness, maps.detail, albedo, solver, source}:
            thing.release()
        return *result, solver

    return on_gl(job)


@pytest.mark.parametrize("seed", range(2))
def test_intervals_hold_as_often_as_they_say(on_gl, seed):
    """90 % of them should; 82 to 97 % may.  Base colour: of the mean of its channels, as its standard error."""
    problem, texels = exact(size=64, noise=0.01, seed=seed)
    roughness, detail, base, _ = solve(on_gl, texels)
    off = np.abs(roughness[..., 0] - problem.truth.roughness)
    assert 0.82 < (off <= NINETY * roughness[..., 1]).mean() < 0.97
    off_base = np.abs((base[..., :3] - problem.truth.base).mean(-1))
    assert 0.82 < (off_base <= NINETY * detail[..., 3]).mean() < 0.97
    # And not by being the same everywhere: errors are far smaller in the surer half.
    for sigma, error in ((roughness[..., 1], off), (detail[..., 3], off_base)):
        sure = sigma < np.median(sigma)
        assert error[sure].mean() < 0.6 * error[~sure].mean()


@pytest.mark.parametrize("seed", range(2))
def test_intervals_of_two_lobes_hold(on_gl, seed):
    """24 observations with 0.2 % noise.  Roughness, of the sharper lobe, is said with too much caution: 98 %."""
    problem, texels = exact(size=48, model="two-lobe", views=24, noise=0.002, seed=seed)
    roughness, detail, base, _ = solve(on_gl, texels, 2)
    off = np.abs(roughness[..., 0] - problem.truth.roughness)
    assert (off <= NINETY * roughness[..., 1]).mean() > 0.82
    off_base = np.abs((base[..., :3] - problem.truth.base).mean(-1))
    assert 0.82 < (off_base <= NINETY * detail[..., 3]).mean() < 0.97
    sure = roughness[..., 1] < np.median(roughness[..., 1])
    assert off[sure].mean() < 0.6 * off[~sure].mean()
    assert np.median(roughness[..., 1]) < 0.1


def test_neighbours_are_asked_where_there_is_noise(on_gl):
    """Clean observations need none."""
    specs = [({}, False), ({"views": 6, "size": 96}, False), ({"noise": 0.01}, True), ({"noise": 0.003}, True)]
    for spec, asked in specs:
        solver = solve(on_gl, exact(**spec)[1])[3]
        assert solver.noise_of[1].neighbours is asked, spec
        noise = spec.get("noise", 0.0) / np.sqrt(3)  # the mean of three channels
        assert solver.noise == pytest.approx(noise, rel=0.3, abs=2e-4), spec


def test_noise_counts_more_where_all_observations_of_a_texel_may_be_off(on_gl):
    """What residuals do not show adds to the noise, and standard errors grow with it."""
    _, texels = exact(size=64, noise=0.01)
    (plain, _, _, first), (wary, _, _, second) = (solve(on_gl, texels, misfit=misfit) for misfit in (0.0, 0.01))
    assert second.noise == pytest.approx(np.hypot(first.noise, 0.01), rel=1e-3)
    assert 1.2 < np.median(wary[..., 1] / plain[..., 1]) < 2.0


def test_neighbours_help(on_gl):
    """At 1 % noise they more than halve the failures of texels alone, and the mean error with them."""
    problem, texels = exact(size=64, noise=0.01)

    def alone(device: Device) -> np.ndarray:
        source = texels.source(device)
        solver = Solver(device, source, SolveSettings(size=64))
        valleys, support = finish(solver.search([(0, 0)]))
        found = device.read(valleys)[..., 0].astype(np.float64)
        for thing in (valleys, support, solver, source):
            thing.release()
        return found

    off = [np.abs(found - problem.truth.roughness) for found in (on_gl(alone), solve(on_gl, texels)[0][..., 0])]
    assert (off[1] > 0.1).mean() < 0.5 * (off[0] > 0.1).mean() < 0.2
    assert off[1].mean() < 0.5 * off[0].mean()


@pytest.mark.one_python
@pytest.mark.parametrize("count", [16, 20])
def test_a_carried_flash_leaves_texels_that_know_their_roughness(count):
    """Each camera has one view: the noise shows in how cameras differ, and is 1 % here, not the 5 % that they may."""
    shoot = shoots.carried_flash(count)
    solution = shoots.run(shoot, model="one-lobe", registration="given", indirect="off")
    maps, errors = solution.maps, shoots.errors(solution, shoot.truth, border=0.0)
    solved = maps.coverage & ~maps.filled
    sure = maps.confidence[solved] > 0.5
    assert (errors.rough <= NINETY * maps.roughness_sigma[solved]).mean() > 0.85
    assert sure.mean() > 0.5 and errors.rough[sure].max() < 0.1
