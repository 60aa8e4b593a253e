"""What studies/standard_errors.py counts: numbers of known errors, and scenes that are wrong by known amounts."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.change_records import Calibration, ExposureChange, LampChange, PredictionError
from irpso_addon.core.data import SceneData
from studies import lamp_colors
from studies.calibration import Case, wrong
from studies.standard_errors import FEWEST_LAMPS, MOST_LAMPS, Number, chosen, held, numbers, pairs_of
from tests.support import shoots
from tests.support import synthetic as syn

NOTHING = PredictionError(0.1, 1.0)


@pytest.fixture(scope="module")
def scene() -> SceneData:
    return syn.shoot(syn.PATCHES, shoots.rig(3, 12), (4, 4)).scene


def test_intervals_of_normal_errors_hold_as_often_as_they_say():
    rng = np.random.default_rng(2)
    drawn = [[Number("place", float(2e-3 * rng.standard_normal()), 2e-3)] for _ in range(20000)]
    assert held(pairs_of(drawn, "place")) == pytest.approx(0.9, abs=0.007)  # three deviations of 20000 draws
    assert len(pairs_of(drawn, "power")) == 0


def test_shoots_differ_and_have_every_camera_under_every_lamp(scene):
    seen = set()
    for seed in range(20):
        views = chosen(scene, np.random.default_rng(seed)).views
        cameras, lamps = {view.camera.name for view in views}, {view.lights[0].name for view in views}
        assert len(views) == len(cameras) * len(lamps)
        assert len(cameras) in (2, 3) and FEWEST_LAMPS <= len(lamps) <= MOST_LAMPS
        seen.add((*sorted(cameras), *sorted(lamps)))
    assert len(seen) > 15


def test_what_is_put_right_in_full_is_off_by_nothing(scene):
    given = wrong(scene, Case("", lamps=True), np.random.default_rng(1))
    was = {light.name: light for view in given.views for light in view.lights}
    true = {light.name: light for view in scene.views for light in view.lights}
    lamps = []
    for name, light in was.items():
        x, y, z = (true[name].matrix[:3, 3] - light.matrix[:3, 3]).tolist()
        factor = float(true[name].power[0] / light.power[0])
        lamps.append(LampChange((name,), (x, y, z), (0.001, 0.002, 0.003), 0.01, 2 * factor, 0.01))
    exposures = tuple(
        ExposureChange(right.image, right.camera.name, float(np.log2(right.gain / off.gain)) + 0.5, 0.01)
        for right, off in zip(scene.views, given.views, strict=True))
    told = numbers(scene, given, Calibration(tuple(lamps), exposures, NOTHING, NOTHING))
    assert {one.kind for one in told} == {"place", "power", "exposure"}
    assert max(abs(one.off) for one in told) < 1e-9  # what all powers and all exposures share is left out
    reach = float(np.linalg.norm(was["Light 0"].matrix[:3, 3]))
    assert [one.error * reach for one in told[:3]] == pytest.approx([0.001, 0.002, 0.003])


def test_the_last_rows_of_lamp_colors_are_wrong_about_lamps_too(scene):
    """Each lamp is 1 % of its distance away: all that the rows' name says."""
    given = wrong(scene, lamp_colors.ALL)
    was, true = ({light.name: light.matrix[:3, 3] for view in shown.views for light in view.lights}
                 for shown in (given, scene))
    away = [np.linalg.norm(was[name] - place) / np.linalg.norm(place) for name, place in true.items()]
    assert away == pytest.approx([0.01] * len(true), rel=1e-4)
    assert len({view.gain for view in given.views}) == len(given.views)
