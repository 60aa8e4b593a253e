"""irpso compare: every method on the user's own scene, error against time, as table, JSON and chart."""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import pipeline
from ..blender import files
from ..blender.scene import read_scene
from ..core.data import F64, Bool, RadianceImage, SceneData, Solution, View
from ..core.errors import BadInput, Cancelled
from ..core.image import read_reference
from ..core.params import SolveSettings
from ..core.predict import Surface, surface
from ..core.report import versions, write_report
from ..core.staging import Staging
from ..core.truth import read_truth
from ..gpu import thread
from ..gpu.observe import most_pixels
from . import chart, console, options
from .judge import ReadImage, make_judge

FEWEST_VIEWS = 4  # of which one is held out
REFERENCE = "refined"  # the method from which the others' differences are told
PLACES = {"refined": 0, "draft": 1, "swarm": 2, "paper": 3}  # colours on the chart
TRUTH_COLUMNS = ("albedo_rmse", "rough_mae", "rough_mae_informed")
PANELS = (  # title, part of the row, its key, scale
    ("held-out views, relative error in %", "held_out", None, 100.0),
    ("base colour, RMS error", "truth", "albedo_rmse", 1.0),
    ("roughness, mean error", "truth", "rough_mae", 1.0))


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput."""
    thread.configure(options.device(arguments))
    scene: Path = arguments.scene
    out: Path = arguments.out or scene.parent / f"{scene.stem}_compare"
    with console.quiet():
        files.open_blend(scene)
    data = read_scene(None, arguments.object, arguments.captures)
    fit, held = hold_out(data, arguments.hold_out, arguments.truth is not None)
    truth = read_truth(arguments.truth, data.mesh.name) if arguments.truth else None
    with Staging(out) as staging:
        try:
            report = compare(fit, held, truth, arguments)
        except Cancelled:  # the maps of a solve cut short are nothing to compare by
            raise Cancelled from None
        write_report(staging.folder / "compare.json", report)
        drawn = draw(report, staging.folder / "compare")
        staging.publish()
    tell(report, out, drawn)


def hold_out(data: SceneData, every: int, has_truth: bool) -> tuple[SceneData, SceneData | None]:
    """The scene with the views to solve from, and with every ``every``-th, held out (0: none).

    Raises BadInput where the views do not suffice.
    """
    if every == 0:
        if not has_truth:
            raise BadInput("--hold-out 0: leaves nothing to judge by; hold views out, or give the true maps (--truth)")
        return data, None
    if len(data.views) < FEWEST_VIEWS:
        raise BadInput(f"{data.name}: has {len(data.views)} usable views, too few to hold one out and solve from the "
                       f"rest; give {FEWEST_VIEWS} or more")
    chosen = range(min(every, len(data.views)) // 2, len(data.views), every)
    return (replace(data, views=tuple(view for i, view in enumerate(data.views) if i not in chosen)),
            replace(data, views=tuple(data.views[i] for i in chosen)))


# ---- measuring


def compare(
    fit: SceneData, held: SceneData | None, truth: tuple[F64, F64] | None, arguments: argparse.Namespace,
) -> dict[str, Any]:
    """Solve with every method, judge each; the report."""
    views = fit.views + (held.views if held else ())
    started = time.perf_counter()
    read_image = read_once(views)
    reading = time.perf_counter() - started
    _say("observing")
    judge = make_judge(fit, held, truth, read_image, arguments.size)
    base = options.settings(arguments)
    entries = {method: replace(base, method=method) for method in ("draft", "refined", "swarm")}
    for passes in sorted(set(arguments.passes)):
        entries[f"paper, {passes} passes"] = replace(base, method="paper", iterations=passes)
    surfaces, seconds = {"no solver": judge.no_solver()}, {"no solver": {"total": judge.seconds}}
    for method in ("draft", *(("paper",) if arguments.passes else ())):  # the others are draft's programs
        _say(f"{method}, once before the clock starts")
        _solve(fit, replace(base, method=method, iterations=1), read_image)
    for label, settings in entries.items():
        _say(label)
        solution = _solve(fit, settings, read_image)
        surfaces[label] = surface(solution, base.ndf, judge.grid.slots, fit.mesh.slot_names)
        seconds[label] = {**solution.seconds, "total": sum(solution.seconds.values())}
    true = judge.true_maps()
    return {
        "versions": versions() | {"blender": files.blender_version()}, "device": solution.device, "machine": machine(),
        "date": time.strftime("%Y-%m-%d"), "command": ["irpso", *sys.argv[1:]], "scene": fit.name,
        "object": fit.mesh.name, "size": arguments.size, "model": arguments.model, "reading_seconds": reading,
        "views": {"solved_from": [view.image.name for view in fit.views],
                  "held_out": [view.image.name for view in held.views] if held else []},
        "texels": int(judge.where.sum()), "truth_held_out": judge.held_out(true) if judge.held and true else None,
        "rows": [{"method": label, "seconds": seconds[label], **judge.errors(maps),
                  "from_refined": difference(maps, surfaces[REFERENCE], judge.where)}
                 for label, maps in surfaces.items()]}


def read_once(views: tuple[View, ...]) -> ReadImage:
    """Every reference, read now for all methods, reduced as the pipeline would reduce it."""
    most = most_pixels(views, thread.settings().memory)
    images: dict[int, RadianceImage] = {id(view): read_reference(view, max_pixels=most) for view in views}
    return lambda view: images[id(view)]


def _solve(scene: SceneData, settings: SolveSettings, read_image: ReadImage) -> Solution:
    solution: Solution = thread.run(lambda: pipeline.solve(scene, settings, read_image))
    if solution.cancelled:
        raise Cancelled
    return solution


def difference(maps: Surface, reference: Surface, where: Bool) -> dict[str, float]:
    """Of two results over the texels ``where``."""
    part = where.ravel()
    return {"base_rmse": float(np.sqrt(np.mean((maps.base - reference.base)[part] ** 2))),
            "rough_mae": float(np.abs((maps.lobes - reference.lobes)[part, 0]).mean())}


def machine() -> dict[str, Any]:
    """Processor, cores, system."""
    processor = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):  # another system
        pass
    return {"processor": processor, "cores": os.cpu_count(), "system": f"{platform.system()} {platform.machine()}"}


# ---- showing


def tell(report: dict[str, Any], out: Path, drawn: bool) -> None:
    """The table, and what lies in the folder."""
    truth = any(row["truth"] for row in report["rows"])
    held = any(row["held_out"] is not None for row in report["rows"])
    head = ["method", "solve s", "whole s", *(["held out %"] if held else []),
            *(["base RMSE", "roughness MAE", "informed"] if truth else []), "base: to refined", "roughness"]
    rows = []
    for row in report["rows"]:
        seconds = row["seconds"]
        cells = [row["method"], _number(seconds.get("solve"), 2), _number(seconds["total"], 2)]
        cells += [f"{100 * row['held_out']:.2f}"] if held else []
        for part, keys in (("truth", TRUTH_COLUMNS if truth else ()), ("from_refined", ("base_rmse", "rough_mae"))):
            cells += [_number(row[part].get(key)) for key in keys]
        rows.append(cells)
    console.say(f"{report['object']}: {report['size']} x {report['size']} texels, {report['texels']:,} judged; "
                f"{len(report['views']['solved_from'])} views, {len(report['views']['held_out'])} held out")
    console.table(head, rows)
    if report["truth_held_out"] is not None:
        console.say(f"the true maps themselves are off by {report['truth_held_out']:.2%} on the views held out")
    console.say(f"{out}: compare.json" + (", compare.png, compare.svg" if drawn else ""))
    if not drawn:
        console.warn("no chart: this Python has no matplotlib (nor has Blender's); compare.json holds it all")


def draw(report: dict[str, Any], stem: Path) -> bool:
    """The chart, unless there is no matplotlib."""
    panels = [chart.Panel(title, _curves(report["rows"], part, key, scale), log=True)
              for title, part, key, scale in PANELS if all(row[part] is not None for row in report["rows"])]
    if report["truth_held_out"] is not None:
        panels[0].curves.append(chart.Curve("true maps", 6, None, [100 * report["truth_held_out"]]))
    at = report["machine"]
    foot = (f"{at['processor']}, {at['cores']} cores, {at['system']}, {report['device']['renderer']}; "
            f"IRPSO {report['versions']['irpso']}, Blender {report['versions']['blender']}; {report['date']}")
    title = (f"{report['scene']}, {report['object']}: {report['size']} x {report['size']} texels, "
             f"{len(report['views']['solved_from'])} views")
    try:
        chart.draw([panels], title, foot, stem)
    except ImportError:
        return False
    return True


def _curves(rows: list[dict[str, Any]], part: str, key: str | None, scale: float) -> list[chart.Curve]:
    """One a method; the budgets of one method are one curve."""
    value = lambda row: scale * (row[part] if key is None else row[part][key])  # noqa: E731
    curves = []
    for method, place in PLACES.items():
        mine = [row for row in rows if row["method"].split(",")[0] == method]
        if mine:
            notes = [row["method"].split(", ")[1].split()[0] for row in mine] if len(mine) > 1 else ()
            seconds = [row["seconds"]["total"] for row in mine]
            curves.append(chart.Curve(method, place, seconds, [value(row) for row in mine], notes))
    bare = next(row for row in rows if row["method"] == "no solver")
    return [*curves, chart.Curve("no solver", 6, None, [value(bare)])]


def _number(value: float | None, digits: int = 4) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _say(what: str) -> None:
    print(f"irpso: {what}", file=sys.stderr, flush=True)
