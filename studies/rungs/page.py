"""The page and its chart."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from irpso_addon.core.data import F64
from studies import pages
from studies.stability.measured.run import KINDS, kind_of

from .fit import LEVEL, METALLIC, RUNGS
from .measure import Found

FOLDS = {0.0: 3, 0.01: 1}  # by noise
MUCH, SOME = 0.8, 0.95  # of the smaller rung's error
MEASURES = "L*", "relative RMS"
SHOWN = [name for name, rung in RUNGS.items() if rung.below]
Results = Mapping[str, Mapping[float, Mapping[str, Found]]]

def ratios(results: Results, noise: float, rung: str) -> F64:
    """(materials, 2) errors over those of the rung that it is compared with."""
    under = LEVEL if rung == METALLIC else METALLIC
    return np.array([_errors(found[noise][rung]) / _errors(found[noise][under]) for found in results.values()])


def _errors(found: Found) -> F64:
    return np.array([found.error.lightness, found.error.relative_rms])


def write(results: Results, near: Mapping[str, F64], page: Path) -> None:
    """The figures of the page, and the full tables beside it."""
    import bpy

    gains = _gains(results)
    pages.fill(pages.DOCS / "rungs.md", {
        "made": pages.measured("", f"Blender {bpy.app.version_string}"),
        "pays": _pays(results), "kinds": _kinds(results), "values": _values(results),
        "gains": pages.table(("model", "materials", "most"), [
            (rung, str(len(names)), ", ".join(names[:5])) for rung, names in gains.items()]),
        "cycles": pages.table(("model", "largest", "mean"), [
            (name, f"{100 * e.max():.4f}", f"{100 * e.mean():.5f}") for name, e in near.items()])}, page)
    pages.write_csv(page.with_name("rungs-gains.csv"), ("model", "rank", "material"), [
        (rung, str(rank), name) for rung, names in gains.items() for rank, name in enumerate(names, 1)])
    pages.write_csv(
        page.with_name("rungs-materials.csv"), ("material", *(f"{rung}: {e}" for rung in RUNGS for e in MEASURES)),
        [(name, *(cell for rung in RUNGS for cell in _cells(found[0.0][rung]))) for name, found in results.items()])


def _cells(found: Found) -> tuple[str, str]:
    lightness, relative = _errors(found)
    return f"{lightness:.2f}", f"{relative:.3f}"


def _pays(results: Results) -> str:
    rows = []
    for noise in FOLDS:
        for rung in SHOWN:
            r = ratios(results, noise, rung)
            share = [f"{100 * np.mean(r[:, k] < limit):.0f}" for k in (0, 1) for limit in (SOME, MUCH)]
            both, worse = 100 * np.mean(r.max(1) < SOME), 100 * np.mean(r.max(1) > 1 / SOME)
            rows.append((f"{100 * noise:g} %", rung, *share[:2], f"{np.median(r[:, 0]):.3f}", *share[2:],
                         f"{np.median(r[:, 1]):.3f}", f"{both:.0f}", f"{worse:.0f}"))
    return pages.table(("noise", "model", "L* > 5 %", "L* > 20 %", "L* median ratio", "RMS > 5 %", "RMS > 20 %",
                  "RMS median ratio", "both", "worse"), rows)


def _kinds(results: Results) -> str:
    kinds = np.array([kind_of(name) for name in results])
    found = {rung: ratios(results, 0.0, rung) for rung in SHOWN}
    return pages.table(("kind", "materials", *SHOWN), [
        (kind, str((kinds == kind).sum()), *(" / ".join(f"{x:.2f}" for x in np.median(r[kinds == kind], axis=0))
                                             for r in found.values())) for kind in KINDS if (kinds == kind).any()])


def _gains(results: Results) -> dict[str, list[str]]:
    """Materials that gain much by either measure, without noise, and lose by neither; most first."""
    found, names = {}, np.array(list(results))
    for rung in SHOWN:
        r = ratios(results, 0.0, rung)
        gain = (r.min(1) < MUCH) & (r.max(1) < 1 / SOME)
        found[rung] = names[np.flatnonzero(gain)[np.argsort(r[gain].min(1))]].tolist()
    return found


def _values(results: Results) -> str:
    rows = []
    for rung in SHOWN:
        gain = ratios(results, 0.0, rung).max(1) < SOME
        of = [found[0.0][rung].numbers for found, good in zip(results.values(), gain, strict=True) if good]
        for name in RUNGS[rung].adds if of else ():
            values = np.array([[np.mean(getattr(n, name)) for n in folds] for folds in of])
            rows.append((rung, name.replace("_", " "), str(len(of)), f"{np.median(values):.2f}",
                         f"{np.median(np.ptp(values, axis=1)):.3f}"))
    return pages.table(("model", "number", "materials", "median", "differs"), rows)


def chart(results: Results, out: Path) -> None:
    """Sorted ratios."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    FigureCanvasAgg(figure)  # no window, whatever the machine
    for k, (axis, name) in enumerate(zip(figure.subplots(1, 2), MEASURES, strict=True)):
        for n, rung in enumerate(SHOWN):
            axis.plot(100 * (np.arange(len(results)) + 0.5) / len(results), np.sort(ratios(results, 0.0, rung)[:, k]),
                      color=f"C{n}", linestyle="--" if rung == METALLIC else "-", label=rung)
        for limit in (MUCH, SOME):
            axis.axhline(limit, color="#999999", linewidth=0.8, linestyle=":")
        axis.set(xlabel="% of the materials", ylabel=f"held-out {name} over the smaller model's", ylim=(0, 1.3),
                 xlim=(0, 100))
        axis.grid(alpha=0.25)
    figure.axes[1].legend(fontsize=8, frameon=False, loc="lower right")
    figure.savefig(out, dpi=90, facecolor="white", pil_kwargs={"optimize": True})
