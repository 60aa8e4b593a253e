"""Large solves against the same solved in one piece, and against the truth: errors, borders of blocks, models, memory.

Kills and bytes: studies/resilience; tasks of farms: test_farm.py; several UDIMs in Blender: tests/blender.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.checks.bounced_light import BouncedSample
from irpso_addon.core.data import Bounced, Camera, Light, SceneData, Solution
from irpso_addon.core.errors import BadInput, StoppedWithWork
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.maps.export import layers
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.core.tiled import uv_blocks
from irpso_addon.core.tiled.uv_blocks import Crop
from irpso_addon.core.tiled.work_folder import WorkFolder
from irpso_addon.gpu.device import thread
from irpso_addon.solve import block_solve, pipeline, tiled_solve
from irpso_addon.solve.plan_preparation import TiledRequest, prepare
from tests.support import synthetic as syn
from tests.support.shoots import AS_GIVEN, rig

SIZE, BLOCK = 128, 64  # texels
PIXELS = 72
NOISE = 0.01
WAVES = syn.Truth(
    base=lambda u, v: np.stack([0.5 + 0.3 * np.sin(9 * u), 0.4 + 0.2 * np.cos(7 * v), 0.3 + 0.1 * np.sin(5 * (u + v))],
                               -1),
    roughness=lambda u, v: 0.4 + 0.1 * np.sin(6 * u) * np.cos(5 * v))
Found = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SceneData:
    """A plane whose material changes smoothly, its noisy pictures in files."""
    folder = tmp_path_factory.mktemp("pictures")
    return in_files(WAVES, [(camera, [lamp]) for camera in syn.cameras(2) for lamp in syn.lamps(6)], folder)


def in_files(truth: syn.Truth, rig: list[tuple[Camera, list[Light]]], folder: Path) -> SceneData:
    """A scene whose pictures are files in a folder."""
    shoot = syn.shoot(truth, rig, (PIXELS, PIXELS), noise=NOISE)
    views = []
    for view in shoot.scene.views:
        write_image(folder / view.image.name, shoot.images[view.image.name].rgb, kind="exr", color=True)
        views.append(replace(view, image=folder / view.image.name))
    return replace(shoot.scene, views=tuple(views))


def settings(**chosen: Any) -> SolveSettings:
    return SolveSettings(**{"size": SIZE, "model": "one-lobe", "registration": "given", "indirect": "off", **chosen})


def solve(scene: SceneData, folder: Path, **chosen: Any) -> Found:
    """The maps of a large solve, and what its plan holds under "plan"."""
    work = folder / "work"
    folder.mkdir(exist_ok=True)
    solution = thread.run(lambda: tiled_solve.run(
        TiledRequest(scene, settings(**chosen), block=BLOCK), folder, work, "exr"))
    return {**maps_of(work), "warnings": solution.warnings}


def maps_of(work: Path) -> Found:
    """The layers of a finished solve, put together from its blocks."""
    with WorkFolder(work) as place:
        plan = place.read_plan()
        found: Found = {"plan": plan}
        for name in block_solve.layers_of(plan):
            first = place.read_block(plan.blocks[0].key)[name]
            whole = np.zeros((plan.settings.size,) * 2 + first.shape[2:], np.float32)
            for window in plan.blocks:
                height, width = window.shape
                whole[window.y:window.y + height, window.x:window.x + width] = place.read_block(window.key)[name]
            found[name] = whole
    return found


@pytest.fixture(scope="module")
def one_piece(scene: SceneData) -> Found:
    maps = thread.run(lambda: pipeline.solve(scene, settings())).maps
    return {**layers(maps), "coverage": maps.coverage}


@pytest.fixture(scope="module")
def blocks(scene: SceneData, tmp_path_factory: pytest.TempPathFactory) -> Found:
    return solve(scene, tmp_path_factory.mktemp("blocks") / "out")


def off(found: Found, where: np.ndarray) -> tuple[float, float]:
    """Mean absolute errors of base colour and roughness."""
    at = (np.arange(SIZE) + 0.5) / SIZE
    u, v = np.meshgrid(at, at)
    return (float(np.abs(found["basecolor"] - WAVES.base(u, v))[where].mean()),
            float(np.abs(found["roughness"] - WAVES.roughness(u, v))[where].mean()))


@pytest.mark.one_python
def test_the_plan_of_small_maps_is_their_solve_in_one_piece(blocks: Found, one_piece: Found) -> None:
    """To the bit, so that tests below need not solve them once more to have them."""
    planned = layers(blocks["plan"].solution.maps)
    assert planned.keys() == one_piece.keys() - {"coverage"}
    assert [name for name, layer in planned.items() if not np.array_equal(layer, one_piece[name])] == []


@pytest.mark.one_python
def test_blocks_are_as_right_as_one_piece(blocks: Found, one_piece: Found) -> None:
    solved = (blocks["filled"] < 0.5) & (one_piece["filled"] < 0.5)
    assert solved.sum() > 0.98 * one_piece["coverage"].sum()
    base, rough = off(blocks, solved)
    whole_base, whole_rough = off(one_piece, solved)
    assert base < 1.05 * whole_base and rough < 1.1 * whole_rough
    assert whole_rough < 0.05 and whole_base < 0.02  # else nothing would be compared
    apart = np.abs(blocks["basecolor"] - one_piece["basecolor"])[solved].mean()
    assert apart < 0.1 * whole_base


@pytest.mark.one_python
@pytest.mark.parametrize("name", ["basecolor", "roughness", "confidence"])
def test_no_border_of_blocks_shows(blocks: Found, one_piece: Found, name: str) -> None:
    """Steps from texel to texel across the border beside the same steps of one piece, which has no border there."""
    solved = (blocks["filled"] < 0.5) & (one_piece["filled"] < 0.5)

    def steps(found: Found) -> float:
        across = [np.abs(np.diff(found[name], axis=axis)).reshape(*np.diff(solved, axis=axis).shape, -1).mean(-1)
                  for axis in (0, 1)]
        both = [solved[1:] & solved[:-1], solved[:, 1:] & solved[:, :-1]]
        rows, columns = across[0][BLOCK - 1][both[0][BLOCK - 1]], across[1][:, BLOCK - 1][both[1][:, BLOCK - 1]]
        return float(np.concatenate([rows, columns]).mean())

    assert steps(blocks) < 1.15 * steps(one_piece) + 1e-4


@pytest.mark.one_python
def test_holes_beyond_a_block_are_filled_from_the_plan(blocks: Found, one_piece: Found) -> None:
    outside = ~one_piece["coverage"]
    apart = np.abs(blocks["basecolor"] - one_piece["basecolor"])[outside]
    assert np.quantile(apart, 0.99) < 0.05 and (blocks["confidence"][outside] == 0).all()


@pytest.mark.one_python
def test_a_block_has_the_plans_specular_level(scene: SceneData, tmp_path: Path) -> None:
    found = solve(scene, tmp_path / "out", model="one-lobe-specular", size=96)
    level = found["plan"].solution.levels["Paint"]
    solved = found["filled"] < 0.5
    np.testing.assert_allclose(found["specular"][solved], level, atol=1e-6)
    assert abs(level - 0.5) < 0.1  # the truth


@pytest.mark.one_python
def test_blocks_find_the_levels_of_their_texels(tmp_path: Path) -> None:
    scene = in_files(syn.VARIED, rig(1, 16), tmp_path)
    found = solve(scene, tmp_path / "out", model="auto", **AS_GIVEN)
    plan, solved = found["plan"].solution, found["filled"] < 0.5
    assert plan.priors["Paint"].level_strength > 0 and plan.levels == {}
    off = np.abs(np.log(found["specular"] / syn.levels_of_varied(SIZE)))
    assert np.median(off[solved]) < 0.05
    whole = plan.maps  # see test_the_plan_of_small_maps_is_their_solve_in_one_piece
    apart = np.abs(found["specular"] - whole.specular)[solved]
    assert np.quantile(apart, 0.999) < 1e-3 and apart.max() < 0.05


@pytest.mark.one_python
def test_blocks_have_the_plans_metallic_on_their_metal_alone(tmp_path: Path) -> None:
    """Metal and paint in one material, whose border crosses the blocks'."""

    def is_metal(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.asarray(np.sin(7 * u + 2) + np.sin(6 * v) > 0.3)

    def reflect(base: np.ndarray, rough: np.ndarray, *vectors: np.ndarray) -> np.ndarray:
        return brdf.principled(base, rough, *vectors, metallic=np.where(rough < 0.4, 1.0, 0.0))

    truth = syn.Truth(lambda u, v: np.where(is_metal(u, v)[..., None], (0.9, 0.7, 0.4), (0.2, 0.4, 0.5)),
                      lambda u, v: np.where(is_metal(u, v), 0.3, 0.5), reflect=reflect)
    scene = in_files(truth, rig(1, 12), tmp_path)
    found = solve(scene, tmp_path / "out", model="auto", **AS_GIVEN)
    plan, solved = found["plan"].solution, found["filled"] < 0.5
    assert plan.paint["Paint"] == pytest.approx(0.5, abs=0.2) and plan.maps.metallic is not None
    assert set(np.unique(found["metallic"])) == {0.0, np.float32(plan.metallic["Paint"])}
    metal = is_metal(*np.meshgrid(*2 * [(np.arange(SIZE) + 0.5) / SIZE]))
    assert np.mean(((found["metallic"] > 0) == metal)[solved]) > 0.98
    whole = plan.maps  # see test_the_plan_of_small_maps_is_their_solve_in_one_piece
    assert np.mean((found["metallic"] == whole.metallic)[solved]) > 0.995
    rough = np.abs(found["roughness"] - np.where(metal, 0.3, 0.5))
    sure = found["confidence"] > 0.5
    assert sure.mean() > 0.35 and np.mean(rough[sure] > 0.1) < 0.005  # from 12 views, 0.41
    assert np.median(rough[metal & solved]) < 0.01 and np.median(rough[~metal & solved]) < 0.02


@pytest.mark.one_python
def test_blocks_have_the_plans_diffuse_roughness(tmp_path: Path) -> None:
    truth = replace(WAVES, reflect=partial(brdf.principled, diffuse_roughness=0.7))
    scene = in_files(truth, rig(1, 16), tmp_path)
    found = solve(scene, tmp_path / "out", model="auto", **AS_GIVEN)
    solved = found["filled"] < 0.5
    assert found["plan"].solution.diffuse_roughness == {"Paint": pytest.approx(0.7, abs=0.03)}
    base, rough = off(found, solved)
    assert base < 0.01 and rough < 0.05  # from pictures of 72 pixels
    whole = found["plan"].solution.maps  # see test_the_plan_of_small_maps_is_their_solve_in_one_piece
    assert np.quantile(np.abs(found["basecolor"] - whole.base_color)[solved], 0.99) < 0.01
    assert np.quantile(np.abs(found["roughness"] - whole.roughness)[solved], 0.99) < 0.01


def test_little_memory_shrinks_the_pictures(
    scene: SceneData, blocks: Found, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    crops: list[Crop] = []
    window = block_solve._window
    monkeypatch.setattr(block_solve, "_window", lambda picture, crop, *more: crops.append(crop) or window(
        picture, crop, *more))
    monkeypatch.setattr(uv_blocks, "PICTURES", 6e-4)
    found = solve(scene, tmp_path / "out")
    assert {crop.shrink for crop in crops} == {2}
    told = "4 of 4 blocks: their pictures are reduced"
    assert any(told in warning for warning in found["warnings"])
    assert not any(told[4:] in warning for warning in blocks["warnings"])
    solved = (found["filled"] < 0.5) & (blocks["filled"] < 0.5)
    assert solved.sum() > 0.9 * (blocks["filled"] < 0.5).sum()
    assert off(blocks, solved)[0] < 0.0017 and off(found, solved)[0] < 0.0084  # measured: 0.0016, 0.0083


def test_a_stop_keeps_finished_blocks(scene: SceneData, blocks: Found, tmp_path: Path) -> None:
    """Stopped within a block, it is solved again, and the maps are the same."""
    out, seen = tmp_path / "out", []
    out.mkdir()

    def stop() -> bool:
        return bool(seen) and seen[-1].block == (3, 4) and seen[-1].stage == "solve"

    with pytest.raises(StoppedWithWork) as stopped:
        thread.run(lambda: tiled_solve.run(TiledRequest(scene, settings(), block=BLOCK), out, out / "work", "exr"),
                   on_progress=seen.append, should_stop=stop)
    assert (stopped.value.folder, stopped.value.blocks) == (out / "work", 2)
    assert not list(out.glob("*.exr"))
    again = thread.run(lambda: tiled_solve.run(TiledRequest(scene, settings(), block=BLOCK), out, out / "work", "exr"))
    assert again.resumed_blocks == 2
    assert again.texels["solved"] == int((blocks["filled"] < 0.5).sum())
    found = maps_of(out / "work")
    names = block_solve.layers_of(found["plan"])
    assert names == block_solve.layers_of(blocks["plan"]) and "roughness" in names
    assert [name for name in names if found[name].tobytes() != blocks[name].tobytes()] == []


def test_pictures_by_another_path_are_the_same(scene: SceneData, tmp_path: Path) -> None:
    """The same command goes on with the work that is there, from whatever folder its relative paths lead."""
    begun, pictures = set(), scene.views[0].image.parent
    for folder in (pictures, pictures / ".." / pictures.name):
        views = tuple(replace(view, image=folder / view.image.name) for view in scene.views)
        request = TiledRequest(replace(scene, views=views), settings(), block=BLOCK)
        with WorkFolder(tmp_path / "work") as work:
            thread.run(lambda request=request, work=work: prepare(request, work))
            begun.add(work.fingerprint())
    assert len(begun) == 1


def in_two_squares(folder: Path, filled: float) -> SceneData:
    """A box throws shadows on the plane, which lies in two UDIM squares; ``filled``: light in them, as a share."""
    shoot = syn.shoot(syn.PATCHES, rig(), (96, 96), blocks=[((-0.35, -0.35, 0.25), (0.35, 0.35, 0.6))])
    level = np.median([np.median(image.rgb[image.coverage > 0.5]) for image in shoot.images.values()])
    for name, image in shoot.images.items():
        write_image(folder / name, (image.rgb + filled * level).astype(np.float32), kind="exr", color=True)
    mesh = replace(shoot.scene.mesh, uvs=shoot.scene.mesh.uvs * np.array([2, 1], np.float32))
    views = tuple(replace(view, image=folder / view.image.name) for view in shoot.scene.views)
    return replace(shoot.scene, mesh=mesh, views=views)


@pytest.mark.parametrize(("filled", "indirect", "rendered"), [
    (0.0, "auto", 0), pytest.param(0.05, "auto", 1, marks=pytest.mark.one_python), (0.0, "on", 1)])
def test_indirect_light_of_several_squares(filled: float, indirect: str, rendered: int, tmp_path: Path) -> None:
    """It is rendered from the plan's maps where shadows show some, or where it is asked for, as of one square."""
    asked: list[int] = []

    class Dark:
        """Finds no light that bounces."""

        direct_only = False

        def sample(self, scene: SceneData, solution: Solution) -> Any:
            yield from ()
            return BouncedSample(1.0, filled)

        def __call__(self, scene: SceneData, solution: Solution) -> Any:
            assert scene.mesh.extent == 2 and len(solution.maps.roughness) == 128
            asked.append(len(scene.views))
            yield from ()
            nothing = np.zeros((8, 8, 3), np.float32)
            return dict.fromkeys(range(len(scene.views)), Bounced(nothing, nothing))

    request = TiledRequest(in_two_squares(tmp_path, filled), settings(
        udim="all", size=64, indirect=indirect, lamps="given", exposures="given"), Dark())
    with WorkFolder(tmp_path / "work") as work:
        plan = thread.run(lambda: prepare(request, work))
    assert bool(asked) == bool(rendered)
    assert (plan.bounced is not None) == bool(rendered) or filled


def test_a_part_or_the_last_result_is_refused(scene: SceneData, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="solved whole and from scratch"):
        thread.run(lambda: tiled_solve.run(
            TiledRequest(scene, settings(start="last")), tmp_path, tmp_path / "work", "exr"))
