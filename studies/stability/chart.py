"""Charts and pictures: one chart for each axis with every method on it, and the map that came out worst."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image

from irpso_addon.core.phrases import percent
from irpso_addon.gpu.device.context import Device
from studies.bench.chart import STYLES as BENCH

from .axes import Axis
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
WIDE = 12.0  # times
TICK = 0.075  # of a panel, between two labels


def draw(axis: Axis, summaries: Mapping[str, Any], out: Path) -> Path:
    """The axis's chart; ``found``: {point: {method: summary}}."""
    figure = Figure(figsize=(9.3, 7))
    FigureCanvasAgg(figure)  # no window, whatever the machine
    panels = figure.subplots(2, 2).flat
    points = [p for p in axis.points if p.label in summaries]
    places = positions([p.label for p in points])
    lines: dict[str, Any] = {}
    for panel, (key, title, log) in zip(panels, PANELS, strict=True):
        for method in METHODS:
            known = [(x, summaries[p.label][method.key]) for x, p in zip(places, points, strict=True)
                     if method.key in summaries[p.label]]
            if known:
                lines[method.label] = _line(panel, method.key, key, known, log)
        _dress(panel, title, axis, dict(zip(places, [p.label for p in points], strict=True)), log)
    figure.suptitle(f"{axis.title}", x=0.01, y=0.99, ha="left", va="top", fontsize=13, fontweight="bold")
    figure.legend(lines.values(), lines.keys(), loc="upper left", bbox_to_anchor=(0.0, 0.96), ncols=4, fontsize=10,
                  frameon=False, handlelength=2.6, columnspacing=1.4)
    figure.tight_layout(rect=(0, 0, 1, 0.915), w_pad=1.2, h_pad=1.2)
    made = io.BytesIO()
    figure.savefig(made, dpi=100, facecolor="white")
    Image.open(made).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(out, optimize=True)  # a third
    return out


def positions(labels: Sequence[str]) -> list[float]:
    """Where the points lie: numbers to scale, by logarithms if they span more than WIDE; names side by side."""
    try:
        values = np.array([float(label) for label in labels])
    except ValueError:
        return [float(i) for i in range(len(labels))]
    least = values[values > 0].min(initial=np.inf)
    if values.min() < 0 or values.max() <= WIDE * least:
        return values.tolist()
    # 0 lies left of the smallest number, as far as a factor of 2.
    return np.log2(np.maximum(values, least / 2)).tolist()


def _line(panel: Axes, method: str, key: str, known: list[tuple[float, Any]], log: bool) -> Any:
    style = {"markersize": 8 if method == "swarm" else 5, **STYLES[method]}  # what lies under refined looks out
    x = [place for place, _ in known]
    y = np.array([s[key] for _, s in known])
    spread = np.array([s[f"{key}_spread"] for _, s in known])
    low, high = y - spread, y + spread
    if log:
        y, low, high = (np.maximum(v, FLOOR) for v in (y, low, high))
    panel.fill_between(x, low, high, color=style["color"], alpha=0.13, linewidth=0, zorder=1)
    line, = panel.plot(x, y, **style)
    return line


def _dress(panel: Axes, title: str, axis: Axis, ticks: Mapping[float, str], log: bool) -> None:
    if log:
        panel.set_yscale("log")
        low, high = panel.get_ylim()
        panel.set_ylim(max(low, FLOOR * 0.8), max(high, 12 * low))
        panel.yaxis.set_major_locator(LogLocator(subs=(1.0,)))
        panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.yaxis.set_minor_formatter(NullFormatter())
    else:
        panel.set_ylim(0, None)
    panel.set_title(title, fontsize=11, loc="left")
    shown = apart(list(ticks))
    panel.set_xticks(shown, [ticks[x] for x in shown])
    panel.set_xticks(list(ticks), minor=True)
    panel.set_xlabel(axis.unit, fontsize=10 if len(axis.unit) < 48 else 9)
    panel.tick_params(labelsize=9.5)
    panel.grid(True, which="major", color="#dddddd", linewidth=0.7)
    panel.set_axisbelow(True)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)


def apart(places: Sequence[float]) -> list[float]:
    """Those whose labels do not meet; the first and the last are among them."""
    gap = TICK * (max(places) - min(places))
    kept = [places[0]]
    for x in places[1:-1]:
        if abs(x - kept[-1]) >= gap and abs(places[-1] - x) >= gap:
            kept.append(x)
    return [*kept, *places[1:][-1:]]


def worst_map(device: Device, axis: Axis, records: Mapping[str, Mapping[str, Any]], out: Path) -> tuple[str, int]:
    """The map of the axis that `refined` got worst: truth, estimate, confidence, error.  (point's label, seed)."""
    shares = {(p.label, int(s)): r["failures"] for p in axis.points for s, r in records.get(p.label, {}).items()}
    label, seed = max(shares, key=lambda where: (shares[where], -where[1]))
    trial = next(p.trial for p in axis.points if p.label == label)
    problem = make(replace(trial, seed=seed))
    table = Table(device, problem)
    answer, _ = answered(device, table, BY_KEY["refined"])
    table.release()
    wrong = f"off by more than 0.1: {percent(shares[label, seed])}"
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
