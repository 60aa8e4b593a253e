"""Lamps in a room that is not quite dark, rendered by Cycles: the light from everywhere is found and subtracted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import SceneData, Solution
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from tests.support import ball_in_dish

pytestmark = pytest.mark.one_python

BASE = 0.6, 0.3, 0.12
RADIANCE = 0.05, 0.06, 0.08  # W/(m^2 sr): 5 % of the lamps' irradiance
SETTINGS = SolveSettings(size=64, model="one-lobe", registration="given", indirect="off", normals="mesh")


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> SceneData:
    return ball_in_dish.rendered(tmp_path_factory.mktemp("ambient"), [BASE], RADIANCE)


def solve(scene: SceneData, **more: str) -> Solution:
    return thread.run(lambda: pipeline.solve(scene, replace(SETTINGS, **more)))


def errors(solution: Solution) -> tuple[float, float]:
    """Mean errors of roughness and of base colour."""
    maps = solution.maps
    where = maps.coverage & ~maps.filled
    return (float(np.abs(maps.roughness - ball_in_dish.ROUGH)[where].mean()),
            float(np.abs(maps.base_color - BASE)[where].mean()))


def test_the_room_is_found(scene: SceneData) -> None:
    """All of what it costs is mended; the dish hides a part of it."""
    given, found = solve(scene, lamps="given", exposures="given"), solve(scene)
    told = replace(scene, views=tuple(replace(view, ambient_radiance=RADIANCE) for view in scene.views))
    known = solve(told, lamps="given", exposures="given")
    assert found.calibration is not None and found.calibration.ambient is not None
    np.testing.assert_allclose(found.calibration.ambient.radiance, RADIANCE, rtol=0.04)  # 2.9 % of red here
    before, after, right = (errors(solution) for solution in (given, found, known))
    assert after[1] < 0.1 * before[1] and right[1] < 0.1 * before[1]  # 0.0042 and 0.0044 of 0.0700 here
    assert after[0] < 0.6 * before[0] and right[0] < 0.6 * before[0]  # 0.029 and 0.033 of 0.115
