"""What prediction by left-out lamps foresaw beside what the held-out lamps show, and what ``auto`` took by it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from irpso_addon.core.data import F64, PredictionError
from irpso_addon.core.models import LADDER
from irpso_addon.gpu.solve.model_prediction import DRAWN, DRAWN_LEVEL, DRAWN_METAL, FITTED, UNIFORM, UNIFORM_METAL

from .judge import Judgement
from .picture import COLOURS
from .run import AUTO, KINDS, Material
from .words import SCENES, table, wrapped

LAMBERT = "lambert"
UNITS: dict[str, Callable[[PredictionError], float]] = {
    "relative RMS of radiance": lambda e: e.relative_rms, "RMS of L*": lambda e: e.lightness}
ERRORS: dict[str, Callable[[Judgement], float]] = {
    "display": lambda j: j.display, "relative": lambda j: j.relative,
    "relative RMS": lambda j: j.as_predicted.relative_rms, "RMS of L*": lambda j: j.as_predicted.lightness}
MARKS = ("o", "^")  # sphere, cow
NARROW = 0.1  # Beckmann's m: highlights below it are narrow
CLEARLY = 1.05  # times the other's error: less is not worth a word
MIDDLE = 5, 50, 95  # percentiles: the median, and the range of 90 %
# What ``auto`` may take, from the smallest on, and the rung that it is.
TRIALS = {LAMBERT: LAMBERT,
          **{trial.name: trial.model for trial in (*UNIFORM, UNIFORM_METAL, *DRAWN, *DRAWN_LEVEL, *DRAWN_METAL)},
          **{name: rung for rung, name in FITTED.items()}}


@dataclass(frozen=True)
class Foreseen:
    """One material in one scene."""

    material: Material
    scene: str
    predicted: PredictionError
    true: PredictionError

    def ratio(self, unit: str) -> float:
        """True error over the predicted one."""
        return UNITS[unit](self.true) / UNITS[unit](self.predicted)


def foreseen(materials: Sequence[Material], what: str, scenes: Sequence[str] = SCENES) -> list[Foreseen]:
    """All cases of AUTO or of LAMBERT where lamps could be left out."""
    return [Foreseen(m, scene, m.predictions[scene].error if what == AUTO else m.predictions[scene].tried[LAMBERT],
                     m.errors[f"{scene}: {what}"].as_predicted)
            for m in materials for scene in scenes if scene in m.predictions]


def chart(materials: Sequence[Material], out: Path) -> None:
    """Predicted against true error: what was taken above, Lambert below."""
    figure = Figure(figsize=(11, 9.4), layout="constrained")
    FigureCanvasAgg(figure)  # no window, whatever the machine
    axes = figure.subplots(2, 2)
    for row, what in zip(axes, (AUTO, LAMBERT), strict=True):
        for axis, unit in zip(row, UNITS, strict=True):
            _panel(axis, foreseen(materials, what), what, unit)
    for column, unit in zip(axes.T, UNITS, strict=True):  # Lambert and auto on the same scale
        both = [*foreseen(materials, AUTO), *foreseen(materials, LAMBERT)]
        values = [UNITS[unit](error) for case in both for error in (case.predicted, case.true)]
        ends = 0.85 * min(values), 1.18 * max(values)
        for axis in column:
            axis.plot(ends, ends, color="#777777", linewidth=1, zorder=0)
            for times in (0.5, 2.0):
                axis.plot(ends, [times * end for end in ends], ":", color="#999999", linewidth=1, zorder=0)
            axis.set(xlim=ends, ylim=ends)
    kinds = [Line2D([], [], linestyle="", marker="o", color=colour, label=kind)
             for kind, colour in zip(KINDS, COLOURS, strict=True)]
    marks = [Line2D([], [], linestyle="", marker=MARKS[i // 2], color="#555555", label=scene,
                    markerfacecolor="none" if i % 2 else "#555555") for i, scene in enumerate(SCENES)]
    figure.legend(handles=[*kinds, *marks], loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    figure.savefig(out, dpi=90, pil_kwargs={"optimize": True})


def _panel(axis: Axes, cases: Sequence[Foreseen], what: str, unit: str) -> None:
    colours = dict(zip(KINDS, COLOURS, strict=True))
    for number, scene in enumerate(SCENES):
        of = [case for case in cases if case.scene == scene]
        edges = [colours[case.material.kind] for case in of]
        noisy = number % 2 == 1  # nearly where it is without noise: a ring about that
        axis.scatter([UNITS[unit](case.predicted) for case in of], [UNITS[unit](case.true) for case in of],
                     s=45 if noisy else 14, marker=MARKS[number // 2], edgecolors=edges,
                     facecolors="none" if noisy else edges, linewidths=0.7, alpha=0.8)
    axis.set(xscale="log", yscale="log", xlabel=f"predicted {unit}", ylabel=f"true {unit}",
             title=f"{'what auto took' if what == AUTO else 'Lambert'}: {unit}")
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_formatter("{x:g}")
    axis.set_aspect("equal")
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, which="both")


def text(materials: Sequence[Material]) -> str:
    """The page's part about it, with tables."""
    return "\n".join([_taken(materials), SAID_OF_CHART, _ratios(materials), _said_of_ratios(materials),
                      _worse(materials)])


