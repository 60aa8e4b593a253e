"""The page: what was measured, in tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from irpso_addon.core.phrases import percent
from studies import pages

from . import fit, foreseen
from .foreseen import NARROW
from .judge import Judgement
from .picture import best_published
from .run import AUTO, KINDS, LEVEL, LOSS_MODELS, METALLIC, NOISE, PUBLISHED, SOLVES, Material
from .words import FIRST, SCENES, wrapped

WANTED = {"display": 95, "relative": 85}  # of 100 materials: at or below the best published fit
NEAR = 1.1  # times the best published fit's error
Error = Callable[[Judgement], float]
Table = tuple[Sequence[str], Sequence[Sequence[str]]]  # head and rows
DISPLAY: Error = lambda j: j.display  # noqa: E731
RELATIVE: Error = lambda j: j.relative  # noqa: E731
REFITTED = ("cook-torrance: relative",)
DISPLAY_AGAINST = {**{name: (name,) for name in PUBLISHED}, "best": PUBLISHED, "refitted": REFITTED}
RELATIVE_AGAINST = {"Low E1": PUBLISHED[:1], "Low E2": PUBLISHED[1:2], "best": PUBLISHED}


def write(materials: Sequence[Material], renderer: str, page: Path) -> None:
    """The figures of the page, and the full tables beside it."""
    by_method = _by_method(materials)
    pages.fill(pages.DOCS / "stability" / "measured.md", {
        "made": pages.measured(renderer), "verdict": _verdict(materials), "short": _short(materials),
        "taken": foreseen.taken(materials), "foreseen": foreseen.said_of_ratios(materials),
        "rungs": foreseen.said_of_rungs(materials),
        "methods": pages.table(["method", *_heads()], [row[1:] for row in by_method if row[0] == FIRST]),
        "kinds": _by_kind(materials), "losses": _by_loss(materials), "said": _said_of_losses(materials)}, page)
    full: dict[str, Table] = {
        "foreseen": foreseen.ratios(materials), "rungs": foreseen.beside_rungs(materials)[0],
        "methods": (["scene", "method", *_heads()], by_method), "losses": _widths(materials),
        "materials": _numbers(materials), "errors": _errors(materials)}
    for name, (head, rows) in full.items():
        pages.write_csv(page.with_name(f"measured-{name}.csv"), head,
                        [[cell.replace("**", "") for cell in row] for row in rows])


def at_or_below(materials: Sequence[Material], scene: str, method: str, others: Sequence[str], error: Error) -> str:
    """How many materials a method relights no worse than the best of some others that know them."""
    hits = total = 0
    for m in materials:
        limits = [error(m.errors[f"{scene}: {n}"]) for n in others if f"{scene}: {n}" in m.errors]
        if limits:
            total += 1
            hits += error(m.errors[f"{scene}: {method}"]) <= min(limits)
    if not total:
        return ""
    return f"{hits}" if total == len(materials) else f"{hits} of {total}"


def _verdict(materials: Sequence[Material]) -> str:
    rows = []
    for scene in SCENES:
        for name, error in (("display", DISPLAY), ("relative", RELATIVE)):
            if f"{scene}: {AUTO}" not in materials[0].errors:
                continue
            counts = [at_or_below(materials, scene, AUTO, against, error) for against in RELATIVE_AGAINST.values()]
            wanted = WANTED[name] * len(materials) / 100
            near = sum(error(m.errors[f"{scene}: {AUTO}"]) <= NEAR * _best(m, scene, error) for m in materials)
            rows.append([scene, name, *counts, f"{wanted:g}", "met" if int(counts[-1]) >= wanted else "**below**",
                         f"{near}"])
    return pages.table(["maps of `auto`", "error", *(f"≤ {n}" for n in RELATIVE_AGAINST), "wanted", "",
                        f"at most {percent(NEAR - 1)} above the best"], rows)


def _best(material: Material, scene: str, error: Error) -> float:
    """The least error of the published fits."""
    return min(error(material.errors[f"{scene}: {name}"]) for name in material.published)


def _row(materials: Sequence[Material], scene: str, method: str) -> list[str]:
    of = [m for m in materials if f"{scene}: {method}" in m.errors]
    told = []
    for error, against in ((DISPLAY, DISPLAY_AGAINST), (RELATIVE, RELATIVE_AGAINST)):
        told.append(f"{np.median([error(m.errors[f'{scene}: {method}']) for m in of]):.3f}")
        told += [at_or_below(of, scene, method, others, error) for others in against.values()]
    return told


def _heads() -> list[str]:
    return ["display error (median)", *(f"display ≤ {name}" for name in DISPLAY_AGAINST),
            "relative error (median)", *(f"relative ≤ {name}" for name in RELATIVE_AGAINST)]


def _by_method(materials: Sequence[Material]) -> list[list[str]]:
    """Of all scenes, which are the first column."""
    rows = []
    for scene in SCENES:
        for solve in SOLVES:
            if f"{scene}: {solve.name}" not in materials[0].errors:
                continue
            label = f"{solve.model}, loss robust" if solve.loss == "robust" else solve.name
            if solve.name == AUTO:
                label = f"**{AUTO}**"
            rows.append([scene, f"{label}: maps", *_row(materials, scene, solve.name)])
            if scene == FIRST or solve.name == AUTO:
                rows.append([scene, f"{label}: one value", *_row(materials, scene, f"{solve.name}, one value")])
        if f"{scene}: metallic" in materials[0].errors:
            rows.append([scene, "no product: with Metallic, one value", *_row(materials, scene, "metallic")])
        rows += [[scene, name, *_row(materials, scene, name)] for name in PUBLISHED
                 if f"{scene}: {name}" in materials[0].errors]
    return rows


def _by_kind(materials: Sequence[Material]) -> str:
    """Medians of the display error on the sphere without noise, and how often auto is at or below the best."""
    methods = (LEVEL, METALLIC, AUTO, f"{AUTO}, one value", f"{LEVEL}: relative", "metallic", *PUBLISHED[:2])
    rows = []
    for kind in KINDS:
        of = [m for m in materials if m.kind == kind]
        if of:
            rungs = [m.uniform[f"{FIRST}: {AUTO}"].model for m in of]
            rows.append([kind, f"{len(of)}", *(f"{np.median([m.display(n) for m in of]):.3f}" for n in methods),
                         *(at_or_below(of, FIRST, AUTO, PUBLISHED, error) for error in (DISPLAY, RELATIVE)),
                         f"{rungs.count(METALLIC)}"])
    return pages.table(["kind", "materials", f"{LEVEL}: maps", f"{METALLIC}: maps", f"**{AUTO}**: maps",
                  f"{AUTO}: one value", "joint fit", "joint, with Metallic", *PUBLISHED[:2],
                  f"{AUTO} maps ≤ best (display)", "(relative)", f"{AUTO} took {METALLIC}"], rows)


def _by_loss(materials: Sequence[Material]) -> str:
    rows = []
    for model in LOSS_MODELS:
        for loss in fit.LOSSES:
            name = f"{model}: {loss}"
            best = sum(m.display(name) <= min(m.display(f"{model}: {other}") for other in fit.LOSSES)
                       for m in materials)
            rows.append([model, loss, f"{best}", *_row(materials, FIRST, name)])
    return pages.table(["model", "loss", "best of the five (display)", *_heads()], rows)


def _widths(materials: Sequence[Material]) -> Table:
    """How many times the width of one material's lobe differs between losses."""
    def ratios(pairs: Iterable[tuple[float, float]]) -> list[str]:
        r = np.array([max(a, b) / min(a, b) for a, b in pairs])
        return [f"{np.median(r):.2f}", f"{np.percentile(r, 90):.2f}", f"{percent((r > 2).mean())}"]

    rows = [["published, Low E1 and E2 (m)", *ratios((m.published["Low E1"].m, m.published["Low E2"].m)
                                                     for m in materials if {"Low E1", "Low E2"} <= set(m.published))]]
    for model, what, power in ((LOSS_MODELS[1], "m", 1), (LEVEL, "alpha = roughness²", 2)):
        for a, b in (("squares", "log"), ("squares", "relative"), ("relative", "cube root"), ("relative", "robust")):
            rows.append([f"{model}, {a} and {b} ({what})", *ratios(
                tuple(float(m.fitted[f"{model}: {x}"].shared[0]) ** power for x in (a, b))  # type: ignore[misc]
                for m in materials)])
    for name, scene in (("", FIRST), (f" at {100 * NOISE:g} % noise", SCENES[1])):
        rows.append([f"{LEVEL}, relative and the maps' one value{name} (alpha)", *ratios(
            (float(m.fitted[f"{LEVEL}: relative"].shared[0]) ** 2, float(m.uniform[f"{scene}: {LEVEL}"].roughness) ** 2)
            for m in materials)])
    return ["between", "median", "90th percentile", "more than 2 times"], rows


