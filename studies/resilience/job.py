"""What is killed: a small large solve in plain Python, and the process that starts it as often as is asked for.

``python -m studies.resilience.job SCENE`` reads requests from standard input, a JSON line each, and forks a process for
each: starting Python and importing the solver would take longer than the job.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.reporting.report import write_report
from irpso_addon.core.storage.atomic_io import PART
from irpso_addon.core.storage.output_transaction import SET, OutputTransaction
from irpso_addon.core.tiled import npz_archive
from irpso_addon.core.tiled.work_folder import WorkFolder
from irpso_addon.gpu.device import thread
from irpso_addon.solve import tiled_solve
from irpso_addon.solve.plan_preparation import TiledRequest

SIZE, BLOCK = 128, 64  # texels
WORK = tiled_solve.WORK
BAD = 3  # exit status of a BadInput, as of the command line
# What the audit hook of Python tells that changes files; "open" also tells what is only read.
EVENTS = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate", "shutil.rmtree", "os.listdir"}


def make_scene(folder: Path) -> Path:
    """A plane of four materials on one UV square, its pictures, and the scene as a bundle."""
    from tests.support import shoots, synthetic

    shoot = synthetic.shoot(synthetic.PATCHES, shoots.rig(cameras=1, lamps=3), (48, 48))
    views = []
    for view in shoot.scene.views:
        path = folder / view.image.name
        write_image(path, shoot.images[view.image.name].rgb, kind="exr", color=True)
        views.append(replace(view, image=path))
    npz_archive.save(folder / "scene.npz", replace(shoot.scene, views=tuple(views)))
    return folder / "scene.npz"


def solve(scene: Path, out: Path) -> None:
    """As the command line does it, without the .blend."""
    data = npz_archive.load(scene)
    settings = SolveSettings(size=SIZE, model="one-lobe", registration="given")
    with OutputTransaction(out) as staging:
        solution = thread.run(lambda: tiled_solve.run(
            TiledRequest(data, settings, block=BLOCK), staging.folder, out / WORK, "exr"))
        write_report(staging.folder / "report.json", {"texels": solution.texels, "residual": solution.residual})
        staging.publish()
    with WorkFolder(out / WORK) as work:
        work.remove()


@dataclass(frozen=True)
class Request:
    """A run."""

    out: str
    moment: float | None = None  # seconds after which it is killed
    event: int | None = None  # the process kills itself before it does its n-th thing to files in ``out``
    late: int | None = None  # the same, counted from when the maps are merged
    limit: int | None = None  # bytes that a file may have: writing fails beyond, as on a full disk


def main() -> None:
    """Serve requests until standard input ends."""
    scene = Path(sys.argv[1])
    for line in sys.stdin:
        request = Request(**json.loads(line))
        child = os.fork()
        if child == 0:
            _child(scene, request)
        print(child, flush=True)
        if request.moment is not None:
            time.sleep(request.moment)
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        print(os.waitstatus_to_exitcode(status), flush=True)


def _child(scene: Path, request: Request) -> None:
    """Never returns.  What it says goes to OUT.said, how many events there were to OUT.events."""
    status = 1
    try:
        os.setsid()
        said = os.open(f"{request.out}.said", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        nothing = os.open(os.devnull, os.O_RDWR)
        for handle, place in ((nothing, 0), (nothing, 1), (said, 2)):
            os.dup2(handle, place)
        if request.limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (request.limit, resource.RLIM_INFINITY))
        count = _watch(request)
        try:
            solve(scene, Path(request.out))
            status = 0
        except BadInput as error:
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            print(error, file=sys.stderr)
            status = BAD
        if request.limit is None:
            Path(f"{request.out}.events").write_text(json.dumps(count))
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stderr.flush()
        os._exit(status)


def _watch(request: Request) -> list[int]:
    """Counts what is done to files in ``out``, in all and since maps are merged, and dies when it is time."""
    count = [0, 0]

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event not in EVENTS or not arguments or not (path := str(arguments[0])).startswith(request.out):
            return
        count[0] += 1
        if count[1] or (SET in path and PART in path):
            count[1] += 1
        if count[0] == request.event or count[1] == request.late:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)
    return count


if __name__ == "__main__":
    main()