def _taken(materials: Sequence[Material]) -> str:
    rows = []
    for name, rung in TRIALS.items():
        counts = [sum(m.predictions[s].taken == name for m in materials if s in m.predictions) for s in SCENES]
        if any(counts):
            rows.append([name, rung, *map(str, counts)])
    none = [sum(s not in m.predictions for m in materials) for s in SCENES]
    if any(none):
        rows.append(["no prediction", "", *map(str, none)])
    return TAKEN + table(["taken", "rung", *SCENES], rows)


def _ratios(materials: Sequence[Material]) -> str:
    """True over predicted error, by scene."""
    rows = []
    for unit in UNITS:
        for what in (AUTO, LAMBERT):
            for scene in SCENES:
                cases = foreseen(materials, what, (scene,))
                if cases:
                    rows.append([unit, what, scene, *_spread(cases, unit)])
    return table(["error", "maps", "scene", "true / predicted: median", "90 % range", "rank correlation"], rows)


def _spread(cases: Sequence[Foreseen], unit: str) -> list[str]:
    low, middle, high = np.percentile([case.ratio(unit) for case in cases], MIDDLE)
    pair = [np.array([UNITS[unit](e) for e in side]) for side in
            ([case.predicted for case in cases], [case.true for case in cases])]
    alike = f"{np.corrcoef(_ranks(pair[0]), _ranks(pair[1]))[0, 1]:.2f}" if len(cases) > 2 else ""
    return [f"{middle:.2f}", f"{low:.2f} to {high:.2f}", alike]


def _ranks(values: F64) -> F64:
    """Spearman's; ties do not occur."""
    return np.asarray(np.argsort(np.argsort(values)), np.float64)


def _said_of_ratios(materials: Sequence[Material]) -> str:
    narrow = [m for m in materials if "Low E2" in m.published and m.published["Low E2"].m < NARROW]
    wide = [m for m in materials if m not in narrow]

    def over(of: Sequence[Material], what: str, unit: str) -> str:
        cases = foreseen(of, what)
        if not cases:
            return "none"
        low, middle, high = np.percentile([case.ratio(unit) for case in cases], MIDDLE)
        return f"{middle:.2f} ({low:.2f} to {high:.2f})"

    radiance, light = UNITS
    furthest: dict[str, Foreseen] = {}  # by material
    for case in sorted(foreseen(materials, AUTO), key=lambda case: -case.ratio(radiance)):
        furthest.setdefault(case.material.name, case)
    named = ", ".join(
        f"{name} on the {case.scene} ({UNITS[radiance](case.true):.2f} where {UNITS[radiance](case.predicted):.3f} was "
        f"predicted)" for name, case in list(furthest.items())[:3])
    alone = [sum(m.largest.get(scene, 0.0) > 0.5 for m in materials) for scene in SCENES[::2]]
    return "\n" + wrapped(f"""
All scenes together, the true error is so many times the predicted one (median, and the range of 90 %): relative RMS
{over(materials, AUTO, radiance)} for what `auto` took and {over(materials, LAMBERT, radiance)} for Lambert; L*
{over(materials, AUTO, light)} and {over(materials, LAMBERT, light)}. The relative RMS of what `auto` took is
{over(wide, AUTO, radiance)} times what was predicted for the {len(wide)} materials with a wide highlight (m at least
{NARROW} by Low E2), {over(narrow, AUTO, radiance)} times for the {len(narrow)} with a narrow one. Few texels meet a
narrow peak: of {alone[0]} materials on the sphere and of {alone[1]} on the cow a single observation makes up more than
half of the sum of squared radiances. Their relative RMS hangs on it, and the lamps left out cannot tell what the
held-out ones meet. L* is foreseen better. Furthest above the line by relative RMS: {named}.""") + "\n"


