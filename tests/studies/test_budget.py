"""The budget of a command: its seconds add up, every part is there, and the page names them; and its small form."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.job import Progress, Steps, run_to_end
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.reporting.estimates import Estimate
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.device.draw_budget import DrawBudget
from irpso_addon.gpu.device.memory import DeviceMemory
from irpso_addon.gpu.gbuffer import texel_grid
from irpso_addon.solve import one_round, pipeline
from studies.budget import instrument, page
from studies.budget.instrument import DEVICE, OF_COMMANDS, PARTS, instrumented, of_command
from studies.budget.ledger import COMPILE, GPU, NOTHING, PYTHON, UPLOAD, Ledger
from studies.budget.needs import Need, evaluations, needs
from studies.budget.scenes import dome
from tests.support import synthetic as syn
from tests.support.shoots import rig

SIZE, PIXELS = 48, 40
TOLERANCE = 0.01  # of the seconds
RATE = {"multiply-add": 1e9, "divide": 1e9, "square root": 1e9, "fetch": 1e9, "bytes": 1e9}
RARE = {"indirect light", "normals", "polish"}  # parts that a tiny solve need not have on the GPU, or at all


@pytest.fixture(scope="module")
def solved() -> tuple[Ledger, float]:
    """A tiny solve with its ledger, and its seconds by another clock."""
    shoot, ledger = syn.shoot(syn.PATCHES, rig(2, 8), (PIXELS, PIXELS), noise=0.01), Ledger()
    settings = SolveSettings(size=SIZE, indirect="off")
    with instrumented(ledger):
        start = time.perf_counter()
        with ledger.lane():
            thread.run(lambda: pipeline.solve(shoot.scene, settings, shoot.read_image))
        wall = time.perf_counter() - start
    return ledger, wall


def test_the_seconds_add_up(solved: tuple[Ledger, float]) -> None:
    """Each second is in exactly one row, and few in none."""
    ledger, wall = solved
    assert sum(ledger.seconds.values()) == pytest.approx(wall, rel=TOLERANCE)
    assert all(seconds >= 0 for (part, _), seconds in ledger.seconds.items() if part != NOTHING)
    unattributed = sum(seconds for (part, kind), seconds in ledger.seconds.items()
                       if page.row_of(part, kind) == NOTHING)
    assert abs(unattributed) < 0.1 * wall


def test_every_part_and_row_is_known(solved: tuple[Ledger, float]) -> None:
    ledger, _ = solved
    rows = {page.row_of(part, kind) for part, kind in ledger.seconds}
    assert rows <= set(page.ROWS)
    assert {part for part, _ in ledger.seconds} >= set(PARTS) - RARE - {DEVICE, "fill"}
    assert {part for part, kind in ledger.seconds if kind == GPU} >= {
        "G-buffer", "visibility", "observations", "gathering to texels", "search", "tables", "trials of models",
        "back-projection", "checks"}
    grouped = [row for group, _ in page.GROUPS.values() for row in group]
    assert sorted(grouped) == sorted(page.ROWS), "a row is in no group of the chart, or in two"


def test_bytes_are_those_of_the_arrays(solved: tuple[Ledger, float]) -> None:
    ledger, _ = solved
    pictures = 16 * PIXELS**2 * 16  # sixteen views of four float32
    assert ledger.bytes["uploaded"] > pictures
    assert ledger.bytes["read back"] > 10 * 16 * SIZE**2
    assert ledger.bytes["device"] > pictures + 8 * 16 * SIZE**2  # the tables


def test_nothing_stays_wrapped(solved: tuple[Ledger, float]) -> None:
    for function in (DrawBudget.piece, DeviceMemory.texture, thread.run, thread.Job._run, texel_grid.draw_texels,
                     one_round._checks):
        assert "studies" not in (function.__module__ or "") and not function.__code__.co_filename.endswith(
            "budget/instrument.py")


def test_work_is_counted(solved: tuple[Ledger, float]) -> None:
    """The search of all texels once: as many as the mesh covers, each seen in at most sixteen views."""
    work = solved[0].work["solve/search.kernel 1"]
    assert work["texels"] == pytest.approx(0.81 * SIZE**2, rel=0.05)  # the plane's island
    assert 8 < work["observations"] / work["texels"] <= 16
    assert work["layers"] == 16 and work["groups"] == 2


class Clock:
    """Goes on when it is told to."""

    now = 0.0

    def __call__(self) -> float:
        return self.now

    def wait(self, seconds: float) -> None:
        self.now += seconds


def test_time_is_the_innermost_part_s() -> None:
    """Parts within parts, steps of generators, kinds, and what sticks."""
    clock = Clock()
    ledger = Ledger(clock)

    def steps() -> Any:
        clock.wait(2)
        yield 1
        clock.wait(2)
        return 5

    def drive() -> Any:
        work = ledger.steps("G-buffer", steps())
        next(work)
        clock.wait(3)  # between two steps: the caller's
        with pytest.raises(StopIteration) as end:
            next(work)
        return end.value.value

    with ledger.lane():
        clock.wait(7)
        with ledger.within("search"):
            assert drive() == 5
            with ledger.within(kind=UPLOAD):
                clock.wait(1)
        with ledger.within("checks"), ledger.within("search"):
            clock.wait(8)
        with ledger.within("trials of models"), ledger.within("tables"), ledger.piece("a.kernel", 10, False):
            clock.wait(16)
        with ledger.within("fill"), ledger.piece("b.frag", 10, True):
            clock.wait(32)
    assert {entry: seconds for entry, seconds in ledger.seconds.items() if seconds} == {
        (NOTHING, PYTHON): 7, ("G-buffer", PYTHON): 4, ("search", PYTHON): 3, ("search", UPLOAD): 1,
        ("checks", PYTHON): 8, ("trials of models", GPU): 16, ("fill", COMPILE): 32}
    assert {entry: (of.seconds, of.units) for entry, of in ledger.shaders.items()} == {
        ("trials of models", "a.kernel"): (16, 10)}


def test_a_step_that_raises_ends_its_part() -> None:
    """And what a stop throws into a generator reaches it."""
    clock = Clock()
    ledger = Ledger(clock)

    def steps() -> Any:
        try:
            yield 1
        except KeyError:
            clock.wait(1)
            raise ValueError from None

    with ledger.lane():
        work = ledger.steps("fill", steps())
        next(work)
        with pytest.raises(ValueError):
            work.throw(KeyError())
        clock.wait(2)
    assert ledger.seconds["fill", PYTHON] == 1 and ledger.seconds[NOTHING, PYTHON] == 2


def test_parts_of_commands_exist() -> None:
    """The command's own functions are found, with Blender and without."""
    pytest.importorskip("bpy")
    from irpso_addon.blender.oiio import ensure_openimageio

    ensure_openimageio()
    for blender in (True, False):
        with instrumented(Ledger(), of_command(blender)):
            pass
    assert all(name.startswith(("core.", "solve.")) for names in of_command(False).values() for name in names)


