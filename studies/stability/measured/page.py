"""The page: what was measured, in tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from . import fit, rig
from .judge import Judgement
from .picture import best_published
from .run import KINDS, LOSS_MODELS, MAPS, NOISE, PUBLISHED, SOLVES, SPHERE, Material

WANTED = 80
NARROW = 0.1  # Beckmann's m
FIRST = "sphere, no noise"
SCENES = (FIRST, f"sphere, {100 * NOISE:g} % noise", "cow, no noise", f"cow, {100 * NOISE:g} % noise")
Error = Callable[[Judgement], float]
DISPLAY: Error = lambda j: j.display  # noqa: E731
RELATIVE: Error = lambda j: j.relative  # noqa: E731
REFITTED = ("cook-torrance: relative",)
DISPLAY_AGAINST = {**{name: (name,) for name in PUBLISHED}, "best": PUBLISHED, "refitted": REFITTED}
RELATIVE_AGAINST = {"Low E1": PUBLISHED[:1], "Low E2": PUBLISHED[1:2], "best": PUBLISHED}


def page(materials: Sequence[Material], renderer: str, seconds: float) -> str:
    """The whole text."""
    head = HEAD.format(command="python -m studies.stability.measured --data DIR --cow OBJ", renderer=renderer,
                       minutes=seconds / 60, count=len(materials), texels=f"{SPHERE} x {SPHERE}", lamps=rig.LAMPS,
                       held_out=rig.HELD_OUT_LAMPS)
    parts = [head, _verdict(materials), PICTURES, "## By model\n", METHODS, _by_method(materials),
             "\n## By kind of material\n", _by_kind(materials), "\n## By loss\n", LOSSES, _by_loss(materials),
             _said_of_losses(materials), _roughness(materials), "\n## What falls short\n", _short(materials),
             "\n## All materials\n", COLUMNS, _numbers(materials), "", ERRORS, _errors(materials)]
    return "\n".join(parts) + "\n"


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
    for method in (MAPS, f"{MAPS}, one value", "auto", "auto, one value"):
        for name, error in (("display", DISPLAY), ("relative", RELATIVE)):
            counts = [at_or_below(materials, FIRST, method, (source,), error) for source in PUBLISHED[:2]]
            met = min(int(c) for c in counts) >= WANTED * len(materials) / 100
            rows.append([method, name, *counts, at_or_below(materials, FIRST, method, PUBLISHED, error),
                         "met" if met else "**below**"])
    return (f"Wanted: at or below the published Cook-Torrance fits for {WANTED} of 100.\n\n"
            + table(["product, no noise", "error", *PUBLISHED[:2], "best of three", ""], rows))


def _row(materials: Sequence[Material], scene: str, method: str) -> list[str]:
    of = [m for m in materials if f"{scene}: {method}" in m.errors]
    told = []
    for error, against in ((DISPLAY, DISPLAY_AGAINST), (RELATIVE, RELATIVE_AGAINST)):
        told.append(f"{np.median([error(m.errors[f'{scene}: {method}']) for m in of]):.3f}")
        told += [at_or_below(of, scene, method, others, error) for others in against.values()]
    return told


def _heads() -> list[str]:
    return ["display error (median)", *(f"≤ {name}" for name in DISPLAY_AGAINST),
            "relative error (median)", *(f"≤ {name}" for name in RELATIVE_AGAINST)]


def _by_method(materials: Sequence[Material]) -> str:
    rows = []
    for scene in SCENES:
        for solve in SOLVES:
            if f"{scene}: {solve.name}" not in materials[0].errors:
                continue
            label = f"{solve.model}, loss robust" if solve.loss == "robust" else solve.name
            rows += [[scene, f"{label}: {what}", *_row(materials, scene, solve.name + more)]
                     for what, more in (("maps", ""), ("one value", ", one value"))]
        if f"{scene}: metallic" in materials[0].errors:
            rows.append([scene, "no product: with Metallic, one value", *_row(materials, scene, "metallic")])
        rows += [[scene, name, *_row(materials, scene, name)] for name in PUBLISHED
                 if f"{scene}: {name}" in materials[0].errors]
    return table(["scene", "method", *_heads()], rows)


def _by_kind(materials: Sequence[Material]) -> str:
    methods = (MAPS, f"{MAPS}, one value", "auto", f"{MAPS}: relative", "metallic", *PUBLISHED[:2])
    rows = []
    for kind in KINDS:
        of = [m for m in materials if m.kind == kind]
        if of:
            rows.append([kind, f"{len(of)}", *(f"{np.median([m.display(n) for m in of]):.3f}" for n in methods),
                         at_or_below(of, FIRST, MAPS, PUBLISHED, DISPLAY)])
    return table(["kind", "materials", f"{MAPS}: maps", "one value", "auto: maps", "joint fit", "joint, with Metallic",
                  *PUBLISHED[:2], f"{MAPS} maps ≤ best"], rows)


def _by_loss(materials: Sequence[Material]) -> str:
    rows = []
    for model in LOSS_MODELS:
        for loss in fit.LOSSES:
            name = f"{model}: {loss}"
            best = sum(m.display(name) <= min(m.display(f"{model}: {other}") for other in fit.LOSSES)
                       for m in materials)
            rows.append([model, loss, f"{best}", *_row(materials, FIRST, name)])
    return table(["model", "loss", "best of the five (display)", *_heads()], rows)


def _roughness(materials: Sequence[Material]) -> str:
    """How much a material's roughness hangs on the loss."""
    def ratios(pairs: Iterable[tuple[float, float]]) -> list[str]:
        r = np.array([max(a, b) / min(a, b) for a, b in pairs])
        return [f"{np.median(r):.2f}", f"{np.percentile(r, 90):.2f}", f"{(r > 2).mean():.0%}"]

    rows = [["published, Low E1 and E2 (m)", *ratios((m.published["Low E1"].m, m.published["Low E2"].m)
                                                     for m in materials if {"Low E1", "Low E2"} <= set(m.published))]]
    for model, what, power in ((LOSS_MODELS[1], "m", 1), (MAPS, "alpha = roughness²", 2)):
        for a, b in (("squares", "log"), ("squares", "relative"), ("relative", "cube root"), ("relative", "robust")):
            rows.append([f"{model}, {a} and {b} ({what})", *ratios(
                tuple(float(m.fitted[f"{model}: {x}"].shared[0]) ** power for x in (a, b))  # type: ignore[misc]
                for m in materials)])
    for name, scene in (("", FIRST), (f" at {100 * NOISE:g} % noise", SCENES[1])):
        rows.append([f"{MAPS}, relative and the maps' one value{name} (alpha)", *ratios(
            (float(m.fitted[f"{MAPS}: relative"].shared[0]) ** 2, float(m.uniform[f"{scene}: {MAPS}"].roughness) ** 2)
            for m in materials)])
    return "\nHow many times the width of one material's lobe differs:\n\n" + table(
        ["between", "median", "90th percentile", "more than 2 times"], rows)


