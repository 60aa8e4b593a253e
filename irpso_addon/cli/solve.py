"""irpso solve: a lit scene to maps on its material, and to files."""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from ..blender import files
from ..blender.jobs import solve_object
from ..core.checks.warnings import grouped
from ..core.data import Solution
from ..core.errors import BadInput, Cancelled
from ..core.job import Progress, run_to_end
from ..core.maps.export import earlier_maps, write_maps
from ..core.params import SolveSettings
from ..core.phrases import percent
from ..core.reporting import estimates
from ..core.reporting.estimates import REDUCED, gigabytes
from ..core.reporting.report import build_report, write_report
from ..core.storage.output_transaction import OutputTransaction
from ..gpu.device import thread
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
    part: solve_object.Part = solve_object.ALL
    keep: tuple[str, ...] = ()  # lamps and cameras that are sure


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput; Cancelled after the partial maps are written."""
    thread.configure(options.device(arguments))
    scene: Path = arguments.scene
    request = Request(
        scene=scene, out=arguments.out or scene.parent / f"{scene.stem}_irpso", settings=options.settings(arguments),
        captures=arguments.captures, object_name=arguments.object, kind=arguments.format, report=arguments.report,
        part=_part(arguments), keep=tuple(arguments.keep))
    solution = solve(request)
    if solution.cancelled:
        raise Cancelled(solution)


def _part(arguments: argparse.Namespace) -> solve_object.Part:
    if arguments.vertex_group is not None:
        return "GROUP", arguments.vertex_group
    if arguments.part_image is not None:
        return "IMAGE", arguments.part_image
    return ("FACES" if arguments.selected_faces else "ALL"), None


def solve(request: Request) -> Solution:
    """Open, solve, write everything or nothing, say what came out.  A cancelled solve is written as far as it got."""
    if request.report is not None and not os.path.isdir(request.report.resolve().parent):
        raise BadInput(f"{request.report}: folder not found; create it or choose another")
    started = time.perf_counter()
    with console.quiet():
        files.open_blend(request.scene)
    files.keep(request.keep)
    order = replace(
        solve_object.read(None, request.object_name, request.captures, request.settings, request.part),
        folder=request.out, kind=request.kind)
    read = time.perf_counter()
    solve_object.check(order)
    print_estimate(order)
    with OutputTransaction(request.out) as staging:
        with console.progress() as show:
            solution = solve_object.run(order, request.scene, staging.folder, lambda step: show(_by_blocks(step)))
        solved = time.perf_counter()
        messages = solve_object.place_now(files.object_named(order.name), order, solution)
        if not order.large:
            write_maps(solution.maps, order.name, staging.folder, request.kind)
        solution = replace(solution, warnings=(*solution.warnings, *messages))
        with console.quiet():
            files.save_copy(staging.beside(f"{order.data.name}_irpso.blend"))
        seconds = {"scene": read - started, **solution.seconds, "write": time.perf_counter() - solved}
        solution = replace(solution, seconds=seconds)
        report = build_report(solution, request.settings, ["irpso", *sys.argv[1:]], blender=files.blender_version())
        write_report(staging.folder / "report.json", report)
        if request.report is not None:
            write_report(request.report, report)
        written = staging.publish()
        left = earlier_maps(staging.out, order.name, written)
    solve_object.forget_work(order)
    print_summary(order.name, solution, request.out)
    if left:
        console.warn(f"warning: {request.out}: an earlier solve left {', '.join(left)}; delete these files, or choose "
                     "another folder")
    return solution


def _by_blocks(step: Progress) -> Progress:
    """Each block goes through all stages: of no interest to a log."""
    if step.block is None:
        return step
    number, count = step.block
    return replace(step, stage="blocks", message=f"block {number} of {count}")


def print_estimate(order: solve_object.Order) -> None:
    """Say what the solve will need.  Raises BadInput where the disk has no room for it."""
    with console.progress() as show:
        needs = run_to_end(solve_object.expected(order), show)
    solve_object.check_room(order, needs)
    if thread.settings().device == "numpy":  # which takes other times
        return
    unsure = "" if needs.learnt else " (first guess)"
    reduced = f", pictures reduced to {percent(needs.reduced ** 0.5)} to fit" if needs.reduced < REDUCED else ""
    bounced = f", {estimates.in_words(needs.bounced)} if light bounces" if needs.bounced else ""
    console.expect(f"{estimates.in_words(needs.seconds)}{unsure}{bounced}, {gigabytes(needs.gpu_bytes)} GPU memory, "
                   f"{gigabytes(needs.host_bytes)} memory, {gigabytes(needs.disk_bytes)} of disk{reduced}")


def print_summary(name: str, solution: Solution, out: Path) -> None:
    """The few lines that a user wants after a solve."""
    for warning in solution.warnings:
        console.warn(f"warning: {warning}")
    for line in grouped([f"{view}: left out: {why}" for view, why in solution.views_skipped]):
        console.warn(f"warning: {line}")
    texels = solution.texels
    total = sum(solution.seconds.values())
    models = ", ".join(sorted(set(solution.model.values())))
    console.say(
        f"{name}: {models}, {texels['solved']:,} of {texels['covered']:,} texels from {len(solution.views_used)} views "
        f"in {total:.1f} s (solve {solution.seconds.get('solve', 0.0):.1f} s), residual "
        f"{percent(solution.residual, 2)}")
    for material, prediction in solution.predictions.items():
        console.say(f"{material or 'no material'}: left-out {prediction.left_out} predicted to "
                    f"{percent(prediction.error.relative_rms, 1)} of their radiance, {prediction.error.lightness:.1f} "
                    "L* "
                    f"({prediction.taken})")
    console.say(f"{out}: maps, report.json and the scene with the maps on its material")
