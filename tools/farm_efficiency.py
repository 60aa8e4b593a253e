"""What a farm gains: measured with workers side by side on this machine, and simulated for hundreds of them.

    python tools/farm_efficiency.py [--page]

Writes docs/farms.json, docs/farms.md and two charts; --page: from docs/farms.json as it is.  The job is the synthetic
plane of tests/gpu over two UDIM squares.  Each worker has one thread of the software rasteriser.  Takes ten minutes;
needs openjd-cli and matplotlib; no Blender.
"""

from __future__ import annotations

import argparse
import filecmp
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon import examine, farm, large  # noqa: E402  # the checkout is no installed package
from irpso_addon.core.params import SolveSettings  # noqa: E402
from irpso_addon.core.work import Work as WorkFolder  # noqa: E402
from irpso_addon.gpu import thread  # noqa: E402
from tests.gpu.squares import write_scene  # noqa: E402
from tools.farm_page import write_page  # noqa: E402
from tools.farm_simulation import Costs  # noqa: E402

DATA = ROOT / "docs" / "farms.json"
UDIMS, SIZE, TILE = (1001, 1002), 1024, 512  # two squares of four tasks
PICTURES, CAMERAS, LAMPS = 1024, 3, 4
WORKERS = (1, 2, 4)
REPEATS = 3
OPENJD = Path(sys.executable).with_name("openjd")
ONE_CORE = os.environ | {"LP_NUM_THREADS": "0", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def main() -> None:
    """Measure, unless --page, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", action="store_true", help="docs/farms.md and its charts from docs/farms.json alone")
    parser.add_argument("--child", nargs=2, metavar=("WHAT", "FOLDER"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        child(arguments.child[0], Path(arguments.child[1]))
        return
    if not arguments.page:
        with tempfile.TemporaryDirectory(prefix="irpso-farm-") as folder:
            found = measure(Path(folder))
        DATA.write_text(json.dumps(found, indent=1) + "\n")
    write_page(json.loads(DATA.read_text()), ROOT / "docs")


def child(what: str, folder: Path) -> None:
    """One process of the measurement: the plan of a job, the whole solve by a single machine, or all tasks of a job."""
    settings = SolveSettings(size=SIZE, udim="all", model="one-lobe")
    if what == "tasks":
        work = folder / "run" / farm.WORK
        for udim in UDIMS:
            thread.run(partial(farm.solve_tile, work, udim, 0, SIZE))
        for udim in UDIMS:
            list(farm.merge_square(work, udim, folder / "run" / farm.MAPS, "exr"))
        return
    scene = write_scene(folder / "scene", CAMERAS, LAMPS, PICTURES)
    started = time.perf_counter()
    if what == "plan":
        plan = thread.run(lambda: farm.plan_job(scene, settings, folder / "job"))
        farm.write_job(plan, folder / "job", TILE, "exr", None)
    else:
        (folder / "alone").mkdir()
        thread.run(lambda: large.run(scene, settings, folder / "alone", folder / "alone_work", "exr"))
    print(json.dumps({"seconds": time.perf_counter() - started, "device": thread.run(examine.detect).renderer}))


def measure(folder: Path) -> dict[str, Any]:
    """Everything that the page says."""
    _child("alone", folder)
    plan = json.loads(_child("plan", folder))
    shutil.copytree(folder / "job", folder / "clean")
    first, blocks, slowness = _task_times(folder)
    alone, workers = [], {count: [] for count in WORKERS}
    for _ in range(REPEATS):  # one after another, so that all meet the same neighbours on a shared machine
        alone.append(_timed(_child, "tasks", _fresh(folder).parent))
        for count in WORKERS:
            workers[count].append(_timed(_farm, _fresh(folder), count))
            if names := _differing(folder / "alone", folder / "run" / farm.MAPS):
                raise SystemExit(f"farm_efficiency: {count} workers: other bytes than one machine: {names}")
    session, dispatch = _openjd_times(folder)
    merge_start, merge = _merge_times(folder)
    costs = Costs(plan["seconds"], session, dispatch, first - median(blocks), tuple(blocks), merge_start, merge,
                  tuple(slowness))
    return {"device": plan["device"], "cores": os.cpu_count(), "date": time.strftime("%Y-%m-%d"),
            "alone_solve": min(alone), "workers": {count: min(seconds) for count, seconds in workers.items()},
            "costs": asdict(costs), "size": SIZE, "tile": TILE, "views": CAMERAS * LAMPS, "pixels": PICTURES}


def _timed(function: Callable[..., object], *arguments: object) -> float:
    started = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - started


def _child(what: str, folder: Path) -> str:
    """A process of its own; the last line that it prints."""
    done = subprocess.run([sys.executable, __file__, "--child", what, str(folder)], env=ONE_CORE, check=True,
                          stdout=subprocess.PIPE, text=True)
    return done.stdout.splitlines()[-1] if done.stdout else ""


def _fresh(folder: Path) -> Path:
    """The job as it was planned, without blocks."""
    shutil.rmtree(folder / "run", ignore_errors=True)
    shutil.copytree(folder / "clean", folder / "run")
    return folder / "run"


def _task_times(folder: Path) -> tuple[float, list[float], list[float]]:
    """Of tasks that solve a whole square: the first block's seconds, start included; the others'; slownesses."""
    firsts, times = [], []
    for _ in range(REPEATS):
        for udim in UDIMS:
            ends = _block_ends(_fresh(folder), udim)
            firsts.append(ends[0])
            times.append([after - before for before, after in pairwise(ends)])
    slowness = []
    for square in (times[0::2], times[1::2]):
        for block in zip(*square, strict=True):
            slowness += [seconds / min(block) for seconds in block]
    return median(firsts), [seconds for row in times for seconds in row], slowness


def _block_ends(job: Path, udim: int) -> list[float]:
    """Seconds from the start of a task's process to the end of each of its blocks."""
    number = len(list(_blocks(job, udim)))
    command = [sys.executable, str(job / farm.PROGRAM), "tile", str(job / farm.WORK), "--udim", str(udim),
               "--tile", "0", "--tile-size", str(SIZE)]
    started = time.perf_counter()
    ends: list[float] = []
    with subprocess.Popen(command, env=ONE_CORE, stdout=subprocess.PIPE, text=True) as task:
        assert task.stdout is not None
        for line in task.stdout:
            name, _, percent = line.partition("openjd_progress: ")
            if not name and int(percent) >= int(100 * (len(ends) + 1) / number):
                ends.append(time.perf_counter() - started)
    if task.returncode or len(ends) != number:
        raise SystemExit("farm_efficiency: a task failed")
    return ends


def _blocks(job: Path, udim: int) -> Sequence[Any]:
    plan = WorkFolder(job / farm.WORK).read_plan()
    assert plan is not None
    return [w for w in plan.windows if w.udim == udim]


def _farm(job: Path, workers: int) -> None:
    """The job's two steps by so many workers: each a session of its own, as a farm opens them."""
    tasks = [{"Udim": udim, "Tile": tile} for udim in UDIMS for tile in range((SIZE // TILE) ** 2)]
    _step(job, "Solve", [tasks[n::workers] for n in range(workers)])
    merges = [{"Udim": udim} for udim in UDIMS]
    _step(job, "Merge", [share for n in range(workers) if (share := merges[n::workers])])


def _step(job: Path, step: str, shares: list[list[dict[str, int]]]) -> None:
    running = [subprocess.Popen(
        [OPENJD, "run", str(job / farm.TEMPLATE), "--step", step, "--no-run-dependencies", "--tasks",
         json.dumps(share), "-p", f"Python={sys.executable}"],
        env=ONE_CORE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) for share in shares]
    for session in running:
        said = session.communicate()[0]
        if session.returncode:
            raise SystemExit(said)


def _differing(one: Path, other: Path) -> list[str]:
    """Names of maps that are not the same, byte for byte, in two folders."""
    names = sorted({path.name for folder in (one, other) for path in folder.glob("*.exr")})
    return [name for name in names
            if not ((one / name).exists() and (other / name).exists()
                    and filecmp.cmp(one / name, other / name, shallow=False))]


def _openjd_times(folder: Path) -> tuple[float, float]:
    """Seconds to open a session, and between two of its tasks; tasks that do nothing."""
    job = folder / "empty.json"
    job.write_text(json.dumps({
        "specificationVersion": "jobtemplate-2023-09", "name": "empty", "steps": [{
            "name": "Wait", "parameterSpace": {"taskParameterDefinitions": [
                {"name": "N", "type": "INT", "range": "1-20"}]},
            "script": {"actions": {"onRun": {"command": "true"}}}}]}))
    seconds = []
    for count in ("1", "20"):
        started = time.perf_counter()
        subprocess.run([OPENJD, "run", str(job), "--step", "Wait", "--maximum-tasks", count], check=True,
                       stdout=subprocess.DEVNULL)
        seconds.append(time.perf_counter() - started)
    dispatch = (seconds[1] - seconds[0]) / 19
    return seconds[0] - dispatch, dispatch


def _merge_times(folder: Path) -> tuple[float, float]:
    """Seconds of a Merge task's process before it merges, and of each block that it merges."""
    run = folder / "run"
    command = [sys.executable, str(run / farm.PROGRAM), "merge", str(run / farm.WORK), "--udim"]
    times = []
    for udim in ("1001", "9999"):  # no such square: it starts, reads the plan and refuses
        started = time.perf_counter()
        subprocess.run([*command, udim, "--out", str(folder / "merged")], env=ONE_CORE, capture_output=True)
        times.append(time.perf_counter() - started)
    return times[1], max(times[0] - times[1], 0.0) / len(_blocks(run, 1001))


if __name__ == "__main__":
    main()
