"""Shading normals that the mesh lacks are refined by the whole pipeline, and exact ones are left as they are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import Light, Region, Solution
from irpso_addon.core.images.image_file import open_image
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.normals.tangent_map import wearing
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.tiled import uv_blocks
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.solve import normal_texels
from irpso_addon.solve import tiled_solve
from irpso_addon.solve.plan_preparation import TiledRequest
from tests.support import shoots
from tests.support import synthetic as syn
from tests.support.plane_normals import angles

PIXELS = (96, 96)
QUICK = {"model": "one-lobe", "registration": "given", "indirect": "off", "normals": "auto"}
RIG = (3, 12)  # cameras, lamps each
WAVES, SLOPE = 26.0, 0.06  # fine bumps: radians a metre


def bumpy(points: np.ndarray) -> np.ndarray:
    """The plane's rolling normals with fine bumps on them."""
    normal = ROLLING(points)
    x, y = points[..., 0], points[..., 1]
    normal = normal + SLOPE * np.stack([np.sin(WAVES * x + 3 * y), np.cos(WAVES * y), 0 * x], -1)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


ROLLING = syn.plane_normal


@pytest.fixture(scope="module")
def plane() -> syn.Shoot:
    return syn.shoot(syn.PATCHES, shoots.rig(2, 8), PIXELS, noise=0.01)


@pytest.fixture(scope="module")
def rough() -> syn.Shoot:
    """Pictures of a bumpy plane, whose mesh has no bumps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(syn, "plane_normal", bumpy)
        return syn.shoot(syn.PATCHES, shoots.rig(*RIG), PIXELS, noise=0.005)


def test_exact_normals_stay_to_the_byte(plane) -> None:
    given, auto = (shoots.run(plane, **QUICK | {"normals": word}) for word in ("mesh", "auto"))
    assert auto.normals is None and auto.maps.normal is None and auto.normals_why
    assert not given.normals_why
    assert np.array_equal(given.maps.roughness, auto.maps.roughness)
    assert np.array_equal(given.maps.base_color, auto.maps.base_color)


@pytest.fixture(scope="module")
def refined(rough) -> Solution:
    return shoots.run(rough, **QUICK, size=96)


def test_bumps_become_a_normal_map(rough, refined) -> None:
    assert refined.normals is not None and refined.normals.refined < 0.6 * refined.normals.given
    assert any("normal map" in line for line in refined.warnings)
    before, after = angles(refined, ROLLING, bumpy)
    assert before.mean() > 2.5 and after.mean() < 0.4 * before.mean()


@pytest.mark.one_python
def test_the_tilt_that_is_reported_is_that_of_what_views_show(rough, refined) -> None:
    """Texels outside the pictures keep the mesh's normals: half of all are such, or more."""
    y, x = np.indices(PIXELS) - (PIXELS[0] - 1) / 2
    middle = np.hypot(x, y) < 20
    images = {name: replace(image, coverage=np.where(middle, image.coverage, 0))
              for name, image in rough.images.items()}
    found = shoots.run(replace(rough, images=images), **QUICK, size=96)
    assert found.normals is not None
    assert found.maps.filled.sum() > 0.5 * found.maps.coverage.sum()
    assert found.normals.tilt == pytest.approx(refined.normals.tilt, rel=0.2)


@pytest.mark.one_python
def test_maps_under_refined_normals_are_nearer_to_the_truth(rough, refined) -> None:
    given = shoots.run(rough, **QUICK | {"size": 96, "normals": "mesh"})
    assert given.maps.normal is None
    before, after = (shoots.errors(solution, rough.truth) for solution in (given, refined))
    assert np.mean(before.rough > 0.1) > 0.1
    assert np.mean(after.rough > 0.1) < 0.5 * np.mean(before.rough > 0.1)
    assert after.base.mean() < 0.5 * before.base.mean()


@pytest.mark.one_python
def test_a_map_of_more_texels_than_are_fitted(rough, monkeypatch) -> None:
    """Every second row and column says the tilts."""
    monkeypatch.setattr("irpso_addon.gpu.solve.normal_texels.MOST", 3000)
    before, after = angles(shoots.run(rough, **QUICK, size=96), ROLLING, bumpy)
    assert after.mean() < 0.6 * before.mean()


def test_a_map_does_not_depend_on_how_many_threads_fit_it(rough, refined, monkeypatch) -> None:
    monkeypatch.setattr(normal_texels, "THREADS", 1 if normal_texels.THREADS > 1 else 3)
    alone = shoots.run(rough, **QUICK, size=96)
    assert np.array_equal(alone.maps.normal, refined.maps.normal)
    assert np.array_equal(alone.maps.roughness, refined.maps.roughness)


