"""What a farm gains: measured with workers side by side on this machine, and simulated for hundreds of them.

    python tools/farm_efficiency.py [--page]

Writes docs/farms.json, docs/farms.md and two charts; --page: from docs/farms.json as it is.  The job is the synthetic
plane of tests/gpu over two UDIM squares.  All seconds are processor time, so that a machine that does other things too
measures the same; each worker has one thread of the software rasteriser.  Takes six minutes of a core; needs
openjd-cli and matplotlib, and Linux or macOS; no Blender.
"""

from __future__ import annotations

import argparse
import filecmp
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from statistics import mean
from typing import IO, Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.core.params import SolveSettings  # noqa: E402
from irpso_addon.gpu.device import thread  # noqa: E402
from irpso_addon.solve import device_test, farm, tiled_solve  # noqa: E402  # the checkout is no installed package
from irpso_addon.solve.plan_preparation import TiledRequest  # noqa: E402
from studies import pages  # noqa: E402
from tests.support.squares import write_scene  # noqa: E402
from tools.farm_page import write_page  # noqa: E402
from tools.farm_simulation import Costs  # noqa: E402

DATA = ROOT / "docs" / "farms.json"
UDIMS, SIZE, TILE = (1001, 1002), 1024, 512  # two squares of four tasks, each of a block
PICTURES, CAMERAS, LAMPS = 512, 3, 4
WORKERS = (1, 2, 4)
REPEATS = 2
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
    """One process of the measurement: the plan of a job, or the whole solve by a single machine."""
    settings = SolveSettings(size=SIZE, udim="all", model="one-lobe")
    scene = write_scene(folder / "scene", CAMERAS, LAMPS, PICTURES)
    started = time.process_time()
    if what == "plan":
        plan = thread.run(lambda: farm.plan_job(scene, settings, folder / "job"))
        farm.write_job(plan, folder / "job", TILE, "exr", None)
    else:
        (folder / "alone").mkdir()
        thread.run(lambda: tiled_solve.run(
            TiledRequest(scene, settings), folder / "alone", folder / "alone_work", "exr"))
    print(json.dumps({"seconds": time.process_time() - started, "device": thread.run(device_test.detect).renderer}))


def measure(folder: Path) -> dict[str, Any]:
    """Everything that the page says."""
    alone, plan = (json.loads(_finish([_start([sys.executable, __file__, "--child", what, str(folder)])])[1])
                   for what in ("alone", "plan"))
    shutil.copytree(folder / "job", folder / "clean")
    start, blocks, slowness = _task_times(folder)
    workers = {}
    for count in WORKERS:
        workers[count] = _farm(_fresh(folder), count)
        if names := _differing(folder / "alone", folder / "run" / farm.MAPS):
            raise SystemExit(f"farm_efficiency: {count} workers: other bytes than one machine: {names}")
    session, dispatch = _openjd_times(folder)
    merge_start, merge = _merge_times(folder)
    costs = Costs(plan["seconds"], session, dispatch, start, tuple(blocks), merge_start, merge, tuple(slowness))
    return {"device": plan["device"], "date": pages.today(), "commit": pages.commit(), "cpu": pages.processors(),
            "software": f"numpy {version('numpy')}, Python {platform.python_version()}",
            "alone": alone["seconds"] - plan["seconds"],
            "workers": workers, "costs": asdict(costs), "size": SIZE, "tile": TILE, "views": CAMERAS * LAMPS,
            "pixels": PICTURES}


Running = tuple[subprocess.Popen[str], IO[str]]


def _start(command: Sequence[str]) -> Running:
    said = tempfile.TemporaryFile("w+")
    return subprocess.Popen(command, env=ONE_CORE, stdout=said, stderr=subprocess.STDOUT, text=True), said


def _finish(running: list[Running]) -> tuple[float, str]:
    """Processor seconds of that process that took most, with all that it started; the last line that the last said."""
    most, last = 0.0, ""
    for process, said in running:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        text = said.read()
        if process.returncode:
            raise SystemExit(text)
        most, last = max(most, usage.ru_utime + usage.ru_stime), (text.splitlines() or [""])[-1]
    return most, last


def _fresh(folder: Path) -> Path:
    """The job as it was planned, without blocks."""
    shutil.rmtree(folder / "run", ignore_errors=True)
    shutil.copytree(folder / "clean", folder / "run")
    return folder / "run"


def _task_times(folder: Path) -> tuple[float, list[float], list[float]]:
    """Of a task before its first block, of blocks, and how much longer the same block took in some runs."""
    times: dict[tuple[int, int], list[float]] = {}
    for _ in range(REPEATS):
        job = _fresh(folder)
        for udim in UDIMS:
            for tile in range((SIZE // TILE) ** 2):
                times.setdefault((udim, tile), []).append(_tile(job, udim, tile, TILE))
    job = _fresh(folder)
    squares = sum(_tile(job, udim, 0, SIZE) for udim in UDIMS)
    singles = sum(mean(seconds) for seconds in times.values())
    start = max(singles - squares, 0.0) / (len(times) - len(UDIMS))  # all that so many more processes cost
    return (start, [seconds - start for row in times.values() for seconds in row],
            [seconds / min(row) for row in times.values() for seconds in row])


def _tile(job: Path, udim: int, tile: int, tile_size: int) -> float:
    return _finish([_start([sys.executable, str(job / farm.PROGRAM), "tile", str(job / farm.WORK), "--udim", str(udim),
                            "--tile", str(tile), "--tile-size", str(tile_size)])])[0]


def _farm(job: Path, workers: int) -> float:
    """Seconds of the job's two steps by so many workers: each a session of its own, as a farm opens them."""
    tasks = [{"Udim": udim, "Tile": tile} for udim in UDIMS for tile in range((SIZE // TILE) ** 2)]
    merges = [{"Udim": udim} for udim in UDIMS]
    return sum(_finish([_start([
        str(OPENJD), "run", str(job / farm.TEMPLATE), "--step", step, "--no-run-dependencies", "--tasks",
        json.dumps(each[n::workers]), "-p", f"Python={sys.executable}"]) for n in range(min(workers, len(each)))])[0]
        for step, each in (("Solve", tasks), ("Merge", merges)))


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
                {"name": "N", "type": "INT", "range": "1-40"}]},
            "script": {"actions": {"onRun": {"command": "true"}}}}]}))
    few, many = (_finish([_start([str(OPENJD), "run", str(job), "--step", "Wait", "--maximum-tasks", count])])[0]
                 for count in ("1", "40"))
    dispatch = (many - few) / 39
    return few - dispatch, dispatch


def _merge_times(folder: Path) -> tuple[float, float]:
    """Seconds of a Merge task's process before it merges, and of each block that it merges."""
    run = folder / "run"
    command = [sys.executable, str(run / farm.PROGRAM)]
    rest = [str(run / farm.WORK), "--udim", str(UDIMS[0])]
    whole = _finish([_start([*command, "merge", *rest, "--out", str(folder / "merged")])])[0]
    start = _finish([_start([*command, "tile", *rest, "--tile", "0", "--tile-size", "512"])])[0]  # reads plan and block
    return start, max(whole - start, 0.0) / (SIZE // TILE) ** 2


if __name__ == "__main__":
    main()
