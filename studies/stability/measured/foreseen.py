"""What prediction by left-out lamps foresaw beside what the held-out lamps show, and what ``auto`` took by it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from irpso_addon.core.change_records import PredictionError
from irpso_addon.core.data import F64
from irpso_addon.core.models import LADDER
from studies import pages

from .judge import Judgement
from .picture import COLOURS
from .run import AUTO, KINDS, Material
from .words import SCENES, wrapped

LAMBERT = "lambert"
UNITS: dict[str, Callable[[PredictionError], float]] = {
    "relative RMS of radiance": lambda e: e.relative_rms, "RMS of L*": lambda e: e.lightness}
ERRORS: dict[str, Callable[[Judgement], float]] = {
    "display": lambda j: j.display, "relative": lambda j: j.relative,
    "relative RMS": lambda j: j.as_predicted.relative_rms, "RMS of L*": lambda j: j.as_predicted.lightness}
Table = tuple[Sequence[str], Sequence[Sequence[str]]]  # head and rows
MARKS = ("o", "^")  # sphere, cow
NARROW = 0.1  # Beckmann's m: highlights below it are narrow
CLEARLY = 1.05  # times the other's error: less is not worth a word
MIDDLE = 5, 50, 95  # percentiles: the median, and the range of 90 %
# What candidates may have beside, as their names say it.
BESIDE = {"coat": "of these with a coat", "base color": "base colours drawn to the material's",
          "settled": "values settled by prediction", "rough diffuse": "a rough diffuse"}
SUFFIXES = ", one base color", ", base color prior", ", settled"


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


def taken(materials: Sequence[Material]) -> str:
    """How often ``auto`` took what, as a table: candidates, and of these what has something beside."""
    found = {s: [m.predictions[s].taken if s in m.predictions else "no prediction" for m in materials] for s in SCENES}
    plain = {s: Counter(_plain(name) for name in names) for s, names in found.items()}
    total = sum(plain.values(), Counter())
    rows = [[name, *(str(plain[s][name]) for s in SCENES)] for name, _ in total.most_common()]
    rows += [[f"*{words}*", *(str(sum(part in name for name in found[s])) for s in SCENES)]
             for part, words in BESIDE.items() if any(part in name for names in found.values() for name in names)]
    return pages.table(["taken", *SCENES], rows)


def _plain(name: str) -> str:
    """A candidate's name without what it has beside."""
    return next((name[:name.index(part)] for part in SUFFIXES if part in name), name)


def ratios(materials: Sequence[Material]) -> Table:
    """True over predicted error, by scene."""
    rows = []
    for unit in UNITS:
        for what in (AUTO, LAMBERT):
            for scene in SCENES:
                cases = foreseen(materials, what, (scene,))
                if cases:
                    rows.append([unit, what, scene, *_spread(cases, unit)])
    return ["error", "maps", "scene", "true / predicted: median", "90 % range", "rank correlation"], rows


def _spread(cases: Sequence[Foreseen], unit: str) -> list[str]:
    low, middle, high = np.percentile([case.ratio(unit) for case in cases], MIDDLE)
    pair = [np.array([UNITS[unit](e) for e in side]) for side in
            ([case.predicted for case in cases], [case.true for case in cases])]
    alike = f"{np.corrcoef(_ranks(pair[0]), _ranks(pair[1]))[0, 1]:.2f}" if len(cases) > 2 else ""
    return [f"{middle:.2f}", f"{low:.2f} to {high:.2f}", alike]


def _ranks(values: F64) -> F64:
    """Spearman's; ties do not occur."""
    return np.asarray(np.argsort(np.argsort(values)), np.float64)


def said_of_ratios(materials: Sequence[Material]) -> str:
    """What the table of ratios amounts to."""
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
    return wrapped(f"""
Over all scenes the ratio of the true to the predicted error is (median, and the range of 90 %): relative RMS
{over(materials, AUTO, radiance)} for what `auto` took and {over(materials, LAMBERT, radiance)} for Lambert; L*
{over(materials, AUTO, light)} and {over(materials, LAMBERT, light)}. The relative RMS of what `auto` took is
{over(wide, AUTO, radiance)} times what was predicted for the {len(wide)} materials with a wide highlight (m at least
{NARROW} by Low E2), {over(narrow, AUTO, radiance)} times for the {len(narrow)} with a narrow one. Few texels show a
narrow peak: for {alone[0]} materials on the sphere and for {alone[1]} on the cow a single observation makes up more
than half of the sum of squared radiances. Their relative RMS depends on it, and the lamps that are left out do not show
what the held-out lamps meet. The prediction of L* is better. The cases furthest above the line by relative RMS:
{named}.""")


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


def said_of_rungs(materials: Sequence[Material]) -> str:
    """Whether another rung would have been better."""
    said = "; ".join(beside_rungs(materials)[1])
    return wrapped(WORSE.format(said=said, clearly=f"{100 * (CLEARLY - 1):g} %"))


def beside_rungs(materials: Sequence[Material]) -> tuple[Table, list[str]]:
    """``auto`` beside Lambert, the best smaller rung and the best rung, and the first of them in words."""
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
    return (["beside", "error", "cases", "auto is worse", f"by more than {percent}", "most"], rows), said


WORSE = """`auto` can be worse than Lambert, or than a smaller rung. Of all materials and scenes where it took a larger
rung than Lambert, its error under the held-out lamps is larger than Lambert's by more than {clearly} in: {said}.
[measured-rungs.csv](measured-rungs.csv) has all rungs. Their maps have a value per texel, as when a user asks for the
model. The truth picks the best of them for each error separately, which no method can do. "The best smaller rung" is
one below the rung that `auto` took."""
