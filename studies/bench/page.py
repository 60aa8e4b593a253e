"""docs/benchmarks/README.md from a run's record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .verdict import Record, judge

HEAD = """\
# Benchmarks

Made by `python -m studies.bench` (`make bench`); figures in [front.json](front.json).{more}

Synthetic problems (`tests/support/texel_problem.py`): {size} x {size} texels of a bumpy patch
under K lamps, one camera, every observation exactly the model that is solved for, or with independent relative noise.
So it is the solvers that are compared, not renderers. Times are from observations on the device to maps on the device,
medians of interleaved rounds; compiling is told apart.

Machine: {cpu}; OpenGL: {gl} ({gl_version}; compute shaders preferred: {compute}); {system}; {packages}; commit
{commit}, {date}.

![Error against time](front.png)

## What was asked, and what this run reached

| comparison | at least | reached | |
|---|---|---|---|
"""
RIVALS = """
## The rivals

All search the same model on the same observations and weigh errors alike (Adam in PyTorch: plain squared errors, by
which it arrives sooner).

* GLSL (studies/bench/shaders): the product's own residual with base colour and weight eliminated. One start in the
  middle; Adam with rate 0.02; a grid in log roughness, then golden section.
* PyTorch: all texels in one batch, precomputed geometry. LM: the same variable projection from 8 starts within the
  range of the truth, which nobody else is told. Adam: all numbers of a texel, automatic differentiation, rate 0.05,
  the best of .01 to .1. Each as it runs and through `torch.compile`.
* SciPy: `least_squares` with bounds and numerical Jacobian on {sample} texels; the time is scaled to all.
* Mitsuba 3: its tutorials' way, `principled`, Adam with rate 0.03, on the flat plane.
* No solver: mean of radiance / irradiance times pi, roughness 0.5.
"""


def write(record: Record, out: Path, sample: int) -> Path:
    """The page; returns its path."""
    captures = " [captures.md](captures.md) compares on captures." if (out / "captures.md").exists() else ""
    parts = [HEAD.format(size=record["size"], more=captures, **record["machine"])]
    verdicts = {True: "met", False: "**below**", None: ""}
    parts += [_row([r.comparison, r.wanted, r.reached, verdicts[r.met]]) for r in judge(record)]
    for table in record["tables"].values():
        parts.append(f"\n## {table['title']}\n\n{_table(table['head'], table['rows'])}\n{table['note']}\n")
    parts.append(RIVALS.format(sample=sample))
    parts.append("\n## All points of the chart\n")
    for title in dict.fromkeys(c["title"] for c in record["curves"]):
        parts.append(f"\n### {title}\n\n{_curves([c for c in record['curves'] if c['title'] == title])}")
    path = out / "README.md"
    path.write_text("".join(parts), encoding="utf-8")
    return path


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |\n"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return _row(head) + "|" + "---|" * len(head) + "\n" + "".join(_row(r) for r in rows)


def _curves(curves: Sequence[dict[str, Any]]) -> str:
    rows = []
    for curve in curves:
        for i, p in enumerate(curve["points"]):
            rows.append([curve["label"] if i == 0 else "", p["setting"] + (" (default)" if p["default"] else ""),
                         duration(p["seconds"]), f"{p['albedo']:.5f}", f"{p['roughness']:.5f}", f"{p['failures']:.2%}",
                         duration(curve["compile"]) if i == 0 and curve["compile"] > 0.02 else ""])
    return _table(["method", "budget", "time", "albedo RMSE", "roughness error", "failures", "compiling, once"], rows)


def duration(seconds: float) -> str:
    """Three digits and a unit."""
    if seconds < 0.9995:
        return f"{seconds * 1e3:.3g} ms"
    return f"{seconds:.3g} s" if seconds < 999.5 else f"{seconds:.0f} s"
