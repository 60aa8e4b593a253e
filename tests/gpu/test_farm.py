"""A job run by `openjd run` in four sessions at once, and task by task: the bytes of a single machine's maps.

`python tools/farm_efficiency.py` does the same with more tasks, by 1, 2 and 4 workers.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from irpso_addon.core.data import SceneData
from irpso_addon.core.errors import BadInput
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import farm, tiled_solve
from irpso_addon.solve.plan_preparation import TiledRequest
from tests.support.squares import write_scene

OPENJD = Path(sys.executable).with_name("openjd")
SETTINGS = SolveSettings(size=64, udim="all", model="one-lobe")
BLOCK, HALO = 32, 32  # texels
UDIMS = (1001, 1002)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a space: ``alone`` holds one machine's maps, ``job`` a job of the same without any block."""
    folder = tmp_path_factory.mktemp("a farm")
    scene = write_scene(folder / "scene", cameras=1)
    alone = folder / "alone"
    alone.mkdir()
    thread.run(lambda: tiled_solve.run(
        TiledRequest(scene, SETTINGS, block=BLOCK, halo=HALO), alone, folder / "work", "exr"))
    plan = thread.run(lambda: farm.plan_job(scene, SETTINGS, folder / "job", block=BLOCK, halo=HALO))
    farm.write_job(plan, folder / "job", 2 * BLOCK, "exr", None)
    shutil.rmtree(folder / "scene")  # workers have the job's folder alone
    return folder


def start(job: Path, step: str, tasks: list[dict[str, int]]) -> subprocess.Popen[str]:
    """A session of `openjd run`, as a worker opens one."""
    return subprocess.Popen(
        [OPENJD, "run", str(job / farm.TEMPLATE), "--step", step, "--no-run-dependencies", "--tasks",
         json.dumps(tasks), "-p", f"Python={sys.executable}"],
        env=os.environ | {"LP_NUM_THREADS": "0"}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def finish(session: subprocess.Popen[str]) -> str:
    said = session.communicate(timeout=120)[0]
    assert session.returncode == 0, said
    return said


def assert_same(one: Path, other: Path) -> None:
    first, second = ({path.name: path.read_bytes() for path in folder.iterdir()} for folder in (one, other))
    assert len(first) == 2 * 7 and sorted(second) == sorted(first)
    assert [name for name in first if second[name] != first[name]] == []


@pytest.mark.one_python
def test_four_workers_give_the_bytes_of_one_machine(made: Path) -> None:
    """Each task is done by two of them at the same time."""
    job = shutil.copytree(made / "job", made / "elsewhere" / "the job")
    for session in [start(job, "Solve", [{"Udim": udim, "Tile": 0}]) for udim in 2 * UDIMS]:
        assert "openjd_progress: 100" in finish(session)
    finish(start(job, "Merge", [{"Udim": udim} for udim in UDIMS]))
    assert_same(made / "alone", job / farm.MAPS)


def test_any_tiles_in_any_order_give_the_same_bytes(made: Path) -> None:
    job = shutil.copytree(made / "job", made / "again")
    work, maps = job / farm.WORK, job / farm.MAPS

    def solve(udim: int, tile: int, tile_size: int) -> tuple[int, int]:
        return thread.run(lambda: farm.solve_tile(work, udim, tile, tile_size))

    assert solve(1002, 0, 8192) == (4, 4)
    assert [solve(1001, tile, 32) for tile in (3, 1, 2)] == [(1, 1)] * 3
    with pytest.raises(BadInput, match="1001_y00000_x00000"):
        list(farm.merge_square(work, 1001, maps, "exr"))
    assert not list(maps.iterdir())
    block = work / "blocks" / "1002_y00032_x00000.npz"
    block.write_bytes(block.read_bytes()[:-100])
    assert solve(1002, 0, 64) == (1, 4)  # what is damaged is solved again, what is there is not
    assert solve(1001, 0, 32) == (1, 1)
    for udim in UDIMS:
        list(farm.merge_square(work, udim, maps, "exr"))
    assert_same(made / "alone", maps)


@pytest.mark.parametrize("udim, tile", [(1001, 4), (1003, 0)])
def test_a_task_that_is_not_in_the_plan(made: Path, udim: int, tile: int) -> None:
    with pytest.raises(BadInput, match=f"no tile {tile} of 32 texels in UDIM {udim}"):
        thread.run(lambda: farm.solve_tile(made / "job" / farm.WORK, udim, tile, 32))


def test_a_job_that_cannot_be_written(made: Path) -> None:
    (made / "file").write_text("not ours")
    with pytest.raises(BadInput, match="cannot write there"):
        thread.run(lambda: farm.plan_job(SceneData("", None, None, ()), SETTINGS, made / "file"))
    assert (made / "file").read_text() == "not ours"


@pytest.mark.parametrize("there", [False, True])
def test_a_job_without_a_plan_leaves_nothing(there: bool, tmp_path: Path) -> None:
    """A picture cannot be read, or somebody presses Ctrl-C: nothing is there to go on from."""
    scene, job = write_scene(tmp_path / "scene", cameras=1), tmp_path / "job"
    if there:
        (job / farm.MAPS).mkdir(parents=True)
    scene.views[1].image.write_bytes(b"no picture")
    with pytest.raises(BadInput, match=scene.views[1].image.name):
        thread.run(lambda: farm.plan_job(scene, SETTINGS, job, block=BLOCK, halo=HALO))
    assert {*tmp_path.rglob("job/**")} == ({job, job / farm.MAPS} if there else set())
