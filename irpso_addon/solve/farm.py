"""A job for a render farm: an Open Job Description template beside all that its tasks need.  In the job's folder lie

    template.yaml   what a farm, or `openjd run`, is given
    program         this very program, without Blender: `python JOB/program tile ...`
    work            plan and pictures; every block as it is solved
    maps            the merged maps, and the scene with them on its material

A task of the step Solve is a tile, a square of blocks of one UDIM square; a task of Merge is a UDIM square.  Blocks
depend on plan and pictures alone, so tasks may run anywhere, in any order, twice, or again after they failed.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import stat
from collections.abc import Generator, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ..core.data import SceneData
from ..core.errors import BadInput
from ..core.job import Progress, retold
from ..core.maps import block_merge
from ..core.params import SolveSettings
from ..core.storage.atomic_io import PART, write_whole
from ..core.tiled.tiled_plan import Plan
from ..core.tiled.uv_blocks import BLOCK, FIRST_UDIM, HALO, UvBlock
from ..core.tiled.work_folder import WorkFolder
from .block_solve import layers_of, solve_block
from .pipeline import Bounce
from .plan_preparation import TiledRequest, prepare

TEMPLATE, PROGRAM, WORK, MAPS = "template.yaml", "program", "work", "maps"
NAME_LENGTH = 128  # of a job, as the specification allows
ROOT = Path(__file__).resolve().parents[2]
START_FILE = "__main__.py"
START = '''"""IRPSO's commands that need no Blender: python THIS_FOLDER tile|merge ..."""

import sys

from irpso_addon.__main__ import main

