"""Area lamps as large as a wall as meshes: against the closed form of the lamp's irradiance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import SceneData, View
from irpso_addon.core.shading import emitters, lights
from irpso_addon.core.shading.wide_lamps import emitter_of, is_wide, with_wide_lamps_as_meshes
from tests.support import glowing
from tests.support import synthetic as syn

NOBODY = np.zeros((0, 3, 3), np.float32)
WALL = syn.lamp((2.0, 0, 0.7), kind="AREA", name="Wall", shape="RECTANGLE", size=(3.0, 2.4), power=(90.0, 60.0, 30.0))


@pytest.mark.parametrize("light", [
    WALL, replace(WALL, shape="DISK"), replace(WALL, shape="ELLIPSE"),
    replace(WALL, shape="SQUARE", matrix=WALL.matrix @ np.diag([-0.8, 1.2, 1.0, 1.0]))],
    ids=["rectangle", "disk", "ellipse", "mirrored"])
def test_the_mesh_sends_the_lamps_light(light):
    rng = np.random.default_rng(4)
    P, N = rng.uniform(-0.3, 0.3, (80, 3)), rng.normal(size=(80, 3))
    N /= np.linalg.norm(N, axis=1, keepdims=True)
    N[(N * (light.matrix[:3, 3] - P)).sum(1) < 0] *= -1
    found = emitters.emitter_irradiance(emitters.patches([emitter_of(light)], np.zeros(3), 0.5), P, N)
    want = lights.light_irradiance(light, P, N)[:, None] * light.power
    bright = want[:, 0] > 0.2 * want[:, 0].max()  # else the horizon cuts single patches
    assert bright.sum() > 40
    assert np.abs(found[bright] / want[bright] - 1).max() < 0.02


def test_it_shines_on_one_side():
    behind = np.array([[4.0, 0, 1.4]])
    assert lights.light_irradiance(WALL, behind, np.array([[-1.0, 0, 0]])) == 0
    assert not len(emitters.patches([emitter_of(WALL)], behind[0], 0.5).place)


def test_only_lamps_that_are_nearly_as_wide_as_far_are_changed():
    small = replace(WALL, size=(0.9, 0.9))
    center = np.zeros(3)
    assert is_wide(WALL, center)
    for other in (small, replace(WALL, spread=1.0), replace(WALL, cast_shadow=False), syn.lamp((0, 0, 0.1))):
        assert not is_wide(other, center)


def test_views_keep_their_other_lamps_and_share_what_glows():
    panel = glowing.rectangle((0, 0, 2.0), (0.5, 0, 0), (0, 0.5, 0))
    small, around = syn.lamp((0, 1.0, 2.0), name="Small"), emitter_of(replace(WALL, name="Other"))
    cams = syn.cameras(4)
    views = (View(Path("a.exr"), cams[0], (WALL, small)), View(Path("b.exr"), cams[1], (WALL,)),
             View(Path("c.exr"), cams[2], (small,)), View(Path("d.exr"), cams[3], (WALL,)))
    scene = SceneData("plane", syn.plane_mesh(), NOBODY, views)
    a, b, c, d = with_wide_lamps_as_meshes(scene).views
    assert a.lights == (small,) and b.lights == () and c is views[2]
    assert a.environment is b.environment is d.environment
    assert [emitter.name for emitter in a.environment.emitters] == ["Wall"] and a.environment.name == ""
    lit = replace(views[1], environment=replace(a.environment, name="sky", emitters=(panel, around)))
    (found,) = with_wide_lamps_as_meshes(replace(scene, views=(lit,))).views
    assert found.environment.key == ("sky", 0.0, ("Panel", "Other", "Wall"))
    none = replace(scene, views=(views[2],))
    assert with_wide_lamps_as_meshes(none) is none
