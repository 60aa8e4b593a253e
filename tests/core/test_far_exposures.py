"""Exposures that are far off, where no model explains the pictures, and where views show angles of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.calibration.angles import angles_overlap
from irpso_addon.core.calibration.calibrate import calibrate
from irpso_addon.core.calibration.far_exposures import median_gains
from irpso_addon.core.calibration.finish import Judged
from irpso_addon.core.calibration.put_right import told
from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.checks.calibration_lines import calibrated
from irpso_addon.core.job import run_to_end
from irpso_addon.core.shading import brdf
from tests.support import tilted_sphere as balls

SUNS = 16

pytestmark = pytest.mark.one_python


def judged(sample: RigSample) -> Judged | None:
    return run_to_end(calibrate(sample, lamps=True, exposures=True), lambda progress: None)


def rough_scan(slope: float, gain: np.ndarray) -> RigSample:
    """Something dark and glossy, seen by two cameras, whose bumps (radians: their slope) the mesh lacks."""
    one, _ = balls.sphere(balls.principled(0.3, 0.1 * balls.BASE), lamps=SUNS, texels=500, slope=slope, noise=0.02)
    return balls.seen_twice(one.rig, np.zeros(SUNS), gain)


def stops_apart(seed: int) -> np.ndarray:
    return 0.7 * np.log(2) * np.random.default_rng(seed).standard_normal(2 * SUNS)


@pytest.mark.parametrize("seed", [2, 3])
def test_exposures_come_back_where_no_model_explains_the_pictures(seed: int) -> None:
    """0.7 stops, standard deviation.  85 % of the radiance of left-out views stays unexplained."""
    gain = stops_apart(seed)
    change = judged(rough_scan(0.3, gain))
    assert change is not None and not change.changed.fits
    assert change.changed.lightness < 0.9 * change.given.lightness
    left = gain - change.found.change.log_gain
    assert np.std(left) < 0.25 * np.std(gain)
    assert not change.found.change.offset.any() and not change.found.change.log_power.any()


@pytest.mark.parametrize("slope", [0.3, 0.6])
def test_right_exposures_stay_where_no_model_explains_the_pictures(slope: float) -> None:
    assert judged(rough_scan(slope, np.zeros(2 * SUNS))) is None


def test_where_nearly_nothing_is_explained_exposures_stay() -> None:
    """Bumps of 50 degrees, as of crumpled foil: what views show of their texels says nothing of their exposure."""
    assert judged(rough_scan(1.2, stops_apart(2))) is None


@pytest.mark.parametrize("apart", [False, True])
def test_gains_are_medians_of_what_is_known(apart: bool) -> None:
    """``apart``: a view has a layer for each channel.  A view that shows few texels has none."""
    rng = np.random.default_rng(4)
    rig = rough_scan(0.3, np.zeros(2 * SUNS))
    layers = len(rig.view)
    if apart:
        rig = replace(rig, view=np.arange(layers, dtype=np.int32) // 3, texels=replace(
            rig.texels, channel=np.arange(layers, dtype=np.int32) % 3))
    views = rig.view.max() + 1
    gain = rng.standard_normal(views)
    noise = 0.05 * rng.standard_normal((len(rig.slot), layers))
    left = rng.standard_normal((len(rig.slot), 1)) + gain[rig.view] + noise
    left[rng.uniform(size=left.shape) < 0.4] = np.nan
    left[:50] = np.nan
    left[70:, rig.view == 1] = np.nan
    found = median_gains(rig, left)[:views]
    assert found[1] == 0
    seen = np.arange(views) != 1
    np.testing.assert_allclose(found[seen] - np.median(found[seen]), gain[seen] - np.median(gain[seen]), atol=0.03)


def test_under_a_curve_that_is_not_known_exposures_stay() -> None:
    """Of JPEG files; not where a curve is entered."""
    off = rough_scan(0.3, stops_apart(2))
    for curve, changes in ((1.0, False), (1.001, True)):
        views = tuple(replace(view, image=view.image.with_suffix(".jpg"), response=curve) for view in off.rig.views)
        assert (judged(replace(off, rig=replace(off.rig, views=views))) is not None) == changes


def coated(toward_light: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """A second lobe beside the paint's, as a thick coat has it."""
    black = balls.principled(0.3, 0 * balls.BASE)
    return balls.principled(0.5)(toward_light, normal) + 2 * black(toward_light, normal)


def board(reflect: balls.Reflect, lamps: int = 24, paint: float = 0.5, gain: np.ndarray | None = None) -> RigSample:
    """Flat, under suns: each shows all of its texels the same angle.  1 % noise.  ``paint``: how far texels differ."""
    ball = balls.sphere(reflect, lamps=lamps, texels=600)[0].rig
    one = ball.part(np.full(600, int(np.argmax(ball.normal @ balls.TOWARD))))
    rng = np.random.default_rng(4)
    painted = balls.BASE / np.pi * rng.uniform(-paint, paint, (600, 1, 3))
    noise = 1 + 0.01 * rng.standard_normal(one.texels.reflected.shape)
    shown = np.maximum(one.texels.reflected + painted, 1e-4) * noise
    if gain is not None:
        shown *= np.exp(gain)[:, None]
    assert angles_overlap(ball)
    return replace(one, texels=replace(one.texels, reflected=shown), position=rng.uniform(-1, 1, (600, 3)),
                   cluster=np.arange(600, dtype=np.int32) // 10)


def metal(roughness: float) -> balls.Reflect:
    def reflect(toward_light: np.ndarray, normal: np.ndarray) -> np.ndarray:
        wide = [np.broadcast_to(v, normal.shape) for v in (balls.BASE, toward_light, balls.TOWARD)]
        return brdf.principled(wide[0], np.full(len(normal), roughness), *wide[1:], normal, metallic=1.0)
    return reflect


@pytest.mark.parametrize("roughness", [0.3, 0.45, 0.6])
def test_what_a_metal_adds_to_views_of_a_flat_board_is_no_exposure(roughness: float) -> None:
    """Left-out views at their given exposures are predicted far worse from changed ones."""
    flat = board(metal(roughness), 12, paint=0.05)
    assert not angles_overlap(flat) and judged(flat) is None


def test_exposures_of_a_matt_flat_board_come_back() -> None:
    gain = 0.2 * np.random.default_rng(8).standard_normal(24)
    change = judged(board(balls.principled(0.6), gain=gain))
    assert change is not None and not change.overlap
    assert np.std(gain - change.found.change.log_gain - change.found.change.log_power) < 0.35 * np.std(gain)


def test_what_a_coat_on_a_flat_board_changes_is_called_in_doubt() -> None:
    """Suns show a flat board one angle each, so that the coat makes some views brighter everywhere.

    No picture tells that from exposures, by which left-out views are predicted well.
    """
    flat = board(coated)
    assert not angles_overlap(flat)
    # Without tilts, changes are so large that what is found under them predicts views as given far worse.
    assert judged(flat) is None
    change = run_to_end(calibrate(flat, lamps=True, exposures=True, normals=True), lambda progress: None)
    assert change is not None and change.changed.relative_rms < 0.2 * change.given.relative_rms
    (line,) = calibrated(told(flat.rig, change))
    assert "changed the exposure of " in line and "That may be the material instead" in line
    (sure,) = calibrated(replace(told(flat.rig, change), overlap=True))
    assert "material" not in sure
