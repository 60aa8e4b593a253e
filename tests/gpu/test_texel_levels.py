"""Specular IOR Levels that differ from texel to texel, about their material's."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import JointPrior
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.solve.solver import Solver
from tests.support import synthetic as syn
from tests.support.shoots import rig, run
from tests.support.texels import Texels, as_metal, exact, finish

ROUGH = 0.4
PRIOR = JointPrior(ROUGH, 200.0, level=0.35, level_strength=0.2)


def levels_of(on_gl: Any, texels: Texels, priors: list[JointPrior]) -> list[np.ndarray]:
    def find(device: Device) -> list[np.ndarray]:
        solver = Solver(device, texels.source(device), SolveSettings(size=max(16, texels.quality.shape[0])))
        solver.shown = False
        found = [levels for levels, _ in finish(solver.levels_under(priors))]
        solver.use_level(None)
        for thing in (solver, solver.source):
            thing.release()
        return found

    return on_gl(find)


@pytest.fixture(scope="module")
def halves() -> tuple[Texels, np.ndarray]:
    """Texels of one roughness and two levels with 1 % noise, and the levels."""
    problem, _ = exact()
    shape = problem.truth.roughness.shape
    one = replace(problem, truth=replace(problem.truth, roughness=np.full(shape, ROUGH)))
    left = np.arange(shape[1]) < shape[1] // 2
    low, high = (as_metal(one, 0.0, level) for level in syn.LEVELS)
    noise = 1 + 0.01 * np.random.default_rng(5).standard_normal(low.rgb.shape)
    rgb = np.where(left[:, None, None], low.rgb, high.rgb) * noise
    return replace(low, rgb=rgb.astype(np.float32)), np.broadcast_to(np.where(left, *syn.LEVELS), shape)


def test_each_texel_finds_its_own(on_gl, halves):
    texels, truth = halves
    (found,) = levels_of(on_gl, texels, [PRIOR])
    off = np.abs(np.log(found / truth))
    assert np.median(off) < 0.1
    assert np.quantile(off, 0.9) < 0.4


def test_hundreds_of_views_that_show_nothing_change_nothing(on_gl, halves):
    """llvmpipe ends a shader's loops after 65535 rounds in all."""
    texels, _ = halves
    more = 500 - texels.quality.shape[2]

    def padded(values: np.ndarray, by: float = 0.0) -> np.ndarray:
        return np.concatenate([values, np.full((*values.shape[:2], more, *values.shape[3:]), by, values.dtype)], 2)

    many = Texels(padded(texels.rgb), padded(texels.quality), padded(texels.cos_v, 0.5), padded(texels.lobes),
                  texels.groups + (texels.groups[-1],) * more)
    (few,), (found,) = (levels_of(on_gl, each, [PRIOR]) for each in (texels, many))
    np.testing.assert_allclose(found, few, rtol=1e-3)


def test_a_strong_prior_holds_them(on_gl, halves):
    texels, _ = halves
    weak, strong = levels_of(on_gl, texels, [PRIOR, replace(PRIOR, level_strength=1e4)])
    assert np.abs(np.log(strong / PRIOR.level)).max() < 0.05
    assert np.abs(np.log(weak / PRIOR.level)).mean() > 0.5


def test_a_texel_that_nothing_tells_takes_its_material_s(on_gl, halves):
    texels, _ = halves
    quality = texels.quality.copy()
    quality[:8, :, 1:] = 0.0  # one observation
    (found,) = levels_of(on_gl, replace(texels, quality=quality), [PRIOR])
    assert np.abs(np.log(found[:8] / PRIOR.level)).max() < 0.01


@pytest.mark.one_python
def test_auto_takes_them_where_they_predict_better():
    views = rig(1, 16)
    found = run(syn.shoot(syn.VARIED, views, noise=0.01), model="auto")
    prediction = found.predictions["Paint"]
    assert prediction.taken.startswith("a value and level a texel")
    assert prediction.error.lightness < 0.8 * prediction.tried["one value and level"].lightness
    maps = found.maps
    solved = maps.coverage & ~maps.filled
    assert maps.specular is not None and found.levels == {}  # a map, no number
    assert np.median(np.abs(np.log(maps.specular / syn.levels_of_varied(len(maps.specular))))[solved]) < 0.15
    rough = np.abs(maps.roughness - ROUGH)[solved]
    assert np.median(rough) < 0.03
    assert np.mean(rough < 1.645 * maps.roughness_sigma[solved]) > 0.73  # 0.68 if the level counted as known
    one = replace(syn.VARIED, reflect=partial(brdf.principled, level=0.35))
    again = run(syn.shoot(one, views, noise=0.01), model="auto")
    assert not again.predictions["Paint"].taken.startswith("a value and level a texel")
