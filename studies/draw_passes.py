"""How long single draws take, by shader, and what dividing them costs.

    python -m studies.draw_passes [--scene build/demo/scene.blend] [--sizes 256 1024] [--views 8] [--block 4096]
    python -m studies.draw_passes --overhead 5 --sizes 256

A pass is what is handed to OpenGL at once and waited for: here each is waited for by itself.  A program's first pass
is apart: it holds the driver's compilation, which nobody can divide.  CPU seconds are those of all threads of the
process: with Mesa's software OpenGL they tell what a pass takes where nothing else runs.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable, Generator, Hashable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from irpso_addon.core.data import SceneData
from irpso_addon.core.job import Progress
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.tiled.uv_blocks import HALO
from irpso_addon.core.tiled.work_folder import WorkFolder
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.device.draw_budget import DrawBudget
from irpso_addon.solve import pipeline
from irpso_addon.solve.block_solve import solve_block
from irpso_addon.solve.plan_preparation import TiledRequest, make_plan
from irpso_addon.solve.stages import Clock

MOST = 100.0  # ms; what no pass may take
Steps = Callable[[], Generator[Progress, None, Any]]


@dataclass
class Passes:
    """Of one shader."""

    seconds: list[float] = field(default_factory=list)
    busy: list[float] = field(default_factory=list)  # CPU seconds
    first: list[float] = field(default_factory=list)  # seconds, of each program

    @property
    def longest(self) -> float:
        """ms."""
        return 1000 * max(self.seconds, default=0.0)


class Measured(DrawBudget):
    """Keeps the times of all pieces."""

    def __init__(self, budget: DrawBudget) -> None:
        super().__init__(budget._finish, 1000 * budget.slice)
        self.passes: dict[str, Passes] = {}
        self._known: set[Hashable] = set()
        self._cpu = 0.0
        self.on_piece = self._keep

    def finish(self) -> None:
        """As it is; the clock of CPU seconds starts anew."""
        super().finish()
        self.cpu, self._cpu = time.process_time() - self._cpu, time.process_time()

    def _keep(self, key: Any, seconds: float) -> None:
        of = self.passes.setdefault(str(key[0]), Passes())
        if key in self._known:
            of.seconds.append(seconds)
            of.busy.append(self.cpu)
        else:
            of.first.append(seconds)
            self._known.add(key)


def measured(steps: Steps) -> dict[str, Passes]:
    """The passes of a job of the GL thread, by shader."""

    def job() -> Generator[Progress, None, dict[str, Passes]]:
        device = thread.device()
        assert device.prefers_compute in (True, False)  # measured before
        before, device.budget = device.budget, Measured(device.budget)
        try:
            yield from steps()
            return device.budget.passes
        finally:
            device.budget = before

    passes: dict[str, Passes] = thread.run(job)
    return passes


def overhead(steps: Steps, repeats: int) -> tuple[float, float]:
    """Medians of (wall, CPU) seconds with draws divided over those with whole draws; the two take turns."""
    ratios: list[tuple[float, float]] = []
    for n in range(repeats + 1):
        taken = [_timed(steps, slice_ms) for slice_ms in (math.inf, 15.0)]
        if n:  # the first time drivers compile
            ratios.append((taken[1][0] / taken[0][0], taken[1][1] / taken[0][1]))
    walls, cpus = (sorted(of) for of in zip(*ratios, strict=True))
    return walls[len(walls) // 2], cpus[len(cpus) // 2]


def _timed(steps: Steps, slice_ms: float) -> tuple[float, float]:
    def job() -> Generator[Progress, None, None]:
        device = thread.device()
        device.budget.choose(slice_ms)
        try:
            yield from steps()
        finally:
            device.budget.choose(device.settings.slice)

    wall, cpu = time.perf_counter(), time.process_time()
    thread.run(job)
    return time.perf_counter() - wall, time.process_time() - cpu


def a_block(scene: SceneData, settings: SolveSettings, work: WorkFolder) -> tuple[Steps, Steps]:
    """(what makes the plan of a large solve, what solves its middle block then)."""
    plans: list[Any] = []

    def plan() -> Generator[Progress, None, None]:
        clock = Clock()
        plans.append((yield from make_plan(TiledRequest(scene, settings, halo=HALO), work, clock)))

    def block() -> Generator[Progress, None, None]:
        blocks = plans[0].blocks
        yield from solve_block(plans[0], work, blocks[len(blocks) // 2])

    return plan, block


def table(title: str, passes: dict[str, Passes]) -> str:
    """Markdown; the longest first."""
    rows = [f"**{title}**", "",
            "| shader | passes | ms in all | longest (ms) | its CPU (ms) | first, with compiling (ms) |",
            "|---|---|---|---|---|---|"]
    for name, of in sorted(passes.items(), key=lambda item: -item[1].longest):
        busy = 1000 * of.busy[of.seconds.index(max(of.seconds))] if of.seconds else 0.0
        rows.append(f"| {name} | {len(of.seconds)} | {1000 * sum(of.seconds):.0f} | {of.longest:.1f} | {busy:.1f} | "
                    f"{1000 * max(of.first, default=0.0):.0f} |")
    above = sum(1000 * s > MOST for of in passes.values() for s in of.seconds)
    rows.append(f"\n{above} passes above {MOST:.0f} ms")
    return "\n".join(rows) + "\n"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m studies.draw_passes", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, default=Path("build/demo/scene.blend"))
    parser.add_argument("--sizes", type=int, nargs="*", default=[256, 1024])
    parser.add_argument("--views", type=int, help="the first views alone")
    parser.add_argument("--block", type=int, help="a block of a large solve of this size too")
    parser.add_argument("--overhead", type=int, metavar="REPEATS", help="what dividing costs, instead of the table")
    arguments = parser.parse_args()
    scene = _scene(arguments.scene)
    scene = replace(scene, views=scene.views[:arguments.views])
    for size in arguments.sizes:
        steps = partial(pipeline.solve, scene, SolveSettings(size=size))
        title = f"{size} x {size}, {len(scene.views)} views"
        if arguments.overhead:
            wall, cpu = overhead(steps, arguments.overhead)
            print(f"{title}: draws divided take {wall:.3f} times the seconds, {cpu:.3f} times the CPU seconds",
                  flush=True)
        else:
            print(table(title, measured(steps)), flush=True)
    if arguments.block:
        with tempfile.TemporaryDirectory() as folder, WorkFolder(Path(folder) / "work") as work:
            work.begin("passes")
            plan, block = a_block(scene, SolveSettings(size=arguments.block), work)
            thread.run(plan)
            print(table(f"a block of {arguments.block} x {arguments.block}", measured(block)))


def _scene(path: Path) -> SceneData:
    from irpso_addon.blender import files, oiio

    oiio.ensure_openimageio()
    from irpso_addon.blender.scene.scene import read_scene

    files.open_blend(path)
    captures = path.parent / "captures.json"
    return read_scene(None, None, captures if captures.exists() else None)


if __name__ == "__main__":
    main()