# ---- whether another rung would have been better


@dataclass(frozen=True)
class Beside:
    """``auto`` beside another rung's maps."""

    material: Material
    scene: str
    ratio: float  # of errors


def smaller(material: Material, scene: str) -> list[str]:
    """Rungs below the one that was taken whose maps were solved for."""
    taken = LADDER.index(material.uniform[f"{scene}: {AUTO}"].model)
    return [rung for rung in LADDER[:taken] if f"{scene}: {rung}" in material.errors]


def every(material: Material, scene: str) -> list[str]:
    """All rungs whose maps were solved for."""
    return [rung for rung in LADDER if f"{scene}: {rung}" in material.errors]


def beside(
    materials: Sequence[Material], error: Callable[[Judgement], float], rungs: Callable[[Material, str], Sequence[str]],
) -> list[Beside]:
    """The error of ``auto`` over that of the best of some rungs, where there are any."""
    result = []
    for m in materials:
        for scene in SCENES:
            others = [error(m.errors[f"{scene}: {rung}"]) for rung in rungs(m, scene)] if scene in m.predictions else []
            if others:
                result.append(Beside(m, scene, error(m.errors[f"{scene}: {AUTO}"]) / min(others)))
    return result


def _worse(materials: Sequence[Material]) -> str:
    kinds: dict[str, Callable[[Material, str], Sequence[str]]] = {
        "Lambert": lambda m, scene: smaller(m, scene)[:1], "the best smaller rung": smaller, "the best rung": every}
    rows, said = [], []
    for what, rungs in kinds.items():
        for name, error in ERRORS.items():
            cases = beside(materials, error, rungs)
            if not cases:
                continue
            clearly = [case for case in cases if case.ratio > CLEARLY]
            if what == "Lambert":
                names = ", ".join(sorted({case.material.name for case in clearly}))
                said.append(f"{len(clearly)} of {len(cases)} by {name} error" + (f" ({names})" if names else ""))
            most = max(cases, key=lambda case: case.ratio)
            rows.append([what, name, str(len(cases)), str(sum(case.ratio > 1 for case in cases)), str(len(clearly)),
                         f"{most.material.name}, {most.scene}: {most.ratio:.2f} times" if most.ratio > 1 else "none"])
    percent = f"{100 * (CLEARLY - 1):g} %"
    return wrapped(WORSE.format(said="; ".join(said), clearly=percent)) + "\n\n" + table(
        ["beside", "error", "cases", "auto is worse", f"by more than {percent}", "most"], rows)


TAKEN = """How often `auto` took what. *One value*: all texels of the material share the roughness (and level, and
Metallic). *Prior*: each texel has its own roughness, drawn to the material's so strongly (nats a squared log ratio).
*A value a texel* and *two lobes* without a prior are what the evidence inside the fit preferred.

"""

SAID_OF_CHART = """
![Predicted against true errors](measured-foreseen.png)

Each point is a material in a scene; on the line the prediction is right, on the dotted ones the truth is half or twice
as large. Predicted: what the folds foresaw when a third of the lamps was left out. True: what the delivered maps show
under the held-out lamps, half of them with a camera that saw nothing before. Both in the unit of the folds: the square
root of the sum of squared errors of radiance over that of squared radiances; and root mean square errors of L* in each
channel, white being the 99.5th percentile of the radiances observed. Each observation counts alike, unlike in the
display error, which weighs texels as the picture shows them. A relative RMS near 1 says that the brightest peaks are
missed: they make up nearly all of the squares where a highlight is narrow.
"""

WORSE = """Is `auto` ever worse than Lambert, or than a smaller rung? Of all materials and scenes where it took a larger
rung than Lambert, its error under the held-out lamps is larger than Lambert's by more than {clearly} in: {said}. The
table has all rungs. Their maps are those solved for when they are asked for, a value a texel; the best of them is
picked by the truth, for each error anew, which no method can do. "The best smaller rung" is among those below the one
that was taken."""