def _said_of_losses(materials: Sequence[Material]) -> str:
    def count(name: str, error: Error) -> str:
        return at_or_below(materials, FIRST, name, PUBLISHED, error)

    def mean(name: str) -> str:
        return f"{np.mean([m.display(name) for m in materials]):.3f}"

    by = {loss: mean(f"{LEVEL}: {loss}") for loss in fit.LOSSES}
    classic = LOSS_MODELS[1]
    return wrapped(f"""
The loss decides more than the model which picture looks better. Squares and log put all their weight into the peak and
miss the body of dark, shiny materials: mean display error {by["squares"]} and {by["log"]}, against {by["relative"]} by
the product's relative squares and {by["robust"]} by the robust ones. The same holds for Cook-Torrance with colour in
its highlight: {mean(f"{classic}: squares")} by squares, {mean(f"{classic}: relative")} by relative squares,
{mean("Low E2")} as published (Low E2). By relative error, which clips nothing, the order is reversed: of
{len(materials)} materials, relative squares are at or below the best published fit for
{count(f"{LEVEL}: relative", RELATIVE)}, squares for {count(f"{LEVEL}: squares", RELATIVE)}. The cube root is good for
both: {count(f"{LEVEL}: cube root", DISPLAY)} by display error, {count(f"{LEVEL}: cube root", RELATIVE)} by relative
error.""")


