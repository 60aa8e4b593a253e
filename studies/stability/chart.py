"""Charts and pictures: one chart for each axis with every method on it, and the map that came out worst."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image

from irpso_addon.gpu.device.context import Device
from studies.bench.chart import STYLES as BENCH

from .axes import Axis, Point
from .methods import BY_KEY, METHODS, Answer, Table
from .problem import Problem, make
from .sweep import answered

STYLES: dict[str, dict[str, Any]] = {  # colours and marks as in docs/benchmarks
    **{key: {**BENCH[key], "linewidth": 2.0 if key in ("refined", "swarm", "paper") else 1.4}
       for key in ("paper", "swarm", "refined", "single", "adam")},
    "squares": {"color": "#D55E00", "marker": "o", "markerfacecolor": "white", "linestyle": "--", "linewidth": 1.4,
                "zorder": 6},
    "exposed": {"color": "#882255", "marker": "P", "linewidth": 2.0, "zorder": 7},
    "auto": {"color": "#882255", "marker": "P", "linewidth": 2.0, "zorder": 7},
}
PANELS = (("roughness", "roughness error (mean)", True), ("worst", "of the worst 1 % of texels (mean)", False),
          ("failures", "share of texels off by more than 0.1", False), ("albedo", "albedo error (RMSE)", True))
FLOOR = 3e-4


def draw(axis: Axis, summaries: Mapping[str, Any], out: Path) -> Path:
    """The axis's chart; ``found``: {point: {method: summary}}."""
    figure = Figure(figsize=(13, 3.4))
    FigureCanvasAgg(figure)  # no window, whatever the machine
    panels = figure.subplots(1, len(PANELS))
    points = [p for p in axis.points if p.label in summaries]
    lines: dict[str, Any] = {}
    for panel, (key, title, log) in zip(panels, PANELS, strict=True):
        for method in METHODS:
            known = [(i, summary[method.key]) for i, summary in enumerate(summaries[p.label] for p in points)
                     if method.key in summary]
            if known:
                lines[method.label] = _line(panel, method.key, key, known, log)
        _dress(panel, title, axis, points, log)
    figure.suptitle(f"{axis.title}", x=0.01, y=0.985, ha="left", va="top", fontsize=13, fontweight="bold")
    figure.legend(lines.values(), lines.keys(), loc="upper right", bbox_to_anchor=(0.995, 1.0), ncols=len(lines),
                  fontsize=9, frameon=False, handlelength=2.6, columnspacing=1.4)
    figure.tight_layout(rect=(0, 0, 1, 0.97), w_pad=1.2)
    made = io.BytesIO()
    figure.savefig(made, dpi=75, facecolor="white")
    Image.open(made).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(out, optimize=True)  # a third
    return out


def _line(panel: Axes, method: str, key: str, known: list[tuple[int, Any]], log: bool) -> Any:
    style = {"markersize": 8 if method == "swarm" else 5, **STYLES[method]}  # what lies under refined looks out
    x = [i for i, _ in known]
    y = np.array([s[key] for _, s in known])
    spread = np.array([s[f"{key}_spread"] for _, s in known])
    low, high = y - spread, y + spread
    if log:
        y, low, high = (np.maximum(v, FLOOR) for v in (y, low, high))
    panel.fill_between(x, low, high, color=style["color"], alpha=0.13, linewidth=0, zorder=1)
    line, = panel.plot(x, y, **style)
    return line


def _dress(panel: Axes, title: str, axis: Axis, points: list[Point], log: bool) -> None:
    if log:
        panel.set_yscale("log")
        low, high = panel.get_ylim()
        panel.set_ylim(max(low, FLOOR * 0.8), max(high, 12 * low))
        panel.yaxis.set_major_locator(LogLocator(subs=(1.0,)))
        panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.yaxis.set_minor_formatter(NullFormatter())
    else:
        panel.set_ylim(0, None)
    panel.set_title(title, fontsize=9.5, loc="left")
    panel.set_xticks(range(len(points)), [p.label for p in points])
    panel.set_xlabel(axis.unit, fontsize=8.5 if len(axis.unit) < 44 else 7)
    panel.tick_params(labelsize=8.5)
    panel.grid(True, which="major", color="#dddddd", linewidth=0.7)
    panel.set_axisbelow(True)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)


def worst_map(device: Device, axis: Axis, records: Mapping[str, Mapping[str, Any]], out: Path) -> tuple[str, int]:
    """The map of the axis that `refined` got worst: truth, estimate, confidence, error.  (point's label, seed)."""
    shares = {(p.label, int(s)): r["failures"] for p in axis.points for s, r in records.get(p.label, {}).items()}
    label, seed = max(shares, key=lambda where: (shares[where], -where[1]))
    trial = next(p.trial for p in axis.points if p.label == label)
    problem = make(replace(trial, seed=seed))
    table = Table(device, problem)
    answer, _ = answered(device, table, BY_KEY["refined"])
    table.release()
    wrong = f"off by more than 0.1: {shares[label, seed]:.0%}"
    picture(problem, answer, f"{axis.title}: {label} (seed {seed}), {wrong}", out)
    return label, seed


def picture(problem: Problem, answer: Answer, title: str, out: Path) -> None:
    """Four maps side by side."""
    figure = Figure(figsize=(8.6, 2.5))
    FigureCanvasAgg(figure)
    assert answer.confidence is not None
    solved = answer.solved
    error = np.where(solved, np.abs(answer.roughness - problem.truth.roughness), np.nan)
    maps = (("true roughness", problem.truth.roughness, "viridis", (0, 1)),
            ("estimate", np.where(solved, answer.roughness, np.nan), "viridis", (0, 1)),
            ("confidence", answer.confidence, "gray", (0, 1)), ("error", error, "magma", (0, 0.3)))
    for panel, (name, values, colours, limits) in zip(figure.subplots(1, 4), maps, strict=True):
        image = panel.imshow(values, cmap=colours, vmin=limits[0], vmax=limits[1], origin="lower",
                             interpolation="nearest")
        panel.set_title(name, fontsize=9)
        panel.set_xticks([])
        panel.set_yticks([])
        bar = figure.colorbar(image, ax=panel, fraction=0.046, pad=0.03)
        bar.ax.tick_params(labelsize=7)
    figure.suptitle(title, fontsize=9.5, x=0.01, ha="left", fontweight="bold")
    figure.tight_layout(rect=(0, 0, 1, 0.97), w_pad=0.6)
    figure.savefig(out, dpi=70, facecolor="white", pil_kwargs={"optimize": True})