def _said_of_losses(materials: Sequence[Material]) -> str:
    def count(name: str, error: Error) -> str:
        return at_or_below(materials, FIRST, name, PUBLISHED, error)

    def mean(name: str) -> str:
        return f"{np.mean([m.display(name) for m in materials]):.3f}"

    by = {loss: mean(f"{MAPS}: {loss}") for loss in fit.LOSSES}
    classic = LOSS_MODELS[1]
    return f"""
What looks better is decided by the loss more than by the model. Squares and log put all their weight into the peak and
miss the body of dark, shiny materials: mean display error {by["squares"]} and {by["log"]}, against {by["relative"]} by
the product's relative squares and {by["robust"]} by the robust ones. So it is with Cook-Torrance, colour in its
highlight: {mean(f"{classic}: squares")} by squares, {mean(f"{classic}: relative")} by relative squares,
{mean("Low E2")} as published (Low E2). Where light itself counts (relative error, nothing clipped) it is the other way
round: of {len(materials)} materials, relative squares are at or below the best published fit for
{count(f"{MAPS}: relative", RELATIVE)}, squares for {count(f"{MAPS}: squares", RELATIVE)}. The cube root serves both:
{count(f"{MAPS}: cube root", DISPLAY)} by display error, {count(f"{MAPS}: cube root", RELATIVE)} by relative error."""


