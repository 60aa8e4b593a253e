"""The whole pipeline told to stop at any step: what it keeps, how it tells its progress, and what it leaves behind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import Solution
from irpso_addon.core.errors import BadInput, Cancelled
from irpso_addon.core.job import Progress
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.observe import observation_atlas as gpu_atlas
from irpso_addon.solve import pipeline
from tests.support import shoots
from tests.support import synthetic as syn
from tests.support.shoots import AS_GIVEN, SIZE, errors, rig, run, turned_away
from tests.support.texels import held


def stopped(shoot: syn.Shoot, stage: str, monkeypatch: pytest.MonkeyPatch, after: int = 3,
            message: str = "", **settings: str) -> Solution:
    """Stop at the ``after``-th step of a stage whose message begins so; the pipeline's own answer to Cancelled."""
    monkeypatch.setattr(gpu_atlas, "TILE", (16, 16))
    return thread.run(lambda: shoots.stopped(
        pipeline.solve(shoot.scene, SolveSettings(size=SIZE, **{**AS_GIVEN, **settings}), shoot.read_image),
        stage, after, message))


def test_a_stop_in_the_search_keeps_what_was_found(patches, monkeypatch):
    """Three tiles of sixteen are solved, the rest is filled from them."""
    found = stopped(patches, "solve", monkeypatch)
    assert found.cancelled
    maps = found.maps
    for values in (maps.base_color, maps.roughness, maps.confidence, maps.error):
        assert np.isfinite(values).all()
    rows, _ = np.nonzero(maps.coverage & ~maps.filled)
    assert 100 < len(rows) <= 3 * 16 * 16
    assert rows.max() < 32
    off = errors(found, syn.PATCHES)
    assert np.median(off.rough) < 1e-4
    assert np.median(off.base) < 0.05
    assert found.texels["solved"] + found.texels["filled"] == found.texels["covered"]


@pytest.mark.one_python
@pytest.mark.parametrize("after", [1, 3, 6])
def test_a_stop_while_left_out_views_are_predicted_keeps_the_first_fit(patches, monkeypatch, after):
    found = stopped(patches, "solve", monkeypatch, after, "predicting")
    assert found.cancelled and not found.predictions
    assert found.texels["solved"] == found.texels["observed"]
    assert np.median(errors(found, syn.PATCHES).rough) < 1e-3


@pytest.mark.one_python
@pytest.mark.parametrize("after", [70, 80, 90])
def test_a_stop_while_models_are_tried_keeps_the_first_fit(after):
    """Parts, roughnesses and levels that are drawn to the material's, each in three folds: steps 63 to 100."""
    even = replace(syn.PATCHES, roughness=lambda u, v: np.full_like(np.asarray(u, np.float64), 0.3))
    shoot = syn.shoot(even, rig(2, 8), noise=0.01)
    found = thread.run(lambda: shoots.stopped(
        pipeline.solve(shoot.scene, SolveSettings(size=SIZE, **AS_GIVEN), shoot.read_image), "solve", after))
    assert found.cancelled and not found.predictions
    assert np.median(errors(found, even).rough) < 0.02


@pytest.mark.one_python
@pytest.mark.parametrize("after", [1, 17, 33])
def test_a_stop_at_any_step_of_the_search_gives_a_solution(patches, monkeypatch, after):
    found = stopped(patches, "solve", monkeypatch, after)
    assert found.cancelled
    assert np.isfinite(found.maps.base_color).all()
    assert found.texels["solved"] > 0


@pytest.mark.one_python
def test_a_stop_in_the_base_colour_keeps_the_roughness(patches, solved, monkeypatch):
    found = stopped(patches, "maps", monkeypatch)
    assert found.cancelled
    assert np.isfinite(found.maps.base_color).all()
    np.testing.assert_allclose(found.maps.roughness, solved["refined"].maps.roughness, atol=1e-6)


@pytest.mark.parametrize("after", [1, 4, 9])
def test_a_stop_between_cameras_of_the_base_colour_leaves_a_whole_one(patches, solved, monkeypatch, after):
    """The first back-projection comes to its end; a later one is as if it had not begun.  Each camera is a step."""
    found = stopped(patches, "maps", monkeypatch, after, "base colour")
    assert found.cancelled
    whole = solved["refined"].maps
    solved_texels = found.maps.coverage & ~found.maps.filled
    np.testing.assert_array_equal(solved_texels, whole.coverage & ~whole.filled)
    off = np.abs(found.maps.base_color - whole.base_color)[solved_texels]
    assert np.median(off) < 0.01 and np.quantile(off, 0.95) < 0.1  # it is less sharp


def test_a_stop_before_the_standard_errors_keeps_them(patches, solved, monkeypatch):
    found = stopped(patches, "maps", monkeypatch, 1, "standard errors")
    assert found.cancelled
    np.testing.assert_allclose(found.maps.confidence, solved["refined"].maps.confidence, atol=1e-6)


def test_a_stop_during_the_checks_keeps_the_maps(patches, solved, monkeypatch):
    """They are whole then, and each view is a step; those that were not looked at are not in the report."""
    found = stopped(patches, "maps", monkeypatch, 3, "checks")
    assert found.cancelled
    np.testing.assert_array_equal(found.maps.filled, solved["refined"].maps.filled)
    np.testing.assert_allclose(found.maps.roughness, solved["refined"].maps.roughness, atol=1e-6)
    np.testing.assert_allclose(found.maps.base_color, solved["refined"].maps.base_color, atol=1e-6)
    assert found.checks is not None and len(found.checks.views) == len(found.pictures) == 3


@pytest.mark.parametrize("stage", ["gbuffer", "observe", "cameras"])
def test_a_stop_before_the_search_has_nothing_to_keep(patches, monkeypatch, stage):
    with pytest.raises(Cancelled):
        stopped(patches, stage, monkeypatch, after=1)


def test_progress_only_grows(patches):
    told: list[Progress] = []

    def job():
        steps = pipeline.solve(patches.scene, SolveSettings(size=SIZE), patches.read_image)
        while True:
            try:
                told.append(next(steps))
            except StopIteration as stop:
                return stop.value
            yield told[-1]

    thread.run(job)
    fractions = [step.fraction for step in told]
    assert fractions == sorted(fractions)
    assert 0 <= fractions[0]
    assert 0.99 < fractions[-1] <= 1
    steps = [step.message for step in told].count("base colour")
    cameras = len({view.camera.name for view in patches.scene.views})
    assert steps >= 6 * (cameras + 1)  # with a hundred cameras, one of six back-projections takes a minute
    stages = [step.stage for step in told]
    assert list(dict.fromkeys(stages)) == ["gbuffer", "observe", "cameras", "calibrate", "normals", "solve", "maps"]


def test_nothing_is_left_on_the_device(on_gl, patches):
    """Whether it ends well, is stopped or fails; programs stay, and so they are built before."""
    run(patches)
    before = on_gl(held)
    for _ in range(2):
        run(patches)
        assert on_gl(held) <= before
    with pytest.raises(BadInput):
        run(turned_away(patches, len(patches.scene.views)))
    assert on_gl(held) <= before


def test_a_stop_leaves_nothing_on_the_device(on_gl, patches, monkeypatch):
    """Of what looks for wrong lamps and normals neither."""
    auto = dict.fromkeys(AS_GIVEN, "auto")
    stopped(patches, "solve", monkeypatch, **auto)
    before = on_gl(held)
    stopped(patches, "solve", monkeypatch, **auto)
    assert on_gl(held) <= before
    with pytest.raises(Cancelled):
        stopped(patches, "observe", monkeypatch)
    assert on_gl(held) <= before
