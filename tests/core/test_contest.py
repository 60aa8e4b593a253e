"""Which of two rigs predicts left-out views better, and the roughness that texels have under a rig."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.calibration import choice
from irpso_addon.core.calibration.contest import Contest
from irpso_addon.core.calibration.rig_fit import fit_rig
from irpso_addon.core.calibration.rig_numbers import Free
from irpso_addon.core.calibration.texel_materials import NODES, lobes_of
from irpso_addon.core.evaluation.folds import split
from irpso_addon.core.evaluation.joint_material import OneMaterial
from irpso_addon.core.job import run_to_end
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