def _short(materials: Sequence[Material]) -> str:
    def lost(of: Sequence[Material], method: str) -> int:
        hits = at_or_below(of, FIRST, method, PUBLISHED, RELATIVE)
        return len(of) - int(hits or 0)

    def named(of: Sequence[Material], other: Callable[[Material], float]) -> str:
        return ", ".join(f"{m.name} ({m.display(MAPS):.3f} for {other(m):.3f})" for m in of)

    def joint(m: Material) -> float:
        return m.display(f"{MAPS}: relative")

    worse = sorted((m for m in materials if m.display(MAPS) > best_published(m)),
                   key=lambda m: best_published(m) / m.display(MAPS))
    apart = sorted((m for m in materials if m.display(MAPS) > 1.5 * joint(m)), key=lambda m: joint(m) / m.display(MAPS))
    narrow = [m for m in materials if m.published["Low E2"].m < NARROW]
    wide = [m for m in materials if m not in narrow]
    counts = [at_or_below(materials, FIRST, n, PUBLISHED, DISPLAY) for n in ("metallic", f"{MAPS}: relative")]
    refit = [at_or_below(materials, FIRST, n, REFITTED, DISPLAY)
             for n in (MAPS, f"{MAPS}, one value", f"{MAPS}: relative")]
    best = [at_or_below(wide, FIRST, n, PUBLISHED, DISPLAY) or 0 for n in (MAPS, f"{MAPS}, one value")]
    return f"""* The lead is the loss's, and the networks'. Beside Cook-Torrance refitted by the same loss to the same
  data (8 numbers for 5) the maps are at or below it for {refit[0]} of {len(materials)} materials, one value for
  {refit[1]}, the joint fit for {refit[2]}. And of the {len(wide)} materials whose highlight is wide (m at least
  {NARROW} by Low E2), so that a network is near to the measurement, the maps are at or below the best published fit for
  {best[0]}, one value for {best[1]}.
* The maps of {len(worse)} materials are relit worse than by the best published fit; first
  {named(worse[:5], best_published)}. A dielectric's highlight is white and weak (Specular IOR Level 1 at most). With
  Metallic as one more number, fitted jointly, {counts[0]} of {len(materials)} are at or below the best published fit;
  without it {counts[1]}.
* The search sees the mean of the channels: where no lobe is quite right, a channel of base colour may come out below 0
  and is clipped, which a joint fit of all channels avoids. Its display error is less than two thirds of the maps' for
  {len(apart)}: {named(apart[:4], joint)}.
* Relative error: maps are worse than the best published fit for {lost(narrow, MAPS)} of {len(narrow)} materials with a
  narrow highlight and for {lost(wide, MAPS)} of the other {len(wide)}. They know the peak
  only where a texel saw it.
* The maps of one material are not of one value: far from highlights a texel takes the lobe, usually a rougher one, that
  explains the model's error there, and its standard error does not say so (that error is not noise). Hence the one
  value by the texels nearest to highlights."""


def _numbers(materials: Sequence[Material]) -> str:
    rows = []
    for m in materials:
        one, chosen = m.uniform[f"{FIRST}: {MAPS}"], m.uniform[f"{FIRST}: auto"]
        joint = m.fitted[f"{MAPS}: relative"]
        diffuse = m.published["Low E2"].diffuse if "Low E2" in m.published else np.full(3, np.nan)
        rows.append([m.name, m.kind, _colour(one.base), _colour(joint.by_channel[0]), _colour(diffuse),
                     f"{one.roughness:.2f}",
                     *(f"{m.fitted[f'{MAPS}: {loss}'].shared[0]:.2f}" for loss in fit.LOSSES),
                     *(f"{m.published[n].roughness:.2f}" if n in m.published else "" for n in PUBLISHED),
                     f"{one.level:.2f}", chosen.model])
    return table(["material", "kind", "base colour: one value", "joint", "kd Low E2", "roughness: one value",
                  *fit.LOSSES, *PUBLISHED, "level", "auto took"], rows)


