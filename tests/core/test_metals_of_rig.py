"""Rigs that light metal: what of them is off is found, and nothing is where nothing is off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.calibration.calibrate import calibrate
from irpso_addon.core.calibration.finish import Judged
from irpso_addon.core.calibration.metals import metals_of
from irpso_addon.core.calibration.rig_fit import fit_rig
from irpso_addon.core.calibration.rig_numbers import Free
from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.evaluation.folds import split
from irpso_addon.core.job import run_to_end
from tests.support import flash_ball as balls

VIEWS = 36

pytestmark = pytest.mark.one_python


def judged(sample: RigSample) -> Judged | None:
    return run_to_end(calibrate(sample, lamps=True, exposures=True), lambda progress: None)


def exposures() -> np.ndarray:
    gain = 0.1 * np.random.default_rng(5).standard_normal(VIEWS)
    return np.asarray(gain - np.median(gain))


def test_bronze_under_a_rig_that_is_right_changes_nothing() -> None:
    assert judged(balls.flash_ball(balls.bronze, views=VIEWS)) is None


def test_under_a_curve_that_is_not_known_exposures_of_bronze_stay() -> None:
    """Of JPEG files."""
    assert judged(balls.as_jpeg(balls.flash_ball(balls.bronze, views=VIEWS, log_gain=exposures()))) is None


def test_a_flash_that_is_off_is_found_by_a_bronze() -> None:
    """By 5 cm; its distance apart, which falloff alone shows.  A curve predicts better than what is given, too."""
    ball = balls.flash_ball(balls.bronze, views=VIEWS, off=(0.05, -0.02, 0.0))
    change = judged(ball)
    assert change is not None and change.free.lamps and not change.free.exposures
    assert change.found.change.log_response == change.found.change.log_shoulder == 0
    found = change.found.change.offset[0] * ball.rig.groups[0].reach
    assert np.abs(found[:2] - [-0.05, 0.02]).max() < 0.01


def test_all_that_is_off_is_found_by_a_bronze() -> None:
    """The flash by 5 cm, exposures by 8 %, and files hold radiance to the power 0.9."""
    gain = exposures()
    ball = balls.flash_ball(balls.bronze, views=VIEWS, off=(0.05, -0.02, 0.0), log_gain=gain, power=0.9)
    change = judged(ball)
    assert change is not None and change.free.lamps and change.free.exposures
    found = change.found.change
    assert np.abs(found.offset[0, :2] * ball.rig.groups[0].reach - [-0.05, 0.02]).max() < 0.01
    assert np.std(gain - found.log_gain) < 0.3 * np.std(gain)
    assert np.exp(found.log_response) == pytest.approx(0.9, abs=0.04) and not found.log_shoulder
    assert change.changed.lightness < 0.6 * change.given.lightness


def test_a_flash_may_be_a_tenth_of_its_distance_off() -> None:
    """As one on a bracket is in a close-up."""
    ball = balls.flash_ball(balls.bronze, views=VIEWS, off=(0.2, -0.05, 0.0))
    change = judged(ball)
    assert change is not None and change.free.lamps
    found = change.found.change.offset[0] * ball.rig.groups[0].reach
    assert np.abs(found[:2] - [-0.2, 0.05]).max() < 0.01


def test_a_flash_is_found_beside_bumps_that_the_mesh_lacks() -> None:
    """They hide highlights from predictions, but halves of the texels agree on the place, to its standard error.

    Of a flash that is right no place is found.
    """
    bronze, gain = balls.bumpy(balls.bronze, 4.0), exposures()
    ball = balls.flash_ball(bronze, views=VIEWS, off=(0.0, 0.06, 0.0), log_gain=gain)
    change = judged(ball)
    assert change is not None and change.free.lamps and change.free.exposures
    reach = ball.rig.groups[0].reach
    off = change.found.change.offset[0] * reach - [0.0, -0.06, 0.0]
    assert np.abs(off).max() < 0.015 and (np.abs(off[:2]) < 3 * change.error.offset[0, :2] * reach).all()
    right = judged(balls.flash_ball(bronze, views=VIEWS, log_gain=gain))
    assert right is None or not right.free.lamps


def test_metals_are_looked_for_where_dielectrics_explain_little() -> None:
    for reflect, asked in ((balls.bronze, True), (balls.paint, False)):
        ball = balls.flash_ball(reflect, views=VIEWS)
        folds = split(ball.texels)
        assert folds is not None
        first = run_to_end(fit_rig(ball, Free(False, False), rounds=1), lambda progress: None)
        found = run_to_end(metals_of(ball, folds, first), lambda progress: None)
        assert (found is not None) == asked
        if found is not None:
            assert found.materials[0].metallic > 0.9 and found.scatter < 0.5 * first.scatter


def test_two_lamps_in_a_view_are_no_matter_of_metals() -> None:
    """A highlight may be either's."""
    ball = balls.flash_ball(balls.bronze, views=VIEWS)
    views = tuple(replace(view, lights=view.lights * 2) for view in ball.rig.views)
    folds = split(ball.texels)
    assert folds is not None
    first = run_to_end(fit_rig(ball, Free(False, False), rounds=1), lambda progress: None)
    two = replace(ball, rig=replace(ball.rig, views=views))
    assert run_to_end(metals_of(two, folds, first), lambda progress: None) is None
