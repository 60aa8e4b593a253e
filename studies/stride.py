"""``python -m studies.stride``: makes docs/stride.md, what solving every second or fourth texel costs and saves.

Where texels are finer than the pictures, neighbours show the same pixels.  Cycles' pictures of the demo's vase, and of
half an ellipsoid, are solved with each stride.  Needs Blender as a module and matplotlib.  Pictures are kept in
build/stride.  --cases: these alone, printed, and no page.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np

from irpso_addon.blender import files
from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.blender.sample import demo
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.cli.demo import Scores, make, score
from irpso_addon.core.data import F32, F64, SceneData
from irpso_addon.core.maps import stride as strides
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.samples import vase
from irpso_addon.gpu.device import thread
from irpso_addon.solve import gpu_path, pipeline
from studies import pages
from studies.budget.scenes import dome, dome_paint, keep_views
from studies.intervals.assets import Asset, sheet, truth, waves
from studies.intervals.measure import scene_of
from studies.intervals.page import made_on

PICTURES = pages.ROOT / "build" / "stride"
PAGE = pages.DOCS / "stride.md"
STRIDES = (1, 2, 4)
HEAD = ("case", "stride", "pixels per solved texel", "taken", "base colour (dB)", "roughness, mean error", "median",
        "mean where confident", "confident", "seconds, of those of stride 1")


def _patches(u: F64, v: F64) -> tuple[F64, F64]:
    """Clouds of two paints; roughness in sharp patches that lie elsewhere."""
    base, _ = dome_paint(u, v)
    return base, np.where(waves(u, v, 53, 4) > 0, 0.5, 0.25)


@dataclass(frozen=True)
class Case:
    """A scene whose truth is known at any size."""

    name: str
    size: int  # texels
    scene: Callable[[Path], SceneData]  # from a folder for its pictures
    truth: Callable[[int], tuple[F32, F32]]


def _vase(folder: Path, plan: demo.Plan, views: int) -> SceneData:
    if not (folder / "captures.json").exists():
        make(folder, plan)
        keep_views(folder, views)
    files.open_blend(folder / "scene.blend")
    return read_scene(None, demo.NAME, folder / "captures.json")


def _dome(name: str, paint: Callable[[F64, F64], tuple[F64, F64]]) -> Case:
    asset = Asset(name, "", (sheet(dome, (96, 96), (0.01, 0.99, 0.01, 0.99)),), paint, pixels=288)
    return Case(name, 512, lambda folder: scene_of(asset, folder), lambda size: truth(asset, size))


CASES = (
    Case("vase, 32 pictures of 288 pixels, 512 texels", 512,
         lambda folder: _vase(folder, demo.Plan(), 32), vase.truth),
    Case("vase, 36 pictures of 512 pixels, 1024 texels", 1024,
         lambda folder: _vase(folder, demo.Plan(texels=1024, cameras=6, lights=12, pixels=512), 36), vase.truth),
    _dome("dome, smooth roughness, 36 of 288, 512", dome_paint),
    _dome("dome, borders in roughness alone, 36 of 288, 512", _patches),
)


@dataclass(frozen=True)
class Row:
    """A solve."""

    case: str
    stride: int
    pixels: float  # mean of a solved texel, in the picture that shows it best
    taken: bool  # by default
    scores: Scores
    seconds: float


def measure(case: Case, folder: Path) -> tuple[list[Row], str]:
    """With each stride, after a solve that compiles; and where that was."""
    scene, seen = case.scene(folder), []

    def chosen(pixels: F64, size: int) -> int:
        seen.append((float(pixels.mean()), strides.stride_of(pixels, size)))
        return stride

    rows = []
    for n, stride in enumerate((STRIDES[-1], *STRIDES)):
        with patch.object(gpu_path, "stride_of", chosen):
            found = thread.run(lambda: pipeline.solve(scene, SolveSettings(size=case.size)))
        if n > 0:
            each, default = seen[0]
            rows.append(Row(case.name, stride, each * stride**2, stride == default,
                            score(case.truth(case.size), found.maps), sum(found.seconds.values())))
            print(rows[-1], flush=True)
    return rows, made_on(found)


def table(rows: Sequence[Row]) -> str:
    """As Markdown."""
    whole = {row.case: row.seconds for row in rows if row.stride == 1}
    return pages.table(HEAD, [(
        row.case, str(row.stride), f"{row.pixels:.2f}", "yes" if row.taken else "", f"{row.scores.albedo_psnr:.2f}",
        f"{row.scores.rough_mae:.4f}", f"{row.scores.rough_median:.4f}", f"{row.scores.rough_mae_confident:.4f}",
        f"{100 * row.scores.confident:.0f} %", f"{row.seconds / whole[row.case]:.2f}") for row in rows])


def draw(rows: Sequence[Row], out: Path) -> None:
    """Error against time: a line for each case, from every texel (right) to every fourth (left)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 4.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    whole = {row.case: row.seconds for row in rows if row.stride == 1}
    for case, colour in zip(whole, ("#0072B2", "#009E73", "#E69F00", "#D55E00"), strict=False):
        own = [row for row in rows if row.case == case]
        x, y = [row.seconds / whole[case] for row in own], [row.scores.rough_mae for row in own]
        axis.plot(x, y, "-o", color=colour, label=case, markersize=5)
        for row, at, error in zip(own, x, y, strict=True):
            axis.annotate(str(row.stride), (at, error), xytext=(5, 5), textcoords="offset points", color=colour)
            if row.taken:
                axis.plot(at, error, "o", color=colour, fillstyle="none", markersize=12)
    axis.set_xlim(0, 1.1)
    axis.set_ylim(0, 1.15 * max(row.scores.rough_mae for row in rows))
    axis.set_xlabel("seconds, as a share of those with every texel solved")
    axis.set_ylabel("mean error of roughness")
    axis.grid(alpha=0.4)
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper left", ncols=2, frameon=False)
    figure.savefig(out, facecolor="white", metadata={"Description": "error against time, by stride"},
                   pil_kwargs={"optimize": True})


def main() -> int:
    """Measure, print, and write the page where all was measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", type=int, default=None, metavar="N", help="numbers from 1 on")
    arguments = parser.parse_args()
    ensure_openimageio()
    rows, made = [], ""
    for n, case in enumerate(CASES, start=1):
        if arguments.cases is None or n in arguments.cases:
            more, made = measure(case, PICTURES / str(n))
            rows += more
    print(table(rows))
    if arguments.cases is None:
        pages.fill(PAGE, {"made": made, "table": table(rows)})
        draw(rows, pages.DOCS / "stride.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