sys.exit(main(sys.argv[1:]))
'''

SPECIFICATION = "jobtemplate-2023-09"
TILE_ARGUMENTS = ["{{Param.Program}}", "tile", "{{Param.Work}}"]  # begin a task of Solve


@dataclass(frozen=True)
class Job:
    """What a template is made from."""

    subject: str  # the object's name
    udims: tuple[int, ...]
    size: int  # texels across a UDIM square
    tile: int  # texels across a task
    kind: str  # of the maps: exr, png, tiff
    gpu_memory: float | None = None  # GB that a worker's device must have; None: any machine does

    @property
    def tiles(self) -> int:
        """Tasks of the step Solve in each UDIM square."""
        return (-(-self.size // self.tile)) ** 2


def plan_job(
    scene: SceneData, settings: SolveSettings, folder: Path, bounce: Bounce | None = None, block: int = BLOCK,
    halo: int = HALO,
) -> Generator[Progress, None, Plan]:
    """Plan the solve in ``folder``, where finished blocks of the same solve stay.  Raises BadInput.

    Also where a program or a template lies in ``folder`` that no job has put there.
    """
    made = [path for path in (folder / MAPS, folder) if not os.path.lexists(path)]
    try:
        _check_ours(folder)
        (folder / MAPS).mkdir(parents=True, exist_ok=True)
        (folder / TEMPLATE).unlink(missing_ok=True)  # whoever finds one finds all that it needs
    except OSError as error:
        raise _unwritable(folder, error) from None
    with WorkFolder(folder / WORK) as work:
        try:
            return (yield from prepare(TiledRequest(scene, settings, bounce, block, halo), work))
        except BaseException:
            if not WorkFolder.has_plan(work.folder):  # nothing to go on from
                work.remove()
                with contextlib.suppress(OSError):  # somebody has put something there
                    for path in made:
                        path.rmdir()
            raise


def write_job(plan: Plan, folder: Path, tile: int, kind: str, gpu_memory: float | None) -> Job:
    """What a plan in ``folder`` needs to be a job; the template last.  Raises BadInput.

    ``kind``: of the maps.  ``gpu_memory``: GB that a worker's device must have; None: any worker does.
    """
    job = Job(plan.scene.mesh.name, plan.udims, plan.settings.size, tile, kind, gpu_memory)
    try:
        _check_ours(folder)
        copy_program(folder / PROGRAM)
        write_whole(folder / TEMPLATE, template(job).encode())
    except OSError as error:
        raise _unwritable(folder, error) from None
    return job


def _check_ours(folder: Path) -> None:
    """A job's program and template are made anew; those of somebody else are not.  Raises BadInput, OSError."""
    program, file = folder / PROGRAM, folder / TEMPLATE
    if os.path.lexists(program) and not _is_program(program):
        raise BadInput(f"{folder}: contains a folder '{PROGRAM}' that is not irpso's; choose another folder")
    if os.path.lexists(file) and not _is_template(file):
        raise BadInput(f"{folder}: contains a file '{TEMPLATE}' that is not irpso's; choose another folder")


def _is_program(folder: Path) -> bool:
    """Whether `copy_program` made it, or began to."""
    if not stat.S_ISDIR(folder.lstat().st_mode):
        return False
    start = folder / START_FILE
    return (_read(start) == START if os.path.lexists(start)
            else all(path.name.startswith(PART) for path in folder.iterdir()))


def _is_template(path: Path) -> bool:
    """Whether `template` wrote it: a job's name and the command of its tasks."""
    try:
        job = json.loads(_read(path))
        arguments = job["steps"][0]["script"]["actions"]["onRun"]["args"]
        return str(job["name"]).startswith("IRPSO ") and bool(arguments[:len(TILE_ARGUMENTS)] == TILE_ARGUMENTS)
    except (ValueError, LookupError, TypeError, RecursionError):
        return False


def _read(path: Path) -> str:
    """A text file; nothing for what is no file, or a link.  Raises OSError."""
    return path.read_text("utf-8", "replace") if stat.S_ISREG(path.lstat().st_mode) else ""


def _unwritable(folder: Path, error: OSError) -> BadInput:
    return BadInput(f"{folder}: cannot write there ({error.strerror}); choose another folder")


def solve_tile(folder: Path, udim: int, tile: int, tile_size: int) -> Generator[Progress, None, tuple[int, int]]:
    """Solve those blocks of a tile that the work folder lacks; how many these were, and how many the tile has.

    Raises BadInput.
    """
    work, plan = _planned(folder)
    blocks = blocks_of(plan.blocks, udim, tile, tile_size)
    if not blocks:
        raise BadInput(f"{folder}: its plan has no tile {tile} of {tile_size} texels in UDIM {udim}; "
                       "take both from the job's template")
    missing = [block for block in blocks if not work.has_block(block.key)]
    for n, block in enumerate(missing):
        yield from retold(solve_block(plan, work, block),
                          partial(_share, done=n, of=len(missing)))
    return len(missing), len(blocks)


def _share(step: Progress, done: int, of: int) -> Progress:
    """A block's progress as the tile's."""
    return replace(step, fraction=(done + step.fraction) / of, block=(done + 1, of))


def merge_square(folder: Path, udim: int, out: Path, kind: str) -> Generator[Progress, None, None]:
    """Write the maps of a UDIM square whose blocks are all there.  Uses no OpenGL.  Raises BadInput."""
    work, plan = _planned(folder)
    blocks = [block for block in plan.blocks if block.udim == udim]
    if not blocks:
        raise BadInput(f"{folder}: its plan has no UDIM {udim}, but {', '.join(map(str, plan.udims))}")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(out, error) from None
    target = block_merge.Target(out, plan.scene.mesh.name, kind, layers_of(plan),
                                plan.udims != (FIRST_UDIM,))
    for share in block_merge.steps(work.read_block, blocks, target):
        yield Progress(share, "merge")


def _planned(folder: Path) -> tuple[WorkFolder, Plan]:
    """A job's work folder, unlocked: its tasks run side by side; and its plan.  Raises BadInput."""
    work = WorkFolder(folder)
    plan = work.read_plan()
    if not isinstance(plan, Plan):
        raise BadInput(f"{folder}: is not the work folder of a job; make one with 'irpso job'")
    return work, plan


def template(job: Job) -> str:
    """The text of template.yaml, in JSON: every YAML reader takes it, and Python can write it."""
    # A list of UDIMs, since 1,000 numbers are allowed in one, while the text of a range may be too long.
    udims = {"name": "Udim", "type": "INT", "range": job.udims}
    tiles = {"name": "Tile", "type": "INT", "range": "0" if job.tiles == 1 else f"0-{job.tiles - 1}"}
    tile = [*TILE_ARGUMENTS, "--udim", "{{Task.Param.Udim}}", "--tile", "{{Task.Param.Tile}}",
            "--tile-size", str(job.tile)]
    merge = ["{{Param.Program}}", "merge", "{{Param.Work}}", "--udim", "{{Task.Param.Udim}}",
             "--out", "{{Param.Maps}}", "--format", job.kind]
    return json.dumps({
        "specificationVersion": SPECIFICATION,
        "name": _job_name(job.subject),
        "parameterDefinitions": [
            {"name": "Python", "type": "STRING", "default": "python3",
             "description": "Python 3.11 or newer on the worker, with numpy, moderngl, threadpoolctl and OpenImageIO"},
            _folder("Program", PROGRAM, "IN",
                    "The program that made the plan; blocks solved by another version would not fit"),
            _folder("Work", WORK, "INOUT", "Plan, pictures, and every block as it is solved"),
            _folder("Maps", MAPS, "OUT", "Where the maps go"),
        ],
        "steps": [
            {"name": "Solve",
             "parameterSpace": {"taskParameterDefinitions": [udims, tiles], "combination": "Udim * Tile"},
             **_requirements(job.gpu_memory), "script": _script(tile)},
            {"name": "Merge", "dependencies": [{"dependsOn": "Solve"}],
             "parameterSpace": {"taskParameterDefinitions": [udims]}, "script": _script(merge)},
        ],
    }, ensure_ascii=False, indent=2) + "\n"


def _folder(name: str, default: str, flow: str, description: str) -> dict[str, str]:
    """A parameter: a folder, by default one beside the template."""
    return {"name": name, "type": "PATH", "objectType": "DIRECTORY", "dataFlow": flow, "default": default,
            "description": description}


def _requirements(gpu_memory: float | None) -> dict[str, Any]:
    """What a worker must have: a device with so many GB, or nothing."""
    if gpu_memory is None:
        return {}
    return {"hostRequirements": {"amounts": [
        {"name": "amount.worker.gpu", "min": 1},
        {"name": "amount.worker.gpu.memory", "min": round(gpu_memory * 1e9 / 2**20)},  # MiB
    ]}}


def _script(arguments: list[str]) -> dict[str, Any]:
    return {"actions": {"onRun": {"command": "{{Param.Python}}", "args": arguments}}}


def blocks_of(windows: Iterable[UvBlock], udim: int, tile: int, tile_size: int) -> list[UvBlock]:
    """The blocks of one task: those that begin in tile number ``tile``, counted by rows from the bottom left."""
    return [w for w in windows if w.udim == udim
            and w.y // tile_size * -(-w.size // tile_size) + w.x // tile_size == tile]


def copy_program(folder: Path) -> None:
    """This program into ``folder`` (made anew), to be started as `python FOLDER`: sources and shaders alone.

    Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / START_FILE, START.encode())  # first: it tells that the rest is ours
    ignored = shutil.ignore_patterns("__pycache__", "*.pyc")
    for name in ("irpso_addon", "shaders"):
        shutil.rmtree(folder / name, ignore_errors=True)
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    manifest = "blender_manifest.toml"  # the version stands there
    write_whole(folder / manifest, (ROOT / manifest).read_bytes())


def _job_name(subject: str) -> str:
    """A job's name: one line, and no two braces side by side, which would be read as a reference."""
    plain = "".join(c if c.isprintable() else "_" for c in subject)
    apart = re.sub(r"([{}])(?=\1)", r"\1 ", plain)
    return f"IRPSO {apart}"[:NAME_LENGTH].rstrip()
