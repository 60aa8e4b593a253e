"""A material's prior: one roughness, or several parts, that its texels are drawn to."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from irpso_addon.core.data import JointPrior
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.solve.solver import Solver
from irpso_addon.gpu.solve.texel_records import SolvedTexels
from tests.support.texels import Texels, as_metal, exact, finish

PARTS = 0.3, 0.7


def drawn(on_gl: Any, texels: Texels, joint: JointPrior | None) -> SolvedTexels:
    def run(device: Device) -> SolvedTexels:
        solver = Solver(device, texels.source(device), SolveSettings(size=max(16, texels.quality.shape[0])))
        solver.joint = joint
        maps = finish(solver.solve())
        found = maps.read(device)
        for thing in (maps, solver, solver.source):
            thing.release()
        return found

    return on_gl(run)


def noisy(roughness: np.ndarray, noise: float) -> Texels:
    problem, _ = exact()
    shape = problem.truth.roughness.shape
    texels = as_metal(replace(problem, truth=replace(problem.truth, roughness=np.broadcast_to(roughness, shape))), 0.0)
    factor = 1 + noise * np.random.default_rng(6).standard_normal(texels.rgb.shape)
    return replace(texels, rgb=(texels.rgb * factor).astype(np.float32))


def test_texels_are_drawn_to_the_part_that_suits_them(on_gl):
    problem, _ = exact()
    width = problem.truth.roughness.shape[1]
    truth = np.where(np.arange(width) < width // 2, *PARTS)[None]
    texels = noisy(truth, 0.05)
    alone, one, parts = (np.abs(drawn(on_gl, texels, prior).roughness - truth).mean() for prior in (
        None, JointPrior(PARTS[0], 200.0), JointPrior(PARTS[0], 200.0, 0.0, PARTS[1:])))
    assert parts < alone / 2
    assert parts < one / 2


def test_one_value_is_given_and_not_searched(on_gl):
    found = drawn(on_gl, noisy(np.float64(0.3), 0.05), JointPrior(0.42, 1e5, 0.013))
    np.testing.assert_allclose(found.roughness[found.solved], 0.42, rtol=1e-5)
    np.testing.assert_allclose(found.sigma[found.solved], 0.013, rtol=1e-5)
    assert found.solved.any() and not found.determined[found.solved].any()


def test_a_prior_may_not_ask_for_what_the_data_rule_out(on_gl):
    """Exact observations of a rough material, and a prior that is sure of a mirror."""
    found = drawn(on_gl, noisy(np.float64(0.6), 0.0), JointPrior(0.05, 2000.0))
    assert np.median(found.roughness[found.solved]) > 0.5
