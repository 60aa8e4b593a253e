"""The page docs/environment.md and its chart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from irpso_addon.blender import files
from irpso_addon.core.data import Solution
from irpso_addon.core.phrases import percent
from irpso_addon.core.shading import environment
from studies import pages
from studies.environment.converge import Convergence
from studies.environment.poor import Poor
from studies.environment.radiance import Error
from studies.environment.recover import Recovered

CYCLES = """\
| shape | environment | roughness | median | 90 % | noise | mean |
|---|---|---|---|---|---|---|"""
SOLVES = """\
| light | views | model | base colour | mean | median | confident | share | far off | new lamp | seconds \
| of which light |
|---|---|---|---|---|---|---|---|---|---|---|---|"""

PHOTOGRAPHS = """\
| light | pictures | model | normals | left-out photographs | over the first | L* | seconds |
|---|---|---|---|---|---|---|---|"""

TURNED = """\
| off by | worlds | turned by | base colour | mean | median | confident | share |
|---|---|---|---|---|---|---|---|"""


POOR = """\
| picture | light lost | base colour | mean | median | confident | share |
|---|---|---|---|---|---|---|"""


def poor_row(of: Poor) -> str:
    """A line of the table of worlds whose picture is poor."""
    r = of.found
    confident = "-" if math.isnan(r.confident) else f"{r.confident:.3f}"
    return (f"| {of.words} | {percent(of.lost)} | {r.albedo:.1f} | {r.mean:.3f} | {r.median:.3f} | {confident} | "
            f"{percent(r.share)} |")


def write_poor(found: Sequence[Poor], renderer: str, path: Path) -> None:
    """The figures of worlds whose picture is poor, which are measured by themselves."""
    pages.fill(path if path.exists() else pages.DOCS / "environment.md", {
        "poor made": pages.measured(renderer, f"Blender {files.blender_version()}"),
        "poor": "\n".join([POOR, *map(poor_row, found)])}, path)


def turned_row(degrees: float, lamps: str, r: Recovered, solution: Solution) -> str:
    """A line of the table of worlds that are turned."""
    found = solution.calibration.worlds if solution.calibration is not None else ()
    by = f"{math.degrees(found[0].turn):+.2f} ± {math.degrees(found[0].turn_error):.2f}" if found else "0"
    return (f"| {degrees:g} | {lamps} | {by} | {r.albedo:.1f} | {r.mean:.3f} | {r.median:.3f} | {r.confident:.3f} | "
            f"{percent(r.share)} |")


def write_turned(rows: Sequence[str], renderer: str, path: Path) -> None:
    """The figures of worlds that are turned, which are measured by themselves."""
    pages.fill(path if path.exists() else pages.DOCS / "environment.md", {
        "turned made": pages.measured(renderer, f"Blender {files.blender_version()}"),
        "turned": "\n".join([TURNED, *rows])}, path)


def write_photographs(rows: Sequence[str], renderer: str, path: Path) -> None:
    """The figures of summed photographs, which are measured by themselves."""
    pages.fill(path if path.exists() else pages.DOCS / "environment.md", {
        "photographs made": pages.measured(renderer, f"Blender {files.blender_version()}"),
        "photographs": "\n".join([PHOTOGRAPHS, *rows])}, path)


def error_row(e: Error) -> str:
    """A line of the table against Cycles."""
    return (f"| {e.shape} | {e.kind} | {e.roughness} | {percent(e.middle, 2)} | {percent(e.ninety, 2)} | "
            f"{percent(e.noise, 2)} | "
            f"{percent(e.mean, 2, sign=True)} |")


def recovered_row(r: Recovered) -> str:
    """A line of the table of solves."""
    confident, far = ("-", "-") if math.isnan(r.confident) else (f"{r.confident:.3f}", percent(r.far, 1))
    return (f"| {r.rig.words} | {r.views} | {r.model} | {r.albedo:.1f} | {r.mean:.3f} | {r.median:.3f} | "
            f"{confident} | {percent(r.share)} | {far} | {r.relit:.1f} | {sum(r.seconds.values()):.0f} | "
            f"{r.seconds['observe']:.0f} |")


def draw(found: Sequence[Convergence], path: Path) -> None:
    """Error against roughness."""
    figure = Figure(figsize=(6.4, 3.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for each in found:
        words = f"{each.count} directions" + (" that divide" if each.divided else "")
        axis.plot(environment.NODE_ROUGHNESS, np.array(each.errors), "-o" if each.divided else "--s", label=words, ms=3)
    axis.set(xscale="log", yscale="log", xlabel="roughness", ylabel="error of radiance at 90 % of places")
    axis.set_xticks([0.05, 0.1, 0.2, 0.4, 1.0], ["0.05", "0.1", "0.2", "0.4", "1"])
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    figure.savefig(path, metadata={"Date": None})


def write_solves(solves: Sequence[Recovered], renderer: str, path: Path) -> None:
    """The figures of solves, which can be measured by themselves."""
    pages.fill(path if path.exists() else pages.DOCS / "environment.md", {
        "solves made": pages.measured(renderer, f"Blender {files.blender_version()}"),
        "solves": "\n".join([SOLVES, *map(recovered_row, solves)])}, path)


def write(converged: Sequence[Convergence], errors: Sequence[Error], renderer: str, path: Path) -> None:
    """The figures of the forward model."""
    shown = [k for k, _ in enumerate(environment.NODE_ROUGHNESS) if k % 2 == 0 or k == environment.NODES - 1]
    head = " | ".join(f"{environment.NODE_ROUGHNESS[k]:.2f}" for k in shown)
    lines = "\n".join(f"| {c.count}{'' if c.divided else ', undivided'} | " + " | ".join(
        f"{percent(c.errors[k], 2)}" for k in shown) + " |" for c in converged)
    pages.fill(path if path.exists() else pages.DOCS / "environment.md", {
        "made": pages.measured(renderer, f"Blender {files.blender_version()}"),
        "directions": f"| directions | {head} |\n|---|{'---|' * len(shown)}\n{lines}",
        "cycles": "\n".join([CYCLES, *map(error_row, errors)])}, path)
