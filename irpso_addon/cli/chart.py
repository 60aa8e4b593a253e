"""Charts of error against time: one panel an error, one curve a method, every curve named at its end.

Needs matplotlib, which Blender does not ship: `draw` raises ImportError without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

from ..core.evaluation.chart_data import COLOURS, Curve, Panel
from ..core.storage.atomic_io import replacing

MARKERS = ("o", "s", "^", "D", "v", "P", "X")  # tell apart without any colour
GREY = "#666666"
WIDTH, HEIGHT = 4.6, 4.0  # inches a panel
LABEL_GAP, LETTER = 12.0, 4.5  # points between two labels, and for a letter of one
DPI = 160


def draw(panels: Sequence[Sequence[Panel]], title: str, foot: str, stem: Path) -> list[Path]:
    """Rows of panels into ``stem``.png and .svg; their paths.  Raises ImportError without matplotlib."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    size = WIDTH * max(len(row) for row in panels), HEIGHT * len(panels) + 0.9
    with rc_context({"font.size": 9, "svg.hashsalt": "irpso", "svg.fonttype": "none", "axes.spines.top": False,
                     "axes.spines.right": False}):
        figure = Figure(size, dpi=DPI, layout="constrained")
        canvas: Any = FigureCanvasAgg(figure)
        grid: Any = figure.subplots(len(panels), len(panels[0]), squeeze=False)
        pairs = [pair for row, line in zip(panels, grid, strict=True) for pair in zip(row, line, strict=True)]
        for panel, axes in pairs:
            _panel(axes, panel)
        figure.suptitle("\n".join(wrap(title, int(13 * size[0]))), x=0.01, ha="left", fontsize=11)
        figure.supxlabel("\n".join(wrap(foot, int(17 * size[0]))), x=0.01, ha="left", fontsize=7, color=GREY)
        canvas.draw()  # only now is it known where the points lie
        for panel, axes in pairs:
            _name(axes, panel.curves)
        paths = []
        for kind in ("png", "svg"):
            paths.append(stem.with_name(f"{stem.name}.{kind}"))
            with replacing(paths[-1]) as part:
                figure.savefig(part, metadata={"Date": None} if kind == "svg" else None)
    return paths


def _panel(axes: Any, panel: Panel) -> None:
    """Draw the curves."""
    timed = [s for curve in panel.curves for s in curve.seconds or ()]
    low, high = min(timed, default=0.1), max(timed, default=1.0)
    axes.set_xscale("log")
    if panel.log:
        axes.set_yscale("log")
    axes.set_xlim(low / 1.5, high * max(3.0, (1.5 * high / low) ** 0.45))  # room for the names
    for curve in panel.curves:
        colour, marker = COLOURS[curve.place % len(COLOURS)], MARKERS[curve.place % len(MARKERS)]
        if curve.seconds is None:
            axes.axhline(curve.values[0], color=GREY, linestyle=(0, (4, 3)), linewidth=1)
            continue
        axes.plot(curve.seconds, curve.values, color=colour, marker=marker, markersize=4.5, linewidth=1.4)
        for x, y in curve.hollows():
            axes.plot([x], [y], color=colour, marker=marker, markersize=6.5, markerfacecolor="none")
        for x, y, note in zip(curve.seconds, curve.values, curve.notes, strict=False):
            axes.annotate(note, (x, y), (-4, 1), textcoords="offset points", fontsize=6, color=colour, ha="right")
    axes.set_title(f"{panel.title} ({'higher' if panel.up else 'lower'} is better)", fontsize=9, loc="left")
    axes.set_xlabel("seconds")
    for axis in (axes.xaxis, *((axes.yaxis,) if panel.log else ())):
        _ticks(axis)
    axes.grid(True, which="major", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)


def _ticks(axis: Any) -> None:
    """1, 2 and 5 of each decade, as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0,) if high / low > 100 else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _free(height: float, others: list[float]) -> float:
    """The first place from ``height`` upwards that is LABEL_GAP from all ``others`` (ascending)."""
    for other in others:
        if abs(height - other) < LABEL_GAP:
            height = other + LABEL_GAP
    return height


def _name(axes: Any, curves: Sequence[Curve]) -> None:
    """Each curve's name right of its end, moved up (or down) where a point or another name stands there."""
    from matplotlib.patheffects import Stroke

    def spot(x: float, y: float) -> tuple[float, float]:  # in points
        return tuple(axes.transData.transform((x, y)) * 72 / axes.figure.dpi)

    last = max((s for curve in curves for s in curve.seconds or ()), default=1.0)
    ends = [(last if curve.seconds is None else curve.seconds[-1], curve.values[-1]) for curve in curves]
    points = [spot(x, y) for curve in curves
              for x, y in [*zip(curve.seconds or (), curve.values, strict=False), *curve.hollows()]]
    top = axes.bbox.y1 * 72 / axes.figure.dpi
    taken = [(x - 3, x + 3, y) for x, y in points]  # left, right, height
    for curve, end in sorted(zip(curves, ends, strict=True), key=lambda pair: pair[1][1]):
        start, foot = spot(*end)
        left, right = start + 6, start + 6 + LETTER * len(curve.label)
        beside = sorted(other for other_left, other_right, other in taken if left < other_right and other_left < right)
        height = _free(foot, beside)
        if height > top:
            height = -_free(-foot, [-other for other in reversed(beside)])
        taken.append((left, right, height))
        colour = GREY if curve.seconds is None else COLOURS[curve.place % len(COLOURS)]
        for effects in ([Stroke(linewidth=2.5, foreground="white")], []):  # a halo, which SVG keeps as an outline
            axes.annotate(curve.label, end, (7, height - foot - 3), textcoords="offset points", fontsize=8,
                          color=colour, annotation_clip=False, path_effects=effects)
