"""Worlds that are turned, or too bright, are put right; exact pictures of a plane, without a renderer."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.calibration import worlds
from irpso_addon.core.calibration.put_right import applied, under_worlds
from irpso_addon.core.change_records import WorldChange
from irpso_addon.core.data import Coat, Environment, SceneData, Solution, View
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.environment import about_z
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.solve.world_light import directions_each
from irpso_addon.solve import pipeline
from tests.support import shoots, skies
from tests.support import synthetic as syn
from tests.support.sky_shoot import shoot

SKY = skies.sky(48, sun=60.0, width=0.12, window=8.0)
QUARTER = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
GOLD = 0.9, 0.65, 0.25
ROOM = replace(skies.sky(48, QUARTER, window=12.0), name="room")


def _spoilt(scene: SceneData, **by: tuple[float, float]) -> SceneData:
    """The worlds turned by so many degrees, and so many times as bright."""
    def other(environment: Environment) -> Environment:
        degrees, factor = by[environment.name]
        return replace(environment, rotation=environment.rotation @ about_z(math.radians(degrees)),
                       radiance=environment.radiance * np.float32(factor))

    return replace(scene, views=tuple(
        view if view.environment is None else replace(view, environment=other(view.environment))
        for view in scene.views))


def _solved(made: syn.Shoot, scene: SceneData, **settings: object) -> Solution:
    return thread.run(lambda: pipeline.solve(
        scene, SolveSettings(size=32, model="one-lobe", **settings), made.read_image))


def _put_right(made: syn.Shoot, scene: SceneData) -> tuple[WorldChange, ...]:
    """Of the worlds, before anything is solved; empty: nothing."""
    found = shoots.put_right(replace(made, scene=scene), size=32, lamps="auto").calibration
    return found.worlds if found is not None else ()


def _views(*environments: Environment) -> list[View]:
    return [View(Path(f"{environment.name} {n}.exr"), camera, (), environment=environment)
            for n, camera in enumerate(syn.cameras(6)) for environment in environments]


@pytest.fixture(scope="module")
def made() -> syn.Shoot:
    """Under one world alone."""
    return shoot(_views(SKY))


@pytest.mark.one_python
@pytest.mark.parametrize("degrees", [-1.0, 3.0, 8.0])
def test_a_turned_world_is_turned_back(made, degrees):
    scene = _spoilt(made.scene, sky=(degrees, 1.0))
    (world,) = _put_right(made, scene)
    assert math.degrees(world.turn) == pytest.approx(-degrees, abs=0.25)  # 0.02, 0.07 and 0.18 here
    assert world.sure_turn and not world.sure_strength and world.strength == pytest.approx(1.0, abs=1e-4)
    right = under_worlds(scene, (world,)).views[0].environment
    assert np.allclose(right.rotation, SKY.rotation @ about_z(math.radians(degrees) + world.turn))


@pytest.mark.one_python
def test_a_solve_says_what_it_has_turned(made):
    scene = _spoilt(made.scene, sky=(3.0, 1.0))
    solution = _solved(made, scene)
    (world,) = solution.calibration.worlds
    assert math.degrees(world.turn) == pytest.approx(-3.0, abs=0.25)
    assert f"IRPSO turned world 'sky' by {math.degrees(world.turn):+.1f} degrees" in solution.warnings[0]
    right = under_worlds(scene, (world,)).views[0].environment
    again = applied(scene, solution.calibration)
    assert np.array_equal(again.views[0].environment.rotation, right.rotation)


def test_an_exact_world_stays(made):
    auto, given = (_solved(made, made.scene, lamps=lamps) for lamps in ("auto", "given"))
    assert auto.calibration is None
    for name in ("base_color", "roughness", "confidence"):
        assert getattr(auto.maps, name).tobytes() == getattr(given.maps, name).tobytes()


@pytest.mark.one_python
def test_a_turntable_of_many_turns_is_judged_by_few_directions_each(monkeypatch):
    """16 turns cost as much as six, and the world is found as well as by 128 directions for each of them."""
    skies.sum_few_directions(monkeypatch)  # the maps under it are not judged
    assert [directions_each(count) for count in (1, 6)] == [128, 128]
    assert 16 * directions_each(16) <= 6 * 128
    turns = [replace(SKY, rotation=SKY.rotation @ about_z(turn), turn=turn) for turn in np.arange(16) * np.pi / 8]
    views = [View(Path(f"{n}.exr"), camera, (), environment=turned)
             for n, (camera, turned) in enumerate(zip(syn.cameras(16), turns, strict=True))]
    made = shoot(views)
    found = _put_right(made, _spoilt(made.scene, sky=(3.0, 1.0)))
    assert len(found) == 16 and all(world.sure_turn for world in found)
    assert [math.degrees(world.turn) for world in found] == pytest.approx([-3.0] * 16, abs=0.25)


@pytest.mark.one_python
@pytest.mark.parametrize("reflect", [
    partial(brdf.principled, level=0.8),
    partial(brdf.principled, metallic=0.1),
    partial(brdf.principled, metallic=0.15),
    partial(brdf.principled, metallic=0.5, coat=Coat(0.6, 0.25))])
def test_other_materials_do_not_turn_a_world(reflect):
    """Highlights that are brighter all around; and a material of which the model explains little."""
    made = shoot(_views(SKY), replace(syn.PATCHES, reflect=reflect))
    assert _put_right(made, made.scene) == ()


@pytest.mark.one_python
def test_a_world_is_turned_back_where_a_little_metal_makes_highlights_brighter(monkeypatch):
    """Its Specular IOR Level stands for it.  Where more is left over than the level explains, a line says the turn."""
    made = shoot(_views(SKY), replace(syn.PATCHES, reflect=partial(brdf.principled, metallic=0.15)))
    turned = _spoilt(made.scene, sky=(3.0, 1.0))
    (world,) = _put_right(made, turned)
    assert world.sure_turn and math.degrees(world.turn) == pytest.approx(-3.0, abs=0.7)  # 0.5 here
    monkeypatch.setattr(worlds, "EXPLAINED", 0.05)  # 10 % are left
    stays = _solved(made, turned)
    assert stays.calibration is None
    assert f"if IRPSO turned world 'sky' by {math.degrees(world.turn):+.1f} degrees, but 10 %" in stays.warnings[0]


def _gilded(base: np.ndarray, roughness: np.ndarray, *others: np.ndarray) -> np.ndarray:
    """Gold where the base colour is gold's."""
    return brdf.principled(base, roughness, *others, metallic=float(base[2] == GOLD[2]))


