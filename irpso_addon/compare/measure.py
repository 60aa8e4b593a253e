"""What `irpso compare` and the operator of that name measure: every method on a scene, error against time.

Free of Blender, so that a worker process can do it.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Generator, Hashable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..core.data import F64, Bool, RadianceImage, SceneData, Solution, View
from ..core.errors import BadInput, Cancelled
from ..core.evaluation.chart_data import Chart, Curve, Panel
from ..core.evaluation.prediction import Surface, surface
from ..core.images.reference_image import read_reference
from ..core.job import Progress, retold
from ..core.params import SolveSettings
from ..core.versions import versions
from ..gpu.device import thread
from ..gpu.observe.picture_memory import most_pixels
from ..solve import pipeline
from ..solve.kept_images import reference_key
from .judge import Judge, ReadImage, make_judge

FEWEST_VIEWS = 4  # of which one is held out
REFERENCE = "refined"  # the method from which the others' differences are reported
PLACES = {"refined": 0, "draft": 1, "swarm": 2, "paper": 3}  # colours on the chart
PREDICTED = "held-out views, RMS in % (hollow: predicted)"  # a panel where some method predicts its error
PANELS = (  # title, part of the row, its key, scale
    ("held-out views, relative error in %", "held_out", None, 100.0),
    (PREDICTED, "held_out_error", "relative_rms", 100.0),
    ("base colour, RMS error", "truth", "albedo_rmse", 1.0),
    ("roughness, mean error", "truth", "rough_mae", 1.0))
Result = TypeVar("Result")
Job = Generator[Progress, None, Result]


def hold_out(data: SceneData, every: int, has_truth: bool) -> tuple[SceneData, SceneData | None]:
    """The scene with the views to solve from, and with every ``every``-th, held out (0: none).

    Raises BadInput where the views do not suffice.
    """
    if every == 0:
        if not has_truth:
            raise BadInput("--hold-out 0: leaves nothing to judge by; hold out views, or give the true maps (--truth)")
        return data, None
    if every == 1:
        raise BadInput("--hold-out 1: leaves no view to solve from; use 2 or more")
    if len(data.views) < FEWEST_VIEWS:
        raise BadInput(f"{data.name}: has {len(data.views)} usable views, too few to hold one out and solve from the "
                       f"rest; use {FEWEST_VIEWS} or more")
    chosen = range(min(every, len(data.views)) // 2, len(data.views), every)
    return (replace(data, views=tuple(view for i, view in enumerate(data.views) if i not in chosen)),
            replace(data, views=tuple(data.views[i] for i in chosen)))


def measure(
    fit: SceneData, held: SceneData | None, truth: tuple[F64, F64] | None, base: SolveSettings, passes: Sequence[int],
) -> Job[dict[str, Any]]:
    """Runs on the GL thread: solves with every method, judges each; the report.

    ``passes``: budgets of method paper.  Raises BadInput, and Cancelled without anything: the maps of a solve that is
    cut short are nothing to compare by.
    """
    yield Progress(0.0, "compare", "reading pictures")
    started = time.perf_counter()
    read_image = read_once(fit.views + (held.views if held else ()))
    reading = time.perf_counter() - started
    warm = ["draft", *(["paper"] if passes else [])]  # the others are draft's programs
    entries = {method: replace(base, method=method) for method in ("draft", "refined", "swarm")}
    for count in sorted(set(passes)):
        entries[f"paper, {count} passes"] = replace(base, method="paper", iterations=count)
    step = 1 / (1 + len(warm) + len(entries))
    judge: Judge = yield from _part(make_judge(fit, held, truth, read_image, base.size), 0.0, step, "observing")
    surfaces, seconds = {"no solver": judge.no_solver()}, {"no solver": {"total": judge.seconds}}
    foretold: dict[str, Any] = {"no solver": None}
    done = step
    for method in warm:
        once = replace(base, method=method, iterations=1)
        yield from _part(_solve(fit, once, read_image), done, step, f"{method}, once before the clock starts")
        done += step
    for label, settings in entries.items():
        solution: Solution = yield from _part(_solve(fit, settings, read_image), done, step, label)
        surfaces[label] = surface(solution, base.ndf, judge.grid.slots, fit.mesh.slot_names)
        seconds[label] = {**solution.seconds, "total": sum(solution.seconds.values())}
        foretold[label] = predicted(solution)
        done += step
    true = judge.true_maps()
    return {
        "versions": versions(), "device": solution.device, "machine": machine(), "date": time.strftime("%Y-%m-%d"),
        "scene": fit.name, "object": fit.mesh.name, "size": base.size, "model": base.model, "reading_seconds": reading,
        "views": {"solved_from": [view.image.name for view in fit.views],
                  "held_out": [view.image.name for view in held.views] if held else []},
        "texels": int(judge.where.sum()), "truth_held_out": judge.held_out(true)[0] if judge.held and true else None,
        "rows": [{"method": label, "seconds": seconds[label], **judge.errors(maps), "predicted": foretold[label],
                  "from_refined": difference(maps, surfaces[REFERENCE], judge.where)}
                 for label, maps in surfaces.items()]}


def _part(job: Job[Result], done: float, share: float, message: str) -> Job[Result]:
    """A job as part of this one."""
    return (yield from retold(job, lambda step: Progress(done + share * step.fraction, "compare", message)))


def _solve(scene: SceneData, settings: SolveSettings, read_image: ReadImage) -> Job[Solution]:
    # Held-out views are drawn with the mesh's normals, for all methods alike.
    solution = yield from pipeline.solve(scene, replace(settings, normals="mesh"), read_image)
    if solution.cancelled:
        raise Cancelled
    return solution


def read_once(views: tuple[View, ...]) -> ReadImage:
    """Every reference, read now for all methods, reduced as the pipeline would reduce it."""
    most = most_pixels(views, thread.settings().memory)
    images: dict[Hashable, RadianceImage] = {}

    def read(view: View) -> RadianceImage:
        key = reference_key(view)  # a solve moves cameras, and may correct exposures
        if key not in images:
            images[key] = read_reference(view, max_pixels=most)
        return images[key]

    for view in views:
        read(view)
    return read


def difference(maps: Surface, reference: Surface, where: Bool) -> dict[str, float]:
    """Of two results over the texels ``where``."""
    part = where.ravel()
    return {"base_rmse": float(np.sqrt(np.mean((maps.base - reference.base)[part] ** 2))),
            "rough_mae": float(np.abs((maps.lobes - reference.lobes)[part, 0]).mean())}


def predicted(solution: Solution) -> dict[str, Any] | None:
    """What a solve itself expects of views that it has not seen: of its material that predicts worst."""
    if not solution.predictions:
        return None
    material, found = max(solution.predictions.items(), key=lambda item: item[1].error.relative_rms)
    return {"material": material, "left_out": found.left_out, "taken": found.taken, **asdict(found.error)}


def machine() -> dict[str, Any]:
    """Processor, cores, system."""
    processor = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):  # another system
        pass
    return {"processor": processor, "cores": os.cpu_count(), "system": f"{platform.system()} {platform.machine()}"}


# ---- the chart


def figure(report: dict[str, Any]) -> Chart:
    """The report's errors against its seconds."""
    rows = report["rows"]
    foretold = any(row["predicted"] for row in rows)
    panels = [Panel(title, _curves(rows, part, key, scale), log=True) for title, part, key, scale in PANELS
              if all(row[part] is not None for row in rows) and (foretold or title != PREDICTED)]
    if report["truth_held_out"] is not None:
        panels[0].curves.append(Curve("true maps", 6, None, [100 * report["truth_held_out"]]))
    at = report["machine"]
    foot = (f"{at['processor']}, {at['cores']} cores, {at['system']}, {report['device']['renderer']}; "
            f"IRPSO {report['versions']['irpso']}, Blender {report['versions']['blender']}; {report['date']}")
    title = (f"{report['scene']}, {report['object']}: {report['size']} x {report['size']} texels, "
             f"{len(report['views']['solved_from'])} views")
    return Chart(title, tuple(panels), foot)


def _curves(rows: list[dict[str, Any]], part: str, key: str | None, scale: float) -> list[Curve]:
    """One a method; the budgets of one method are one curve."""

    def value(row: dict[str, Any]) -> float:
        return float(scale * (row[part] if key is None else row[part][key]))

    curves = []
    for method, place in PLACES.items():
        mine = [row for row in rows if row["method"].split(",")[0] == method]
        if mine:
            notes = [row["method"].split(", ")[1].split()[0] for row in mine] if len(mine) > 1 else ()
            seconds = [row["seconds"]["total"] for row in mine]
            hollow = [scale * row["predicted"][key] if row["predicted"] else None
                      for row in mine] if part == "held_out_error" else ()
            curves.append(Curve(method, place, seconds, [value(row) for row in mine], notes, hollow))
    bare = next(row for row in rows if row["method"] == "no solver")
    return [*curves, Curve("no solver", 6, None, [value(bare)])]
