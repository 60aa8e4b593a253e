"""Maps finer than the pictures: what is solved of them, against every texel solved and against the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import Solution
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.job import Progress
from irpso_addon.core.live_maps import Live
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.tiled.work_folder import WorkFolder
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.solve.model_ladder import Ladder
from irpso_addon.solve import gpu_path, pipeline, tiled_solve
from irpso_addon.solve.plan_preparation import TiledRequest
from tests.support import shoots
from tests.support import synthetic as syn
from tests.support.shoots import errors, rig, run

SIZE, PIXELS = 512, 72  # a picture's pixel is six texels wide


@pytest.fixture(scope="module")
def shoot() -> syn.Shoot:
    return syn.shoot(syn.PATCHES, rig(2, 6), (PIXELS, PIXELS), noise=0.01)


def solved_each(shoot: syn.Shoot, stride: int, **settings: object) -> Solution:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gpu_path, "stride_of", lambda pixels, size: stride)
        return run(shoot, size=SIZE, **settings)


@pytest.fixture(scope="module")
def every(shoot: syn.Shoot) -> Solution:
    return solved_each(shoot, 1)


@pytest.fixture(scope="module")
def second(shoot: syn.Shoot) -> Solution:
    return run(shoot, size=SIZE)


@pytest.mark.one_python
def test_maps_are_as_right_as_if_each_was_solved(shoot: syn.Shoot, every: Solution, second: Solution) -> None:
    assert (every.stride, second.stride) == (1, 2)
    off, other = errors(every, shoot.truth), errors(second, shoot.truth)
    assert other.share > off.share - 0.005
    assert second.model == every.model
    assert np.median(other.rough) < 0.95 * np.median(off.rough)
    assert np.quantile(other.rough, 0.9) < np.quantile(off.rough, 0.9)
    assert other.rough.mean() < off.rough.mean() and off.rough.mean() < 0.1
    assert other.base.mean() < 1.01 * off.base.mean()


@pytest.mark.one_python
def test_standard_errors_hold_as_often(shoot: syn.Shoot, every: Solution, second: Solution) -> None:
    """Share of texels whose roughness lies within 1.645 standard errors."""
    at = (np.arange(SIZE) + 0.5) / SIZE
    truth = shoot.truth.roughness(*np.meshgrid(at, at))
    held = []
    for found in (every, second):
        maps = found.maps
        solved = maps.coverage & ~maps.filled
        held.append((np.abs(maps.roughness - truth) < 1.645 * maps.roughness_sigma)[solved].mean())
    assert held[1] > held[0] - 0.05


@pytest.mark.one_python
@pytest.mark.parametrize("model", ["two-lobe", "one-lobe-specular", "lambert"])
def test_all_that_is_solved_for_is_there_everywhere(shoot: syn.Shoot, model: str) -> None:
    found = run(shoot, size=SIZE, model=model, specular="texel")
    assert found.stride == 2
    maps = found.maps
    solved = maps.coverage & ~maps.filled
    assert solved.sum() > 0.97 * maps.coverage.sum()
    for values in (maps.roughness, maps.roughness_sigma, maps.base_sigma, maps.confidence, maps.lobes, maps.specular):
        if values is not None:
            assert np.isfinite(values).all()
    assert (maps.lobes is not None) == (model == "two-lobe")
    assert (maps.specular is not None) == (model == "one-lobe-specular")


@pytest.mark.one_python
def test_the_published_method_solves_each(shoot: syn.Shoot) -> None:
    assert run(shoot, size=SIZE, method="paper", model="one-lobe", iterations=1, particles=4).stride == 1


@pytest.mark.one_python
def test_a_search_may_start_at_the_last_result(shoot: syn.Shoot, second: Solution) -> None:
    again = run(replace(shoot, scene=replace(shoot.scene, start=second)), size=SIZE, start="last")
    assert again.stride == 2
    assert errors(again, shoot.truth).rough.mean() < 1.1 * errors(second, shoot.truth).rough.mean()


def test_looks_show_the_whole_map(shoot: syn.Shoot) -> None:
    shown: list[Live] = []

    def look(step: Progress) -> None:
        if step.look is not None and step.stage == "solve":
            shown.append(step.look())

    thread.run(lambda: _looking(pipeline.solve(
        shoot.scene, SolveSettings(size=SIZE, model="one-lobe", **shoots.AS_GIVEN), shoot.read_image), look))
    assert shown and all(values.shape[:2] == (SIZE, SIZE) for live in shown for values in live.maps.values())
    assert np.isfinite(shown[-1].maps["roughness"]).mean() > 0.7


def _looking(steps, look):  # type: ignore[no-untyped-def]
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            return end.value
        look(step)
        yield step


@pytest.mark.one_python
@pytest.mark.parametrize("stage", ["solve", "maps"])
def test_a_stop_keeps_what_was_found(shoot: syn.Shoot, second: Solution, stage: str) -> None:
    settings = SolveSettings(size=SIZE, model="one-lobe", **shoots.AS_GIVEN)
    found = thread.run(lambda: shoots.stopped(
        pipeline.solve(shoot.scene, settings, shoot.read_image), stage, 5))
    assert isinstance(found, Solution) and found.cancelled and found.stride == 2
    maps = found.maps
    solved = maps.coverage & ~maps.filled
    assert 0 < solved.sum() <= (second.maps.coverage & ~second.maps.filled).sum()
    assert np.isfinite(maps.roughness).all() and np.isfinite(maps.base_color).all()
    assert (maps.confidence[~solved] == 0).all()


@pytest.mark.one_python
def test_blocks_solve_the_same_texels(shoot: syn.Shoot, second: Solution, tmp_path: Path) -> None:
    """The plan says which; and no border of blocks shows in what the blocks found."""
    views = []
    for view in shoot.scene.views:
        write_image(tmp_path / view.image.name, shoot.images[view.image.name].rgb, kind="exr", color=True)
        views.append(replace(view, image=tmp_path / view.image.name))
    scene = replace(shoot.scene, views=tuple(views))
    settings = SolveSettings(size=SIZE, model="one-lobe", registration="given", indirect="off", lamps="given",
                             exposures="given", normals="mesh")
    work = tmp_path / "work"
    sizes: list[tuple[int, ...]] = []
    make = Ladder.__init__

    def noted(self, device, source, *more, **named):  # type: ignore[no-untyped-def]
        sizes.append(source.size)
        make(self, device, source, *more, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Ladder, "__init__", noted)
        found = thread.run(lambda: tiled_solve.run(TiledRequest(scene, settings, block=256), tmp_path, work, "exr"))
    assert found.stride == 2
    assert sizes[1:] == [(160, 160)] * 4  # of blocks of 256 texels with a halo of 32
    rough = np.zeros((SIZE, SIZE), np.float32)
    with WorkFolder(work) as place:
        for window in place.read_plan().blocks:
            rough[window.y:window.y + 256, window.x:window.x + 256] = place.read_block(window.key)["roughness"]
    at = (np.arange(SIZE) + 0.5) / SIZE
    off = np.abs(rough - shoot.truth.roughness(*np.meshgrid(at, at)))
    solved = second.maps.coverage & ~second.maps.filled
    whole = np.abs(second.maps.roughness - shoot.truth.roughness(*np.meshgrid(at, at)))
    assert off[solved].mean() < 1.1 * whole[solved].mean()
