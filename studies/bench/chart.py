"""The chart: error against time, a row for each problem, a curve for each method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

# Okabe and Ito's palette, told apart by the colour-blind; our own methods are thick, a library's share a colour.
STYLES: dict[str, dict[str, Any]] = {
    "refined": {"color": "#D55E00", "marker": "o", "linewidth": 2.6, "zorder": 6},
    "swarm": {"color": "#E69F00", "marker": "s", "linewidth": 2.6, "zorder": 5},
    "paper": {"color": "#CC79A7", "marker": "D", "linewidth": 2.6, "zorder": 4},
    "single": {"color": "#56B4E9", "marker": "v", "linestyle": ":"},
    "adam": {"color": "#56B4E9", "marker": "^", "linestyle": "--"},
    "golden": {"color": "#56B4E9", "marker": "P"},
    "torch-lm": {"color": "#009E73", "marker": "o", "linestyle": "--"},
    "torch-lm-c": {"color": "#009E73", "marker": "o"},
    "torch-adam": {"color": "#0072B2", "marker": "^", "linestyle": "--"},
    "torch-adam-c": {"color": "#0072B2", "marker": "^"},
    "mitsuba": {"color": "#000000", "marker": "X"},
    "scipy": {"color": "#000000", "marker": "x", "linestyle": ":"},
    "none": {"color": "#777777", "marker": "*", "linestyle": "none", "markersize": 11},
}
LABELS = {"refined": False, "swarm": True, "paper": True}  # told at the ring: on its right?
PLAIN = {"color": "#444444", "marker": "."}
FLOOR = 1e-6  # errors below are drawn here: float32 knows no better
COLUMNS = (("albedo", "albedo error (RMSE)"), ("roughness", "roughness error (mean)"))


def draw(
    curves: Sequence[dict[str, Any]], machine: dict[str, str], out: Path, earlier: dict[str, Any] | None = None,
) -> list[Path]:
    """Write ``out`` with .png and .svg; curves and machine as studies/bench/measure.py makes them.

    ``earlier``: machine and curves of a run before, in grey.
    """
    titles = list(dict.fromkeys(c["title"] for c in curves))
    figure = Figure(figsize=(10, 2.0 + 3.0 * len(titles)))
    FigureCanvasAgg(figure)  # no window, whatever the machine
    axes = figure.subplots(len(titles), 2, squeeze=False, sharex=True)
    drawn: dict[str, Any] = {}
    before, name = (earlier["curves"], f"IRPSO at {earlier['machine']['commit']}") if earlier else ((), "")
    for row, title in zip(axes, titles, strict=True):
        for axis, (key, label) in zip(row, COLUMNS, strict=True):
            for curve in (c for c in before if c["title"] == title):
                drawn[name] = _before(axis, curve, key)
            for curve in (c for c in curves if c["title"] == title):
                drawn[curve["label"]] = _curve(axis, curve, key)
            _dress(axis, f"{title}: {label}")
    seconds = [p["seconds"] for c in curves for p in c["points"]]
    axes[0, 0].set_xlim(min(seconds) / 4, max(seconds) * 1.5)  # of all; room for a name on the left
    for axis in axes[-1]:
        axis.set_xlabel("time for all texels")
    _head(figure, drawn, curves, machine)
    written = []
    kinds: dict[str, dict[str, Any]] = {
        ".png": {"dpi": 100, "pil_kwargs": {"optimize": True}}, ".svg": {"metadata": {"Date": None}},
    }
    for suffix, more in kinds.items():
        written.append(out.with_suffix(suffix))
        with rc_context({"svg.fonttype": "none"}):  # letters stay letters: smaller, and they can be searched
            figure.savefig(written[-1], facecolor="white", **more)
    return written


def _curve(axis: Axes, curve: dict[str, Any], key: str) -> Any:
    points = curve["points"]
    style = {"linewidth": 1.5, "markersize": 5, **STYLES.get(curve["method"], PLAIN)}
    x, y = [p["seconds"] for p in points], [max(p[key], FLOOR) for p in points]
    line, = axis.plot(x, y, label=curve["label"], **style)
    for i in (i for i, p in enumerate(points) if p["default"]):
        axis.plot(x[i], y[i], marker="o", markersize=12, markerfacecolor="none", markeredgecolor=style["color"],
                  markeredgewidth=1.6, zorder=7)
        right = LABELS[curve["method"]]
        axis.annotate(curve["label"], (x[i], y[i]), xytext=(10 if right else -10, 5), textcoords="offset points",
                      ha="left" if right else "right", color=style["color"], fontsize=9.5, fontweight="bold", zorder=8,
                      bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.5})
    return line


def _before(axis: Axes, curve: dict[str, Any], key: str) -> Any:
    style = {**STYLES[curve["method"]], "color": "#b8b8b8", "linewidth": 2.0, "markersize": 4, "zorder": 1}
    line, = axis.plot([p["seconds"] for p in curve["points"]], [max(p[key], FLOOR) for p in curve["points"]], **style)
    return line


def _dress(axis: Axes, title: str) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    low, high = axis.get_ylim()
    low = max(low, 0.6 * FLOOR)
    axis.set_ylim(low, high)
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0,) if high / low > 100 else (1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0e}" if value < 1e-4 else f"{value:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.set_title(title, fontsize=10, loc="left")
    axis.xaxis.set_major_locator(LogLocator(numticks=12))
    axis.xaxis.set_major_formatter(FuncFormatter(_duration))
    axis.grid(True, which="major", color="#dddddd", linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=9, labelbottom=True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def _duration(seconds: float, _: object) -> str:
    return f"{seconds * 1e3:g} ms" if seconds < 0.999 else f"{seconds:g} s"


def _head(figure: Any, drawn: dict[str, Any], curves: Sequence[dict[str, Any]], machine: dict[str, str]) -> None:
    height = figure.get_figheight()
    size = curves[0]["problem"]["size"]
    figure.suptitle(f"Error against time, {size} x {size} texels", x=0.02, y=1 - 0.12 / height, ha="left",
                    va="top", fontsize=14, fontweight="bold")
    told = (f"{machine['cpu']}; OpenGL: {machine['gl']}; {machine['packages']}\n"
            f"commit {machine['commit']}, {machine['date']}.  Thick: IRPSO; ring: as it comes.")
    figure.text(0.02, 1 - 0.42 / height, told, ha="left", va="top", fontsize=8.5, color="#444444")
    figure.legend(drawn.values(), drawn.keys(), loc="upper left", bbox_to_anchor=(0.01, 1 - 0.74 / height), ncols=4,
                  fontsize=9, frameon=False, handlelength=2.8, columnspacing=1.4)
    figure.tight_layout(rect=(0, 0, 1, 1 - 1.36 / height), h_pad=1.2)
