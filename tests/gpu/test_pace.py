"""Draws in pieces: none takes long, all are drawn, and the results are the same to the last bit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import Solution
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import draw_budget, thread
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.device.draw_budget import DrawBudget, rectangles
from irpso_addon.gpu.gbuffer import triangles
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer, Occluders
from irpso_addon.gpu.observe.observation_atlas import ObservationAtlas
from irpso_addon.gpu.observe.shadow_sheet import draw_sheet
from irpso_addon.gpu.observe.visibility import LightVisibility, parallel_frustum
from irpso_addon.solve import pipeline
from tests.support import shoots
from tests.support import synthetic as syn
from tests.support.texels import exact

SIZE = 48


class Machine:
    """A device whose draws cost what a test says, on a clock of its own, which moves when somebody waits."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, slice_ms: float = 15.0) -> None:
        self.now = self.queued = self.waited = 0.0
        self.longest = 0.0  # seconds that went by between two waits
        monkeypatch.setattr(draw_budget.time, "perf_counter", lambda: self.now)
        self.budget = DrawBudget(self.wait, slice_ms)

    def wait(self) -> None:
        self.longest = max(self.longest, self.queued)
        self.now += self.queued + 2e-5
        self.queued = 0.0
        self.waited += 1

    def draw(self, work: np.ndarray, seconds: float, key: str = "draw") -> None:
        """Rows of ``work``, each unit of which takes so many seconds."""
        region = (0, 0, 64, len(work))
        for (_, y, width, rows), units in rectangles(region, lambda: self.budget.most(key), work):
            with self.budget.piece(key, units):
                self.queued += float(work[y:y + rows].sum()) * width / 64 * seconds


@pytest.mark.parametrize("seconds", [1e-9, 1e-7, 1e-6, 2e-5])
def test_pieces_take_about_a_slice_on_any_machine(monkeypatch, seconds):
    machine = Machine(monkeypatch)
    machine.draw(np.full(4096, 4096.0, np.float32), seconds)
    whole = seconds * 4096**2
    assert machine.longest < 0.03
    assert machine.waited < 20 + whole / 0.005  # neither is it waited for all the time


def test_cheap_draws_are_hardly_waited_for(monkeypatch):
    """Sixty of 0.1 ms each, as an iteration makes: a few waits, not one for each; but no queue of seconds either."""
    machine = Machine(monkeypatch)
    for _ in range(1000):
        machine.draw(np.full(64, 64.0, np.float32), 2.5e-8)
    assert machine.longest < 0.03
    assert machine.waited < 30


def test_dear_rows_after_cheap_ones_are_known_by_their_work(monkeypatch):
    """A map's lower half that no camera sees tells nothing of its upper half."""
    machine = Machine(monkeypatch)
    work = np.concatenate([np.full(2048, 512.0), np.full(2048, 512.0 * 60)]).astype(np.float32)
    machine.draw(work, 1e-6)
    assert machine.longest < 0.03


def test_what_a_driver_compiles_at_first_is_not_taken_for_the_draw(monkeypatch):
    machine = Machine(monkeypatch)
    machine.queued = 15.0  # shaders of a large kernel, on Mesa
    work = np.full(1024, 1024.0, np.float32)
    machine.draw(work, 1e-7)
    assert machine.waited < 30
    assert machine.budget.most("draw") == pytest.approx(0.015 / 1e-7, rel=0.1)


def test_a_machine_that_slows_down_is_noticed(monkeypatch):
    machine = Machine(monkeypatch)
    machine.draw(np.full(1024, 1024.0, np.float32), 1e-8)
    before = machine.longest
    for factor in (3, 9, 27, 81):
        machine.draw(np.full(1024, 1024.0, np.float32), factor * 1e-8)
    assert before < 0.03
    assert machine.longest < 0.06


@pytest.mark.parametrize("most", [1.0, 7.0, 50.0, 64.0, 200.0, math.inf])
@pytest.mark.parametrize("work", [None, np.array([0, 0, 30, 1, 900, 2, 0], np.float32)])
def test_rectangles_cover_a_region_once(most, work):
    region = (3, 5, 11, 7)
    drawn = np.zeros((20, 20), int)
    units = 0.0
    for (x, y, w, h), part in rectangles(region, lambda: most, work):
        assert min(w, h) >= 1
        assert h == 1 or part <= most
        drawn[y:y + h, x:x + w] += 1
        units += part
    expected = np.zeros((20, 20), int)
    expected[5:12, 3:14] = 1
    assert (drawn == expected).all()
    assert units == pytest.approx(77 if work is None else work.sum())