def _short(materials: Sequence[Material]) -> str:
    def lost(of: Sequence[Material]) -> int:
        return sum(m.errors[f"{FIRST}: {AUTO}"].relative > _best(m, FIRST, RELATIVE) for m in of)

    def named(of: Sequence[Material], error: Error, other: Callable[[Material], float]) -> str:
        told = [f"{m.name} ({error(m.errors[f'{FIRST}: {AUTO}']):.3f} for {other(m):.3f})" for m in of]
        return ", ".join(told) or "none"

    def joint(m: Material) -> float:
        return m.display(f"{LEVEL}: relative")

    worse = {}
    for error in (DISPLAY, RELATIVE):
        rank = [(error(m.errors[f"{FIRST}: {AUTO}"]) / _best(m, FIRST, error), m) for m in materials]
        worse[error] = [m for ratio, m in sorted(rank, key=lambda r: -r[0]) if ratio > 1]
    apart = sorted((m for m in materials if m.display(AUTO) > 1.5 * joint(m)), key=lambda m: joint(m) / m.display(AUTO))
    narrow = [m for m in materials if m.published["Low E2"].m < NARROW]
    wide = [m for m in materials if m not in narrow]
    counts = [at_or_below(materials, FIRST, n, PUBLISHED, DISPLAY) for n in ("metallic", f"{LEVEL}: relative")]
    refit = [at_or_below(materials, FIRST, n, REFITTED, DISPLAY)
             for n in (AUTO, f"{AUTO}, one value", f"{LEVEL}: relative")]
    best = [at_or_below(wide, FIRST, n, PUBLISHED, DISPLAY) or 0 for n in (AUTO, f"{AUTO}, one value")]
    asked = []
    for scene in (s for s in SCENES[::2] if f"{s}: {AUTO}" in materials[0].errors):
        of, auto = (np.array([m.errors[f"{scene}: {n}"].display for m in materials]) for n in (METALLIC, AUTO))
        asked.append(f"{scene}: {(of < auto).sum()} (medians {np.median(of):.3f} and {np.median(auto):.3f})")
    free = sum(m.predictions[FIRST].taken.startswith("a value a texel") for m in materials if FIRST in m.predictions)
    points = f"""* The lead comes from the loss and from the networks. Beside Cook-Torrance refitted by the same loss to
the same
  data (8 numbers), the maps of `auto` are at or below it for {refit[0]} of {len(materials)} materials by display error,
  one value for {refit[1]}, the joint fit of `{LEVEL}` for {refit[2]}. Of the {len(wide)} materials whose highlight
  is wide (m at least {NARROW} by Low E2), so that a network is close to the measurement, the maps are at or below the
  best published fit for {best[0]}, one value for {best[1]}.
* Materials relit worse than by the best published fit, by display error: {len(worse[DISPLAY])} of {len(materials)}:
  {named(worse[DISPLAY], DISPLAY, best_published)}. By relative error {len(worse[RELATIVE])}, the worst first:
  {named(worse[RELATIVE][:8], RELATIVE, lambda m: _best(m, FIRST, RELATIVE))}; {lost(narrow)} of the {len(narrow)}
  materials with a narrow highlight and {lost(wide)} of the other {len(wide)}.
* Prediction does not always take the best rung. `{METALLIC}`, if a user asks for it, has a smaller display error than
`auto` for this many materials: {'; '.join(asked)}.
* The joint fits in float64 with Metallic are at or below the best published fit for {counts[0]} by display error,
  without it for {counts[1]}.
* The search uses the mean of the channels. If no lobe is quite right, a channel of base colour may come out below 0 and
  is clipped. A joint fit of all channels avoids that. Display errors of the joint fit of `{LEVEL}` that are less than
  two thirds of the maps': {len(apart)}; {named(apart[:4], DISPLAY, joint)}.
* If prediction took a value per texel ({free} materials), the maps of one material have several values. Far from
highlights a texel takes the lobe, usually a rougher one, that explains the model's error there. Its standard error does
not show this, because that error is not noise. The one value is therefore taken from the texels nearest to
highlights."""
    return "On the sphere without noise:\n\n" + "\n".join(
        wrapped(f"* {point}", "  ") for point in f"\n{points}".split("\n* ")[1:])


