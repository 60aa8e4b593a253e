"""The page docs/intervals.md and its picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from irpso_addon.blender import files
from irpso_addon.core.data import Solution
from irpso_addon.core.phrases import percent
from studies import pages
from studies.intervals.assets import ASSETS, Asset, truth
from studies.intervals.measure import Z90, Figures

Found = Sequence[tuple[Asset, Solution, Figures]]

HEAD = """\
| asset | model | texels | mean | median | base colour | holds | of base colour | confident | wrong of these | of all |
|---|---|---|---|---|---|---|---|---|---|---|"""


def row(asset: Asset, solution: Solution, told: Figures) -> str:
    """A line of the table."""
    models = ", ".join(sorted(set(solution.model.values())))
    return (f"| {asset.name} | {models} | {told.texels} | {told.mean_error:.4f} | {told.median_error:.4f} | "
            f"{told.base_error:.4f} | {percent(told.held, 1)} | {percent(told.base_held, 1)} | "
            f"{percent(told.confident)} | "
            f"{f'{percent(told.wrong, 2)}' if told.confident else '-'} | {percent(told.all_wrong, 1)} |")


def draw(found: Found, path: Path) -> None:
    """A row for each asset: truth, roughness found, its error and 90 % interval to one scale, confidence."""
    figure = Figure(figsize=(11, 2.25 * len(found) + 0.5), dpi=90, layout="constrained")
    FigureCanvasAgg(figure)
    axes = np.atleast_2d(figure.subplots(len(found), 5))
    titles = ("true roughness", "found", "error", "90 % interval", "confidence")
    for line, (asset, solution, _) in zip(axes, found, strict=True):
        maps, rough = solution.maps, truth(asset)[1]
        solved = maps.coverage & ~maps.filled
        shown = (rough, maps.roughness, np.abs(maps.roughness - rough), Z90 * maps.roughness_sigma, maps.confidence)
        for axis, values, most, title in zip(line, shown, (1, 1, 0.3, 0.3, 1), titles, strict=True):
            axis.imshow(np.where(solved, values, np.nan), origin="lower", vmin=0, vmax=most, cmap="magma",
                        interpolation="nearest")
            axis.set(xticks=[], yticks=[], facecolor="0.75")
            axis.set_title(title, fontsize=9)
        line[0].set_ylabel(asset.name, fontsize=9)
    for column in axes.T:
        figure.colorbar(column[-1].images[0], ax=column, location="bottom", fraction=0.02, pad=0.01)
    figure.savefig(path, pil_kwargs={"quality": 82})


def write(found: Found, path: Path) -> None:
    """The figures of the page."""
    assets = "\n".join(f"* **{a.name}**: {a.words}; {a.pixels} x {a.pixels} pixels, {a.samples} samples per pixel"
                       + (f", {percent(a.noise)} noise." if a.noise else ".") for a in ASSETS)
    pages.fill(pages.DOCS / "intervals.md", {
        "made": made_on(found[0][1]), "assets": assets,
        "table": "\n".join([HEAD, *(row(*each) for each in found)])}, path)


def made_on(solution: Solution) -> str:
    """When, where and with what a study ran."""
    return pages.measured(solution.device.get("renderer", ""), f"Blender {files.blender_version()}")