class Counted(DrawBudget):
    """Divides nothing."""

    pieces = 0

    def piece(self, key: Any, units: float) -> Any:
        self.pieces += 1
        return super().piece(key, units)


class Cut(Counted):
    """Cuts every draw into pieces that end anywhere."""

    def most(self, key: Any, first: float = 0.0) -> float:
        width, height = key[-1]
        return float(width * height / 7.3)


def maps_of(solution: Solution) -> list[np.ndarray]:
    found = [getattr(solution.maps, f.name) for f in fields(solution.maps)]
    return [a for a in found if a is not None] + [p.predicted for p in solution.pictures]


@pytest.fixture
def divided(on_gl: Any, monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], Any]], list[Any]]:
    """divided(solve) -> what it gives with nothing divided, and with everything cut as small as it goes."""
    device: Device = on_gl(lambda device: device)

    def call(solve: Callable[[], Any]) -> list[Any]:
        results, drawn = [], []
        for kind, bundle in ((Counted, 10**9), (Cut, 300)):
            monkeypatch.setattr(triangles, "BUNDLE", bundle)
            monkeypatch.setattr(device, "budget", kind(device._finish, math.inf))
            results.append(solve())
            drawn.append(device.budget.pieces)  # type: ignore[attr-defined]
        assert drawn[1] > 5 * drawn[0]  # else it would compare a path with itself
        return results

    return call


def test_maps_do_not_depend_on_how_draws_are_divided(divided):
    """Noise and two materials: every kernel, neighbours too; meshes, shadows of an area light, base colour, checks."""
    shoot = syn.shoot(syn.PATCHES, shoots.rig(2, 2, kind="AREA", size=(0.4, 0.4)), (40, 40), noise=0.01)
    scene = replace(shoot.scene, occluders=np.asarray(syn.box((0.3, 0.3, 0.2), (0.5, 0.5, 0.4)), np.float32))

    def solve() -> Solution:
        solution: Solution = thread.run(lambda: pipeline.solve(
            scene, SolveSettings(size=SIZE, method="draft", model="one-lobe"), shoot.read_image))
        return solution

    whole, cut = divided(solve)
    assert len(maps_of(whole)) > 7
    for a, b in zip(maps_of(whole), maps_of(cut), strict=True):
        assert a.tobytes() == b.tobytes()


def test_a_map_of_a_sheet_is_one_that_is_drawn_alone(on_gl, divided):
    """Beside others, which its triangles do not reach; divided too."""
    side, ways = 32, np.random.default_rng(3).standard_normal((11, 3))
    box = np.asarray(syn.box((0.3, 0.3, 0.2), (0.5, 0.5, 0.4)), np.float32)

    def sheet() -> tuple[np.ndarray, list[np.ndarray]]:
        def draw(device):
            with device.scope():
                visibility = LightVisibility(device, MeshBuffer(device, syn.plane_mesh()), Occluders(device, box), side)
                frusta = [parallel_frustum(way, visibility.center, visibility.radius, visibility.bounds, side)
                          for way in ways]
                drawn, alone = draw_sheet(device, visibility, frusta, side), []
                for frustum in frusta:
                    visibility._draw_shadow(frustum)
                    alone.append(device.read(visibility._map)[..., 0])
                return np.frombuffer(drawn.read(alignment=1), np.float16).reshape(drawn.height, drawn.width), alone

        return on_gl(draw)

    (whole, alone), (cut, _) = divided(sheet)
    assert whole.tobytes() == cut.tobytes()
    most = np.finfo(np.float16).max  # what is far is beyond a half: drivers make it the largest, or infinite
    for n, depth in enumerate(alone):
        row, column = divmod(n, 8)
        found = whole[row * side:(row + 1) * side, column * side:(column + 1) * side]
        np.testing.assert_allclose(np.minimum(found, most), np.minimum(depth, most), rtol=2**-10)  # of a half
        assert (found < 10).any() and (found >= most).any()
    assert (whole[2 * side:] >= most).all()


def test_work_counts_the_observations_of_rows(on_gl):
    texels = exact(views=8)[1]
    texels = replace(texels, quality=np.where(np.arange(texels.quality.shape[0])[:, None, None] < 16, 0.0,
                                              texels.quality).astype(np.float32))

    def job(device: Device) -> np.ndarray:
        source = texels.source(device)
        atlas = ObservationAtlas(device, source)
        for _ in source.gather(atlas, (0, 0), False):
            pass
        work = atlas.work()
        atlas.release()
        source.release()
        return work

    width = texels.quality.shape[1]
    seen = (texels.quality > 0).sum(axis=(1, 2))
    assert on_gl(job) == pytest.approx(width + seen, rel=0.1)  # it looks at one texel in sixteen