def test_the_estimate_of_a_command_is_noted() -> None:
    """It is a job, because it opens all pictures."""
    found = Estimate(1.0, 5, 6, 7, False)

    def expected(views: int) -> Steps[Estimate]:
        yield Progress(0.0, "headers", f"0 of {views}")
        return found

    ledger = Ledger()
    seen: list[Progress] = []
    assert run_to_end(instrument._kept(ledger, expected)(3), seen.append) is found
    assert ledger.facts["estimated"] == 5 and [step.message for step in seen] == ["0 of 3"]


def test_needs_by_hand() -> None:
    """A search that is counted with a pencil."""
    work = {"texels": 100.0, "observations": 500.0, "layers": 10.0, "lights": 1.0, "outputs": 3.0, "u_particles": 6.0,
            "u_moves": 0.0, "u_race_steps": 2.0, "u_final_steps": 6.0}
    assert evaluations("solve/search.kernel", work) == 6 * 3 + 2 * 6 + 1
    record = {"work": {"solve/search.kernel 1": work},
              "shaders": [["search", "solve/search.kernel", 0.001, 1, 600.0],
                          ["back-projection", "maps/albedo_update.frag", 0.002, 1, 1000.0]]}
    search, back = needs(record, RATE)
    assert search.operations == 31 * (500 * 41 + 100 * 131)
    assert search.bytes == 16 * (100 * (1 + 10 + 3) + 500)
    assert search.share == pytest.approx(search.operations / 1e9 / 0.001)
    assert search.unskipped == pytest.approx(31 * (1000 * 41 + 100 * 131) / 1e9)
    assert (back.bytes, back.operations) == (48_000, 2000)
    assert needs({**record, "work": {**record["work"], "solve/search.kernel 2": work}}, RATE) == [back]


