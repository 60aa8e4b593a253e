"""irpso solve: a lit scene to maps on its material, and to files."""

from __future__ import annotations

import argparse
import os
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from ..blender import files
from ..blender.jobs import solve_region, solve_speed
from ..blender.jobs.indirect import Bouncer
from ..blender.material import material, material_preflight
from ..blender.scene.scene import read_scene
from ..core.data import SceneData, Solution
from ..core.errors import BadInput, Cancelled, StoppedWithWork
from ..core.images.image_file import open_image
from ..core.job import Progress
from ..core.maps.export import write_maps
from ..core.params import SolveSettings
from ..core.reporting import estimates
from ..core.reporting.estimates import Taken, gigabytes
from ..core.reporting.report import build_report, write_report
from ..core.storage.output_transaction import Staging
from ..core.tiled import uv_blocks
from ..core.tiled.work_folder import Work
from ..gpu.device import thread
from ..solve import pipeline, tiled_solve
from . import console, options


@dataclass(frozen=True)
class Request:
    """What one solve is asked for."""

    scene: Path
    out: Path
    settings: SolveSettings
    captures: Path | None = None
    object_name: str | None = None
    kind: str = "exr"
    report: Path | None = None
    part: tuple[str, str | Path | None] = ("ALL", None)  # as blender.steer.with_part


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput; Cancelled after the partial maps are written."""
    thread.configure(options.device(arguments))
    scene: Path = arguments.scene
    request = Request(
        scene=scene, out=arguments.out or scene.parent / f"{scene.stem}_irpso", settings=options.settings(arguments),
        captures=arguments.captures, object_name=arguments.object, kind=arguments.format, report=arguments.report,
        part=_part(arguments))
    solution = solve(request)
    if solution.cancelled:
        raise Cancelled(solution)


def _part(arguments: argparse.Namespace) -> tuple[str, str | Path | None]:
    if arguments.vertex_group is not None:
        return "GROUP", arguments.vertex_group
    if arguments.part_image is not None:
        return "IMAGE", arguments.part_image
    return ("FACES" if arguments.selected_faces else "ALL"), None


def solve(request: Request) -> Solution:
    """Open, solve, write everything or nothing, say what came out.  A cancelled solve is written as far as it got."""
    if request.report is not None and not os.path.isdir(request.report.resolve().parent):
        raise BadInput(f"{request.report}: there is no such folder; make it or choose another")
    started = time.perf_counter()
    with console.quiet():
        files.open_blend(request.scene)
    data = read_scene(None, request.object_name, request.captures)
    subject = files.object_named(data.mesh.name)
    material_preflight.check(subject, data.mesh)
    data = solve_region.with_part(None, subject, data, request.settings.start, *request.part)
    read = time.perf_counter()
    udims = uv_blocks.solved_udims(request.settings.udim, data.mesh.uvs)
    large = uv_blocks.is_large(request.settings.size, udims)
    work = tiled_solve.work_folder(request.out, data.mesh.name) if large else None
    if work is not None:
        tiled_solve.check(data, request.settings)
    foretell(data, request, udims, work)
    bounce = Bouncer.of_open_file(request.scene)
    with Staging(request.out) as staging:
        if work is None:
            solution = solve_data(data, request.settings, bounce)
            solved = time.perf_counter()
            messages = material.write_maps(subject, solution)
            write_maps(solution.maps, data.mesh.name, staging.folder, request.kind)
        else:
            solution = solve_in_blocks(data, request, staging.folder, work, bounce)
            solved = time.perf_counter()
            messages = material.link_maps(subject, solution, request.out, request.kind, udims)
        solution = replace(solution, warnings=(*solution.warnings, *messages))
        with console.quiet():
            files.save_copy(staging.beside(f"{data.name}_irpso.blend"))
        seconds = {"scene": read - started, **solution.seconds, "write": time.perf_counter() - solved}
        solution = replace(solution, seconds=seconds)
        report = build_report(solution, request.settings, ["irpso", *sys.argv[1:]], blender=files.blender_version())
        write_report(staging.folder / "report.json", report)
        if request.report is not None:
            write_report(request.report, report)
        staging.publish()
    if work is not None:
        with Work(work) as place:
            place.remove()
    tell(data.mesh.name, solution, request.out)
    return solution


def solve_data(data: SceneData, settings: SolveSettings, bounce: pipeline.Bounce) -> Solution:
    """Run the pipeline with its progress shown; the partial solution when it was stopped with one."""
    with console.progress() as show:
        try:
            result: Solution = thread.run(
                lambda: pipeline.solve(data, settings, bounce=bounce), on_progress=show)
        except Cancelled as stop:
            if stop.partial is None:
                raise
            result = stop.partial
    return result


def solve_in_blocks(
    data: SceneData, request: Request, folder: Path, work: Path, bounce: pipeline.Bounce,
) -> Solution:
    """The maps' files in ``folder``, from blocks in ``work``.  Stopped once there are some it raises StoppedWithWork."""
    try:
        with console.progress() as show:
            result: Solution = thread.run(
                lambda: tiled_solve.run(data, request.settings, folder, work, request.kind, bounce),
                on_progress=lambda p: show(_coarse(p)))
        return result
    except BaseException as error:
        if not Work.has_plan(work):
            with suppress(BadInput), Work(work) as place:
                place.remove()
        elif isinstance(error, Cancelled | KeyboardInterrupt):
            raise StoppedWithWork(work, Work.count_blocks(work)) from None
        raise


def _coarse(step: Progress) -> Progress:
    """Each block goes through all stages: of no interest to a log."""
    if step.block is None:
        return step
    number, count = step.block
    return replace(step, stage="blocks", message=f"block {number} of {count}")


def foretell(data: SceneData, request: Request, udims: tuple[int, ...], work: Path | None) -> None:
    """Say what the solve will need.  Raises BadInput where the disk has no room for it."""
    taken = []
    for view in data.views:
        with suppress(BadInput):  # the solve says it
            header = open_image(view.image)
            taken.append(Taken(header.width, header.height, view.camera.name, len(view.lights)))
    settings = request.settings
    found = estimates.estimate(taken, settings, solve_speed.factors(), thread.settings().memory,
                              rounds=settings.indirect == "on", udims=udims)
    estimates.check_disk(request.out, found.disk_bytes, 0 if work is None else estimates.size_of(work))
    if thread.settings().device == "numpy":  # which takes other times
        return
    unsure = "" if found.learnt else " (first guess)"
    console.expect(f"{estimates.in_words(found.seconds)}{unsure}, {gigabytes(found.gpu_bytes)} GPU memory, "
                   f"{gigabytes(found.host_bytes)} memory, {gigabytes(found.disk_bytes)} of disk")


def tell(name: str, solution: Solution, out: Path) -> None:
    """The few lines that a user wants after a solve."""
    for warning in solution.warnings:
        console.warn(f"warning: {warning}")
    for view, why in solution.views_skipped:
        console.warn(f"warning: {view}: left out: {why}")
    texels = solution.texels
    total = sum(solution.seconds.values())
    models = ", ".join(sorted(set(solution.model.values())))
    console.say(
        f"{name}: {models}, {texels['solved']:,} of {texels['covered']:,} texels from {len(solution.views_used)} views "
        f"in {total:.1f} s (solve {solution.seconds.get('solve', 0.0):.1f} s), residual {solution.residual:.2%}")
    console.say(f"{out}: maps, report.json and the scene with the maps on its material")
