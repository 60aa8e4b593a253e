"""Files that hold a black level beside radiance, rendered by Cycles in a room that is not quite dark."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import SceneData, Solution, View
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.images.reference_image import read_reference
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from tests.support import ball_in_dish

TONES = (0.6, 0.4, 0.3), (0.05, 0.05, 0.06)
ROOM = 0.01, 0.01, 0.012  # W/(m^2 sr): 1 % of the lamps' irradiance
BLACK = np.array((0.004, 0.003, 0.005))  # white shows 0.6 to 2.8
# Of 64 x 64 texels about 400 know their roughness well, from which number on they tell of the others (decision 0053):
# then a trifle decides whether they do.
SETTINGS = SolveSettings(size=128, model="one-lobe", registration="given", indirect="off", normals="mesh")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SceneData:
    return ball_in_dish.rendered(tmp_path_factory.mktemp("black"), TONES, ROOM)


@pytest.fixture(scope="module")
def raised(scene: SceneData, tmp_path_factory: pytest.TempPathFactory) -> SceneData:
    """The same pictures as a camera writes them whose black level nobody has subtracted."""
    folder = tmp_path_factory.mktemp("raised")

    def view(of: View) -> View:
        picture = read_reference(of)
        path = folder / of.image.name
        write_image(path, (picture.rgb + BLACK).astype(np.float32), kind="exr", color=True)
        mask = folder / f"mask of {Path(of.image).name}"
        write_image(mask, np.repeat(picture.coverage[..., None], 3, -1), kind="exr", color=True)
        return replace(of, image=path, mask=mask)

    return replace(scene, views=tuple(map(view, scene.views)))


def solve(scene: SceneData, **more: str) -> Solution:
    return thread.run(lambda: pipeline.solve(scene, replace(SETTINGS, **more)))


def errors(solution: Solution) -> tuple[float, float]:
    """Mean errors of roughness and of base colour, away from the borders of squares."""
    maps, size = solution.maps, SETTINGS.size
    base = ball_in_dish.base_colors(TONES, size)
    at = np.arange(size) % 16
    inside = ((at > 2) & (at < 13))[:, None] & ((at > 2) & (at < 13))[None]
    where = maps.coverage & ~maps.filled & inside
    return (float(np.abs(maps.roughness - ball_in_dish.ROUGH)[where].mean()),
            float(np.abs(maps.base_color - base)[where].mean()))


@pytest.mark.one_python
def test_it_is_told_from_the_room(scene: SceneData, raised: SceneData) -> None:
    right, given, found = solve(scene), solve(raised, lamps="given", exposures="given"), solve(raised)
    assert right.calibration is not None and right.calibration.black_level is None
    calibration = found.calibration
    assert calibration is not None and calibration.black_level is not None and calibration.ambient is not None
    np.testing.assert_allclose(calibration.black_level.level, BLACK, rtol=0.1)
    assert any("black level of 0.004" in line for line in found.warnings)
    before, after, without = (errors(solution) for solution in (given, found, right))
    assert after[0] < 0.004 and after[0] < 1.5 * without[0]  # 0.0029 and 0.0031 here
    assert after[1] < 1.2 * without[1]  # 0.0032 and 0.0032 here
    assert before[0] > 2 * without[0]  # 0.14


def test_a_view_that_has_it_is_read_without_it(scene: SceneData, raised: SceneData) -> None:
    """As a captures.json or the view list states it."""
    told = replace(raised.views[0], black_level=(0.004, 0.003, 0.005))
    there = read_reference(raised.views[0]).coverage > 0.99
    np.testing.assert_allclose(read_reference(told).rgb[there], read_reference(scene.views[0]).rgb[there], atol=2e-3)