def test_the_dome_is_convex() -> None:
    axis = np.linspace(0.02, 0.98, 30)
    u, v = (a.ravel() for a in np.meshgrid(axis, axis))
    points = dome(u, v)
    np.testing.assert_allclose((points / (1, 1, 0.7) ** np.ones(3)) ** 2 @ np.ones(3), 1, atol=1e-9)


def test_page(tmp_path: Any, solved: tuple[Ledger, float]) -> None:
    """From a run's record to page and chart; the real page has the same rows and little that is unattributed."""
    pytest.importorskip("matplotlib")
    ledger, wall = solved
    run = page.Run(wall + 0.5, 10.0, {**ledger.record(), "memory": 1e9, "estimated": 2e8})
    assert sum(run.rows.values()) == pytest.approx(run.wall)
    need = Need("search", 1e6, 12, 1e9, 1e8, 0.1, 0.01, 0.2, 0.15)
    plain = replace(run, cpu=8.0, record={})
    case = page.Measured("tiny", "a bumpy plane", replace(run, wall=run.wall + 1), run, plain, [need])
    page.write([case], "renderer", ["Blender 0"], RATE, out=tmp_path / "budget.md")
    text = (tmp_path / "budget.md").read_text(encoding="utf-8")
    for row in (*OF_COMMANDS, "shader compile", "read-back", "making textures, upload", "Python: trials of models",
                "unattributed"):
        assert f"| {row} |" in text
    assert (tmp_path / "budget.png").stat().st_size > 10_000
    assert "| tiny | search | 1.0 | 12.0 | 1.00 | 0.10 | 0.10 | 0.01 | 0.20 | 50 % | 75 % |" in text


def test_small_rows_are_one() -> None:
    """And what they hold is named; the rows add up to the whole."""
    seconds = [["search", GPU, 90.0], ["fill", GPU, 0.2], ["normals", GPU, 0.1], ["checks", PYTHON, 8.0]]
    run = page.Run(100.0, 100.0, {"seconds": seconds})
    lines = page.table([page.Measured("x", "", run, run, run)]).splitlines()
    assert "| GPU: search | 90.00 (90 %) |" in lines and f"| GPU: {page.SMALLER} | 0.30 (0 %) |" in lines
    assert "| start, imports, end | 1.70 (2 %) |" in lines and "| Python: checks | 8.00 (8 %) |" in lines
    assert "| **all** | **100.00** |" in lines
    note = next(line for line in lines if line.startswith(f"GPU: {page.SMALLER}, each: "))
    assert "fill" in note and "normals" in note and "search" not in note


def test_the_page_in_docs_is_complete() -> None:
    """Every row is there or named as small, in order; little is unattributed; each column adds up."""
    text = page.PAGE.read_text(encoding="utf-8").split("<!-- table: begin -->")[1].split("<!-- table: end -->")[0]
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| ")]
    rows, columns = {name: values for name, *values in cells[2:-1]}, cells[-1][1:]
    known = [row for row in rows if page.SMALLER not in row]
    assert known == sorted(known, key=page.ROWS.index)
    small = [f"{line.split(':')[0]}: {part}" for line in text.splitlines() if ", each: " in line
             for part in line.split(", each: ")[1].rstrip(".").split(", ")]
    assert sorted(known + small) == sorted(page.ROWS)
    for n, whole in enumerate(columns):
        seconds = [float(values[n].split(" ")[0]) for values in rows.values()]
        assert sum(seconds) == pytest.approx(float(whole.strip("*")), abs=0.01 * len(seconds))
        assert float(rows[NOTHING][n].split("(")[1].split("%")[0]) < 10