@pytest.mark.one_python
def test_a_metal_beside_a_paint_does_not_keep_a_world_from_being_turned():
    """No lobe of a dielectric explains its material, so the paint alone says how far the world is off."""
    patches = syn.quarters([(0.6, 0.3, 0.1), GOLD, (0.7, 0.7, 0.7), GOLD])
    made = shoot(_views(SKY), replace(syn.PATCHES, base=patches, reflect=_gilded))
    made = replace(made, scene=replace(made.scene, mesh=syn.plane_mesh(lambda u, v: u > 0.5, ("Paint", "Gold"))))
    (world,) = _put_right(made, _spoilt(made.scene, sky=(3.0, 1.0)))
    assert world.sure_turn and math.degrees(world.turn) == pytest.approx(-3.0, abs=0.25)
    assert _put_right(made, made.scene) == ()


@pytest.mark.one_python
def test_an_overcast_sky_shows_neither_turn_nor_strength():
    made = shoot(_views(skies.sky(48)))
    assert _put_right(made, _spoilt(made.scene, sky=(20.0, 1.5))) == ()


@pytest.mark.one_python
def test_the_strengths_of_two_worlds_and_their_turns():
    """Brightness as a whole belongs to the base colours: each takes half of what they differ by."""
    made = shoot(_views(SKY, ROOM))
    sky, room = _put_right(made, _spoilt(made.scene, sky=(-2.0, 1.0), room=(3.0, 1.1)))
    assert sky.strength / room.strength == pytest.approx(1.1, rel=0.005)  # 0.1 % off here
    assert sky.strength * room.strength == pytest.approx(1.0, rel=1e-3)
    assert math.degrees(sky.turn) == pytest.approx(2.0, abs=0.4) and math.degrees(room.turn) == pytest.approx(
        -3.0, abs=0.5)


@pytest.mark.one_python
def test_a_world_beside_lamps():
    lamps = syn.lamps(4)
    views = [View(Path(f"{c} {n}.exr"), camera, (lamp,), environment=SKY)
             for c, camera in enumerate(syn.cameras(3)) for n, lamp in enumerate(lamps)]
    made = shoot(views)
    (world,) = _put_right(made, _spoilt(made.scene, sky=(4.0, 1.1)))
    assert world.strength == pytest.approx(1 / 1.1, rel=0.005)  # 0.2 % off here
    assert math.degrees(world.turn) == pytest.approx(-4.0, abs=0.25)
