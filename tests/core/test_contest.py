"""Which of two rigs predicts left-out views better, and the roughness that texels have under a rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.calibration import choice
from irpso_addon.core.calibration.contest import GIVEN, Contest
from irpso_addon.core.calibration.rig_fit import fit_rig
from irpso_addon.core.calibration.rig_numbers import Free
from irpso_addon.core.calibration.texel_materials import NODES, lobes_of
from irpso_addon.core.calibration.world_fit import WorldFit
from irpso_addon.core.calibration.world_sample import Around, Changed, WorldSample
from irpso_addon.core.calibration.worlds import CHANGED, WorldContest
from irpso_addon.core.evaluation.folds import split
from irpso_addon.core.evaluation.joint_material import OneMaterial
from irpso_addon.core.job import run_to_end
from irpso_addon.core.shading import environment
from tests.support import tilted_sphere as balls


@pytest.mark.parametrize(("flashing", "shows"), [(6, True), (150, False)])
def test_a_rise_of_the_error_by_a_few_texels_does_not_count(flashing: int, shows: bool) -> None:
    """Most of 600 texels are predicted four times better; those that flash raise the sum of squares by a fifth."""
    sample = balls.sphere(balls.principled(0.4), noise=0.01)[0].rig
    folds = split(sample.texels)
    assert folds is not None
    contest = Contest(sample, run_to_end(fit_rig(sample, Free(True, False), rounds=1), lambda progress: None), folds)
    rng = np.random.default_rng(1)
    off = 0.04 * rng.standard_normal(sample.texels.reflected.shape)
    flash = np.zeros(len(off))
    flash[rng.permutation(len(off))[:flashing]] = np.sqrt((1.2 - 1 / 16) * 0.04**2 * len(off) / flashing)
    for name, error in (("one", off), ("two", off / 4 + flash[:, None, None])):
        contest.add(name, [sample.texels.reflected * (1 + error)] * len(folds.left_out))
    assert 1.02 < contest.judge.error("two").relative_rms / contest.judge.error("one").relative_rms < 1.2
    assert contest.scale("two") < 0.5 * contest.scale("one")
    assert contest.shows("two", "one") == shows


@pytest.mark.parametrize(("flashing", "worth"), [(6, True), (150, False)])
def test_a_turned_world_may_raise_the_error_of_a_few_texels(flashing: int, worth: bool) -> None:
    """It explains most of 600 texels four times better; those that flash, in one view, raise the sum of squares."""
    rig = balls.sphere(balls.principled(0.4))[0].rig
    shape, bright = rig.texels.reflected.shape, (rig.texels.reflected * rig.texels.irradiance).mean(-1)
    rng = np.random.default_rng(1)
    off = 0.02 * rng.standard_normal(shape[:2])[..., None]
    flash = np.zeros(shape)
    some = rng.permutation(len(flash))[:flashing]
    flash[some, bright.argmax(1)[some]] = 0.02 * np.sqrt(40 * len(flash) / flashing)
    nodes = np.zeros((*shape[:2], 2, environment.NODES))
    nodes[:, :, 0] = np.log(environment.LEAST)  # the suns are lobes of their own
    rig = replace(rig, texels=replace(rig.texels, reflected=rig.texels.reflected * (1 + off), nodes=nodes))
    sample = WorldSample(rig, (("sky", 0.0),), np.zeros(shape[1], np.int32), False, Around(np.ones(shape), nodes))
    brighter = (1 + off) / (1 + off / 4) * (1 + flash)
    turned = Changed(replace(rig.texels, reflected=rig.texels.reflected / brighter), brighter * np.ones(shape))
    folds = split(rig.texels)
    assert folds is not None
    contest = WorldContest(sample, folds, WorldFit(sample, lambda turns: iter(())))
    contest.add(GIVEN, [Changed(rig.texels, np.ones(shape))] * 2)
    contest.add(CHANGED, [turned] * 2)
    before, after = (contest.judge.error(name) for name in (GIVEN, CHANGED))
    assert 1.02 < after.relative_rms / before.relative_rms < 1.3
    assert contest.scale(CHANGED) < 0.5 * contest.scale(GIVEN)
    assert contest.is_explained()
    assert contest.is_better() == worth


@pytest.mark.parametrize("factor", [0.75, 1.0, 1.3])
def test_roughness_near_that_of_a_round_before_is_about_that_of_all(factor: float) -> None:
    """Exact where that one was right; else the noise, by the lowest costs that were looked at, differs a little."""
    sample = balls.sphere(balls.principled(0.4), noise=0.02)[0].rig
    material = {0: OneMaterial(0.4)}
    of_all = lobes_of(sample, sample.texels, material).roughness[:, 0]
    near = lobes_of(sample, sample.texels, material, np.clip(of_all * factor, NODES[0], NODES[-1])).roughness[:, 0]
    off = np.log(near / of_all)
    assert np.sqrt(np.mean(off**2)) < (1e-3 if factor == 1 else 0.03)  # 0.0002, 0.023; a node is 0.17
    assert np.abs(off).max() < (5e-3 if factor == 1 else 0.15)


def test_vignetting_must_beat_a_diffuse_that_is_not_lamberts() -> None:
    """Spheres whose diffuse is a rough one, in pictures without vignetting: it must explain more than the diffuse."""
    sample = balls.sphere(balls.rough_diffuse, noise=0.005)[0].rig
    folds, free = split(sample.texels), Free(lamps=False, exposures=False, vignetting=True)
    assert folds is not None
    found = run_to_end(fit_rig(sample, free), lambda progress: None)
    contest = Contest(sample, found, folds)
    contest.add(str(free), contest.of_whole(found))
    taken = run_to_end(choice._is_no_material(contest, free, found, (0.0, 1.0)), lambda progress: None)
    assert not taken and any("diffuse=True" in name for name in contest.left)