def _numbers(materials: Sequence[Material]) -> Table:
    rows = []
    for m in materials:
        one, joint = m.uniform[f"{FIRST}: {AUTO}"], m.fitted[f"{LEVEL}: relative"]
        diffuse = m.published["Low E2"].diffuse if "Low E2" in m.published else np.full(3, np.nan)
        lobe = [f"{one.roughness:.2f}", f"{one.level:.2f}"] if one.model != "lambert" else ["", ""]
        rows.append([m.name, m.kind, m.predictions[FIRST].taken if FIRST in m.predictions else one.model,
                     _colour(one.base), _colour(joint.by_channel[0]), _colour(diffuse), *lobe,
                     f"{one.metallic:.2f}" if one.metallic > 0 else "",
                     *(f"{m.fitted[f'{LEVEL}: {loss}'].shared[0]:.2f}" for loss in fit.LOSSES),
                     *(f"{m.published[n].roughness:.2f}" if n in m.published else "" for n in PUBLISHED)])
    return ["material", "kind", "auto took", "base colour: auto", "base colour: joint", "kd Low E2", "roughness: auto",
            "level", "metallic", *(f"roughness: {name}" for name in (*fit.LOSSES, *PUBLISHED))], rows


def _errors(materials: Sequence[Material]) -> Table:
    rows = []
    for m in materials:
        contest = {AUTO: m.display(AUTO), **{n: m.display(n) for n in m.published}}
        winner = min(contest, key=lambda n: contest[n])
        rows.append([m.name, *(f"{m.display(n):.3f}" for n in (
            AUTO, f"{AUTO}, one value", LEVEL, METALLIC, *(f"{LEVEL}: {loss}" for loss in fit.LOSSES), "metallic")),
            *(f"{m.display(n):.3f}" if n in m.published else "" for n in PUBLISHED),
            *(f"{m.errors[f'{FIRST}: {n}'].relative:.2f}" if f"{FIRST}: {n}" in m.errors else ""
              for n in (AUTO, *PUBLISHED)),
            winner if winner in m.published else f"**{AUTO}**"])
    return ["material", f"{AUTO}: maps", f"{AUTO}: one value", f"{LEVEL}: maps", f"{METALLIC}: maps", *fit.LOSSES,
            "with Metallic", *PUBLISHED, f"relative: {AUTO}", *(f"relative: {n}" for n in PUBLISHED), "winner"], rows


def _colour(rgb: np.ndarray) -> str:
    return " ".join(f"{c:.2f}" for c in rgb)