@pytest.mark.one_python
def test_a_part_under_kept_normals_is_as_sure_as_the_whole(rough, refined) -> None:
    """Noise counts twice there too (decision 0043): else a tenth of the standard errors are a fifth smaller."""
    size = len(refined.maps.coverage)
    white = np.zeros((size, size), np.float32)
    white[:, size // 2:] = 1.0
    scene = replace(rough.scene, mesh=wearing(rough.scene.mesh, refined.maps.normal), start=refined,
                    region=Region(image=white))
    part = shoots.run(replace(rough, scene=scene), **QUICK, size=size)
    solved = (white > 0.5) & part.maps.coverage & ~part.maps.filled
    ratio = part.maps.roughness_sigma[solved] / refined.maps.roughness_sigma[solved]
    assert np.quantile(ratio, [0.1, 0.9]) == pytest.approx(1.0, abs=0.03)


@dataclass(frozen=True)
class InBlocks:
    """A map that was solved in blocks: what its solve states, its plan's normal map, and its files."""

    solution: Solution
    planned: np.ndarray | None
    layers: dict[str, np.ndarray]


def in_blocks(shoot: syn.Shoot, folder: Path, size: int, plan: int) -> InBlocks:
    """Blocks of 64 texels beside a plan of ``plan``."""
    views = []
    folder.mkdir()
    for view in shoot.scene.views:
        write_image(folder / view.image.name, shoot.images[view.image.name].rgb, kind="exr", color=True)
        views.append(replace(view, image=folder / view.image.name))
    settings = SolveSettings(**QUICK | {"size": size, "lamps": "given", "exposures": "given"})
    request = TiledRequest(replace(shoot.scene, views=tuple(views)), settings, block=64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uv_blocks, "PLAN", plan)
        patch.setattr(uv_blocks, "PLAN_SQUARE", plan)
        solution = thread.run(lambda: tiled_solve.run(request, folder, folder / "work", "exr"))
    files = {path.stem.removeprefix("Subject_"): open_image(path) for path in folder.glob("Subject_*.exr")}
    return InBlocks(solution, solution.maps.normal, {
        layer: file.read(0, file.height)[::-1, :, :3] for layer, file in files.items()})


@pytest.fixture(scope="module")
def blocks(rough, tmp_path_factory) -> InBlocks:
    return in_blocks(rough, tmp_path_factory.mktemp("blocks") / "out", size=96, plan=96)


@pytest.mark.one_python
def test_blocks_have_the_normals_of_the_plan(blocks, refined) -> None:
    """Where both have the same texels their normal maps are the same, padding and borders of blocks included."""
    assert blocks.solution.normals is not None and blocks.planned is not None
    assert blocks.solution.normals.refined < 0.6 * blocks.solution.normals.given
    assert any("normal map" in line for line in blocks.solution.warnings)
    assert blocks.layers["normal"] == pytest.approx(blocks.planned, abs=2e-4)


@pytest.mark.one_python
def test_maps_in_blocks_are_as_right_as_in_one_piece_under_refined_normals(rough, blocks, refined) -> None:
    found = replace(refined, maps=replace(
        refined.maps, roughness=blocks.layers["roughness"][..., 0], base_color=blocks.layers["basecolor"],
        filled=blocks.layers["filled"][..., 0] > 0.5))
    whole, parts = (shoots.errors(solution, rough.truth) for solution in (refined, found))
    assert parts.share > 0.98 * whole.share
    assert parts.rough.mean() < 1.1 * whole.rough.mean() and parts.base.mean() < 1.1 * whole.base.mean()


@pytest.mark.one_python
def test_a_plan_of_fewer_texels_than_the_map(rough, refined, tmp_path) -> None:
    found = in_blocks(rough, tmp_path / "out", size=128, plan=96)
    maps = found.solution.maps
    normal, filled = found.layers["normal"], found.layers["filled"][..., 0] > 0.5
    before, after = angles(replace(found.solution, maps=replace(maps, normal=normal, coverage=~filled)), ROLLING, bumpy)
    assert before.mean() > 2.5 and after.mean() < 0.4 * before.mean()
    steps = np.abs(np.diff(normal, axis=1)).mean(axis=(0, 2))
    assert steps[63] < 1.2 * np.median(steps)  # across the border of two blocks


def test_few_lamps_leave_the_normals(rough) -> None:
    few = replace(rough, scene=replace(rough.scene, views=rough.scene.views[:4]))
    solution = shoots.run(few, **QUICK)
    assert solution.normals is None and "few views" in solution.normals_why


@pytest.mark.one_python
def test_bumps_do_not_hide_lamps_that_are_off(rough, refined) -> None:
    """Places 2 % of their distance off: bumps that the mesh lacks cause larger errors."""
    rng = np.random.default_rng(6)
    right = {light.name: light for view in rough.scene.views for light in view.lights}
    off = {name: 0.02 * np.linalg.norm(light.matrix[:3, 3]) * rng.standard_normal(3) / 3**0.5
           for name, light in right.items()}

    def moved(light: Light) -> Light:
        matrix = light.matrix.copy()
        matrix[:3, 3] += off[light.name]
        return replace(light, matrix=matrix)

    wrong = replace(rough, scene=replace(rough.scene, views=tuple(
        replace(view, lights=tuple(map(moved, view.lights))) for view in rough.scene.views)))
    given, found = (shoots.run(wrong, **QUICK, size=96, lamps=word, exposures=word) for word in ("given", "auto"))
    assert given.calibration is None and found.calibration is not None and found.normals is not None
    left = np.array([np.array(lamp.offset) + off[lamp.lights[0]] for lamp in found.calibration.lamps])
    assert np.sqrt((left**2).mean()) < 0.6 * np.sqrt((np.array(list(off.values()))**2).mean())
    before, after, best = (np.mean(shoots.errors(solution, rough.truth).rough) for solution in (given, found, refined))
    assert after - best < 0.3 * (before - best)  # 0.0145 as given, 0.0083, 0.0080 with the right lamps