def _errors(materials: Sequence[Material]) -> str:
    rows = []
    for m in materials:
        contest = {MAPS: m.display(MAPS), **{n: m.display(n) for n in m.published}}
        winner = min(contest, key=lambda n: contest[n])
        rows.append([m.name, *(f"{m.display(n):.3f}" for n in (
            MAPS, f"{MAPS}, one value", "auto", *(f"{MAPS}: {loss}" for loss in fit.LOSSES), "metallic")),
            *(f"{m.display(n):.3f}" if n in m.published else "" for n in PUBLISHED),
            f"{m.errors[f'{FIRST}: {MAPS}'].relative:.2f}",
            *(f"{m.errors[f'{FIRST}: {n}'].relative:.2f}" for n in PUBLISHED[:2]),
            winner if winner in m.published else "**product**"])
    return table(["material", "maps", "one value", "auto: maps", *fit.LOSSES, "with Metallic", *PUBLISHED,
                  "relative: maps", *(f"relative: {n}" for n in PUBLISHED[:2]), "winner"], rows)


def _colour(rgb: np.ndarray) -> str:
    return " ".join(f"{c:.2f}" for c in rgb)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """As Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


HEAD = """# Measured materials

Made by `{command}` ({renderer}, {minutes:.1f} minutes of processor time). DIR and OBJ are not in the repository.

{count} materials of the MERL database (Matusik et al. 2003), which nobody made with a shader: what does the product
say of them, and does it look right under other lamps? Beside it stand the Cook-Torrance fits that Ngan et al. 2005 and
Low et al. 2012 (by two losses, E1 and E2) published, each evaluated with its own model (Beckmann's distribution,
V-grooves, its own Fresnel term; colour in the highlight).

**Truth** is a small network per material (Sztrajman et al. 2021), in float64. It is an approximation: sharp peaks are
smoother than in the measurement, to which the published fits were fitted. That is unfair to them where highlights are
narrow; `cook-torrance` below is their model fitted to the same data as ours, which is fair. What is nearly black the
networks do not know well (black-obsidian is red in rings); it counts all the same.

**Scene.** A sphere ({texels} texels, those up to 80° about its front) and a cow, seen by 2 cameras under {lamps} lamps;
an observation is radiance over irradiance, without noise or with 1 %. **Held out** are {held_out} other lamps, from
one of the cameras and from a third. Only texels that are lit and seen (cosines above 0.1) count, as the pictures show
them.

**Display error**: root mean square error of the picture, sRGB-encoded and clipped at white, exposed so that the truth's
95th percentile of luminance is 0.8. **Relative error**: mean absolute error of radiance over its mean; nothing is
clipped, so that highlights weigh as much as their light.

**One value**: a measured material is uniform, so its maps are one value: the medians over the 15 % of texels that came
nearest to a highlight. **Joint fit**: all observations of all texels fitted at once in float64, not by the product.
"""

PICTURES = """
![Fit quality, and roughness by loss](measured.png)

![Spheres under two held-out lamps, from the held-out camera](measured-spheres.jpg)

A dozen spheres by rank, from where the maps do best beside the best published fit (top left, then down) to where they
do worst (bottom right); display errors below.
"""

METHODS = """How many materials are relit no worse than by each published fit (Ngan published 86 of them), and by the
best of them for that material; "refitted" is Low's model fitted to our data by our loss (8 numbers, colour in the
highlight). The sphere's first rows are the models of the model ladder; `auto` is the default.
"""

LOSSES = """The same observations, one value, by the loss that is minimised. relative: the product's, squares over the
larger of the observation and the typical one; squares, log (ln(1 + f cos_l)) and cube root of f cos_l; robust: the
product's through Cauchy's function.
"""

COLUMNS = """Roughness is the node's, sqrt(alpha). That of the published fits is sqrt(m) of Beckmann's distribution: a
GGX lobe that is as wide at half its height has 1.14 times that roughness, but longer tails, so that no conversion is
right everywhere. Ngan's colours are scaled as MERL's. Losses: joint fits of `one-lobe-specular`.
"""

ERRORS = """Display errors on the sphere without noise (relative ones where it says so); losses are joint fits of
`one-lobe-specular`. The winner is that of maps and published fits.
"""
