"""What a calibration says of a scene, as records: made again from them, the scene is the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.calibration.finish import Judged, as_bright
from irpso_addon.core.calibration.put_right import applied, put_right, told
from irpso_addon.core.calibration.rig import Rig, RigChange
from irpso_addon.core.calibration.rig_fit import RigFound, ViewBrightness
from irpso_addon.core.calibration.rig_numbers import Free
from irpso_addon.core.change_records import PredictionError
from irpso_addon.core.checks.mended_cameras import name_alone, rolled
from irpso_addon.core.data import Light, SceneData
from tests.support import shoots
from tests.support import synthetic as syn

MIDDLE = np.zeros(3)


def judged(rig: Rig, seed: int = 0, tinted: bool = False) -> Judged:
    rng = np.random.default_rng(seed)
    groups, views = len(rig.groups), len(rig.views)
    change = RigChange(0.02 * rng.standard_normal((groups, 3)), 0.05 * rng.standard_normal(groups),
                       0.03 * rng.standard_normal(views), 0.7, 0.05, -0.1, 1.5,
                       black_level=np.array([0.01, 0.02, -0.03]), extent=0.07)
    error = RigChange(np.full((groups, 3), 1e-4), np.full(groups, 1e-4), np.full(views, 1e-4), 0.1,
                      black_level=np.full(3, 1e-4), extent=0.01)
    if tinted:
        change = replace(change, log_tint=0.05 * rng.standard_normal((groups, 3)),
                         log_balance=0.05 * rng.standard_normal((views, 3)))
        error = replace(error, log_tint=np.full((groups, 3), 1e-4), log_balance=np.full((views, 3), 2e-4))
    brightness = ViewBrightness(change.log_gain, error.log_gain)
    found = RigFound(change, error, 0.01, 0.03, (0.02, 0.01), {}, brightness, np.zeros(0))
    return Judged(found, PredictionError(0.2, 2.0), PredictionError(0.1, 1.0),
                  Free(True, True, vignetting=True, ambient=True, response=True), error, (0.02, 0.03, 0.04))


def assert_alike(one: SceneData, other: SceneData) -> None:
    for a, b in zip(one.views, other.views, strict=True):
        assert np.isclose(a.gain, b.gain, rtol=1e-12) and a.vignetting == b.vignetting
        np.testing.assert_allclose(a.tint, b.tint, rtol=1e-12)
        assert a.response == b.response == np.exp(-0.1) and a.shoulder == b.shoulder == np.exp(1.5)
        assert a.black_level == b.black_level == (0.01, 0.02, -0.03)
        assert a.ambient_radiance == b.ambient_radiance == (0.02, 0.03, 0.04)
        for x, y in zip(a.lights, b.lights, strict=True):
            np.testing.assert_allclose(x.matrix, y.matrix, atol=1e-12)
            assert x.radius == y.radius == 0.07
            np.testing.assert_allclose(x.power, y.power, rtol=1e-12)


def as_sun(light: Light) -> Light:
    """A sun that shines as the lamp does."""
    matrix = np.eye(4)
    matrix[:3, 2] = light.matrix[:3, 3] / np.linalg.norm(light.matrix[:3, 3])
    return replace(light, kind="SUN", matrix=matrix)


def flash_shoot(carried: bool = True) -> SceneData:
    """Five cameras with a flash each; not ``carried``: one of them sits elsewhere."""
    rig = []
    for n, camera in enumerate(syn.cameras(5)):
        turn = camera.world_to_camera[:3, :3].T
        matrix = np.eye(4)
        offset = np.array([0.06, 0.08, 0.02]) if carried or n else np.array([0.06, 0.2, 0.02])
        matrix[:3, :3], matrix[:3, 3] = turn, camera.position + turn @ offset
        rig.append((camera, [replace(syn.lamps(1)[0], name=f"Flash {n}", matrix=matrix)]))
    return syn.shoot(syn.PATCHES, rig, (8, 8)).scene


def test_a_change_is_made_again_from_its_records() -> None:
    """Of lamps, suns and a flash on the cameras, with other colours and without."""
    plain = syn.shoot(syn.PATCHES, shoots.rig(2, 4), (8, 8)).scene
    suns = replace(plain, views=tuple(replace(view, lights=tuple(map(as_sun, view.lights))) for view in plain.views))
    for scene in (plain, suns, flash_shoot()):
        rig = Rig.of(scene.views, MIDDLE)
        for tinted in (False, True):
            found = judged(rig, tinted=tinted)
            calibration = told(rig, found)
            assert all(lamp.sure_tint == tinted for lamp in calibration.lamps)
            assert all(view.sure_tint == tinted == (view.tint_error > 0) for view in calibration.exposures)
            assert_alike(put_right(scene, rig, found), applied(scene, calibration))


def test_a_flash_is_one_lamp_where_every_camera_carries_it_alike() -> None:
    group, = Rig.of(flash_shoot().views, MIDDLE).groups
    assert group.lights == tuple(f"Flash {n}" for n in range(5))
    assert len(Rig.of(flash_shoot(carried=False).views, MIDDLE).groups) == 5


def test_a_carried_flash_moves_in_its_cameras_axes() -> None:
    scene = flash_shoot()
    rig = Rig.of(scene.views, MIDDLE)
    reach = rig.groups[0].reach
    change = replace(RigChange.none(1, 5), offset=np.array([[0.03, 0.0, 0.0]]) / reach)
    for view, light in zip(scene.views, rig.lights(change).values(), strict=True):
        place = view.camera.world_to_camera @ light.matrix[:, 3]
        np.testing.assert_allclose(place[:3], (0.09, 0.08, 0.02), atol=1e-9)


@pytest.mark.parametrize(("nearer", "least", "most"), [(0.0, -1e-9, 1e-9), (0.015, -1e-9, 1e-9), (-0.015, -1e-9, 1e-9),
                                                       (0.1, 0.08, 0.1)])
def test_a_flash_that_seems_a_little_nearer_lights_as_it_did(nearer: float, least: float, most: float) -> None:
    """The distance is believed where it is clearly more than what ambient light and errors of a mesh make of it."""
    rig = Rig.of(flash_shoot().views, MIDDLE)
    group = rig.groups[0]
    place = {name: light.matrix[:3, 3] for name, light in rig.lights(RigChange.none(1, 5)).items()}
    toward = group.axes[0].T @ (MIDDLE - place[group.lights[0]]) / group.reach
    error = replace(RigChange.none(1, 5), offset=np.full((1, 3), 0.003))
    change, error = as_bright(rig, MIDDLE, replace(RigChange.none(1, 5), offset=nearer * toward[None]), error)
    now = rig.lights(change)
    for name, light in now.items():
        far = np.linalg.norm(MIDDLE - light.matrix[:3, 3]) / np.linalg.norm(MIDDLE - place[name])
        brighter = np.log(float(light.power.mean() / syn.lamps(1)[0].power.mean())) - 2 * np.log(far)
        assert -2 * np.log(1 - least) - 1e-3 < brighter < -2 * np.log(1 - most) + 1e-3
    assert float(error.log_power[0]) == pytest.approx(0.006, rel=0.1)


def test_a_flash_is_one_lamp_whose_cameras_were_turned() -> None:
    """By a degree about their axes, each another way; the flashes stayed."""
    views = [replace(view, camera=rolled(view.camera, np.radians(turn)))
             for view, turn in zip(flash_shoot().views, (1, -1, 0, 0.5, -1), strict=True)]
    group, = Rig.of(views, MIDDLE).groups
    assert len(group.lights) == 5


def test_records_name_the_cameras_of_the_scene() -> None:
    """Also where a view has got a camera of its own."""
    views = list(flash_shoot().views)
    names = [view.camera.name for view in views]
    views[1] = replace(views[1], camera=replace(views[1].camera, name=name_alone(views[1])))
    scene = replace(flash_shoot(), views=tuple(views))
    rig = Rig.of(views, MIDDLE)
    found = judged(rig)
    calibration = told(rig, found)
    assert calibration.lamps[0].cameras == tuple(names)
    assert [exposure.camera for exposure in calibration.exposures] == names
    assert_alike(applied(scene, calibration), put_right(scene, rig, found))
