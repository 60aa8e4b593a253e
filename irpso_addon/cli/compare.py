"""irpso compare: every method on the user's own scene, error against time, as table, JSON and chart."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from ..blender import files
from ..blender.scene.scene import read_scene
from ..compare.measure import figure, hold_out, measure
from ..core.evaluation.chart_data import Chart
from ..core.evaluation.ground_truth import read_truth
from ..core.images.reference_image import with_raw_size
from ..core.job import Progress
from ..core.phrases import percent
from ..core.reporting.report import write_report
from ..core.storage.output_transaction import OutputTransaction
from ..gpu.device import thread
from ..solve.one_round import share_outside
from . import chart, console, options

TRUTH_COLUMNS = ("albedo_rmse", "rough_mae", "rough_mae_informed")


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput."""
    thread.configure(options.device(arguments))
    scene: Path = arguments.scene
    out: Path = arguments.out or scene.parent / f"{scene.stem}_compare"
    with console.quiet():
        files.open_blend(scene)
    settings = options.settings(arguments)
    data = with_raw_size(read_scene(None, arguments.object, arguments.captures), settings)
    outside = share_outside(data.mesh)
    lines = [f"{data.mesh.name}: {percent(outside, 1)} of its faces are outside the 0-1 UV square and are not "
             "compared; lay its UVs out in one square"] if outside > 0 else []
    fit, held = hold_out(data, arguments.hold_out, arguments.truth is not None)
    truth = read_truth(arguments.truth, data.mesh.name) if arguments.truth else None
    for line in (*data.warnings, *lines):
        console.warn(f"warning: {line}")
    with OutputTransaction(out) as staging:
        job = partial(measure, fit, held, truth, settings, arguments.passes)
        report = thread.run(job, _method_lines())
        report["versions"]["blender"] = files.blender_version()
        report["command"] = ["irpso", *sys.argv[1:]]
        write_report(staging.folder / "compare.json", report)
        drawn = draw(figure(report), staging.folder / "compare")
        staging.publish()
    print_report(report, out, drawn)


def _method_lines() -> Callable[[Progress], None]:
    """A line for each method."""
    last = ""

    def show(progress: Progress) -> None:
        nonlocal last
        if progress.message != last:
            last = progress.message
            console.warn(last)

    return show


# ---- showing


def print_report(report: dict[str, Any], out: Path, drawn: bool) -> None:
    """The table, and what lies in the folder."""
    truth = any(row["truth"] for row in report["rows"])
    held = any(row["held_out"] is not None for row in report["rows"])
    foretold = any(row["predicted"] for row in report["rows"])
    head = ["method", "solve s", "whole s", *(["held out %"] if held else []),
            *(["RMS %, L*"] if held and foretold else []), *(["predicted"] if foretold else []),
            *(["base RMSE", "roughness MAE", "informed"] if truth else []), "base: to refined", "roughness"]
    rows = []
    for row in report["rows"]:
        seconds = row["seconds"]
        cells = [row["method"], _number(seconds.get("solve"), 2), _number(seconds["total"], 2)]
        cells += [f"{100 * row['held_out']:.2f}"] if held else []
        cells += [_error(row["held_out_error"])] if held and foretold else []
        cells += [_error(row["predicted"])] if foretold else []
        for part, keys in (("truth", TRUTH_COLUMNS if truth else ()), ("from_refined", ("base_rmse", "rough_mae"))):
            cells += [_number(row[part].get(key)) for key in keys]
        rows.append(cells)
    console.say(f"{report['object']}: {report['size']} x {report['size']} texels, {report['texels']:,} judged; "
                f"{len(report['views']['solved_from'])} views, {len(report['views']['held_out'])} held out")
    console.table(head, rows)
    if report["truth_held_out"] is not None:
        console.say(f"the true maps are off by {percent(report['truth_held_out'], 2)} on the views held out")
    console.say(f"{out}: compare.json" + (", compare.png, compare.svg" if drawn else ""))
    if not drawn:
        console.warn("no chart: neither this Python nor Blender's has matplotlib; compare.json contains all figures")


def draw(made: Chart, stem: Path) -> bool:
    """The chart, unless there is no matplotlib."""
    try:
        chart.draw([made.panels], made.title, made.foot, stem)
    except ImportError:
        return False
    return True


def _error(found: dict[str, Any] | None) -> str:
    """Relative RMS in per cent, and L*."""
    return "-" if found is None else f"{100 * found['relative_rms']:.2f}, {found['lightness']:.2f}"


def _number(value: float | None, digits: int = 4) -> str:
    return "" if value is None else f"{value:.{digits}f}"
