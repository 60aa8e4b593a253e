"""Maps of any size in little memory: a plan on a small map, blocks that depend on it alone, and their merge to files.

Generators of Progress for the GL thread, as in pipeline.py.  docs/decisions/0010 tells why blocks and not a whole.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..core import log
from ..core.data import SceneData, Solution
from ..core.errors import Cancelled, StoppedWithWork
from ..core.job import Progress, Steps, retold
from ..core.maps import block_merge
from ..core.maps.export import safe_stem
from ..core.params import SolveSettings
from ..core.storage.output_transaction import OutputTransaction
from ..core.tiled import uv_blocks
from ..core.tiled.tiled_plan import Plan
from ..core.tiled.work_folder import WorkFolder
from ..gpu.device import thread
from .block_solve import STATS, layers_of, solve_block
from .pipeline import Bounce
from .plan_preparation import PLANNED, TiledRequest, prepare
from .stages import Clock

SOLVED = 0.95  # of the whole, once all blocks are solved
WORK = "irpso_work_"  # begins the name of a folder beside the maps, until they are done


def run(request: TiledRequest, folder: Path, work: Path, kind: str) -> Generator[Progress, None, Solution]:
    """Files of the maps in ``folder``; what is finished lies in ``work``, where a run that was stopped goes on.

    Once the files are in their place the caller removes ``work`` (`WorkFolder.remove`).  ``kind``: of the files, as
    export.py.  Returns the plan's solution, of small maps, with the figures of the whole.  Raises BadInput for what
    cannot be used, and Cancelled: StoppedWithWork once there is a plan.
    """
    steps = _run(request, folder, work, kind)
    return (yield from log.watched(request.scene, request.settings, thread.settings(), steps))


def _run(request: TiledRequest, folder: Path, work: Path, kind: str) -> Generator[Progress, None, Solution]:
    clock = Clock()
    with WorkFolder(work) as place:
        plan = yield from prepare(request, place, clock)
        blocks = plan.blocks
        left = [window for window in blocks if not place.has_block(window.key)]
        there = len(blocks) - len(left)
        stopped = False
        try:
            for n, window in enumerate(left):
                yield from _one_of_many(solve_block(plan, place, window, clock), there + n, len(blocks))
            began = time.perf_counter()
            target = block_merge.Target(folder, request.scene.mesh.name, kind, layers_of(plan),
                                        plan.udims != (uv_blocks.FIRST_UDIM,))
            for share in block_merge.steps(place.read_block, blocks, target):
                yield Progress(SOLVED + (1 - SOLVED) * share, "merge", "writing files")
        except Cancelled:
            stopped = True
        if stopped:  # raised out here it does not carry the other one along, whose frames hold the block's textures
            raise StoppedWithWork(work, WorkFolder.count_blocks(work))
        clock.seconds["merge"] = time.perf_counter() - began
        solution = total(plan, place)
    resumed = (f"resumed: {there} of {len(blocks)} blocks were already solved",) if there else ()
    return replace(solution, seconds=clock.seconds, warnings=(*resumed, *solution.warnings), resumed_blocks=there)


def work_folder(out: Path, name: str) -> Path:
    """Where what is finished of an object's maps waits until all of it is in ``out``."""
    return out / f"{WORK}{safe_stem(name)}"


def solve_to(
    scene: SceneData, settings: SolveSettings, out: Path, kind: str, bounce: Bounce | None = None,
) -> Generator[Progress, None, Solution]:
    """As `run`: all files appear in ``out`` together; until then what is finished waits in `work_folder`."""
    work = work_folder(out, scene.mesh.name)
    with OutputTransaction(out) as staging:
        solution = yield from run(TiledRequest(scene, settings, bounce), staging.folder, work, kind)
        staging.publish()
    with WorkFolder(work) as place:
        place.remove()
    return solution


def _one_of_many(steps: Steps[None], before: int, blocks: int) -> Steps[None]:
    """A block's steps as part of the whole, without looks: they would show no map."""
    def placed(step: Progress) -> Progress:
        return Progress(PLANNED + (SOLVED - PLANNED) * (before + step.fraction) / blocks, step.stage,
                        f"block {before + 1} of {blocks}: {step.message}", block=(before + 1, blocks))

    return retold(steps, placed)


def total(plan: Plan, work: WorkFolder) -> Solution:
    """The plan's solution with the figures of all blocks."""
    every = np.concatenate([work.read_block(window.key)[STATS] for window in plan.blocks])
    stats = every.sum(axis=0, dtype=np.float64)
    texels = dict(zip(("covered", "observed", "solved", "filled"), (int(n) for n in stats[:4]), strict=True))
    reduced = (f"{int(stats[6])} of {len(every)} blocks: their pictures are reduced to fit into {plan.memory:g} GB; "
               "increase Memory to use more of their pixels",) if stats[6] else ()
    return replace(plan.solution, stride=plan.stride, texels={**texels, "kept": 0},
                   warnings=(*plan.solution.warnings, *reduced), device=thread.device().describe(),
                   residual=float(np.sqrt(stats[4] / max(stats[5], 1.0))))
