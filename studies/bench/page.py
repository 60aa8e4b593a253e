"""docs/benchmarks/README.md from a run's record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from irpso_addon.core.phrases import percent
from studies import pages

from .verdict import Record, judge

PAGE = pages.DOCS / "benchmarks" / "README.md"
BESIDE = ("moves",)  # tables in files of their own

GOALS = ("comparison", "at least", "reached", "")
POINTS = ("problem", "method", "budget", "default", "time, s", "albedo RMSE", "roughness error", "failures",
          "compiling, s")


def write(record: Record, out: Path) -> Path:
    """The figures of the page and, beside it, all points of the chart; returns the page's path."""
    m, verdicts = record["machine"], {True: "met", False: "**below**", None: ""}
    goals = [[r.comparison, r.wanted, r.reached, verdicts[r.met]] for r in judge(record)]
    shown = [table for name, table in record["tables"].items() if name not in BESIDE]
    pages.fill(PAGE, {
        "made": pages.made(m["date"], m["commit"], m["cpu"], m["gl"], f"{m['packages']}, {m['system']}"),
        "goals": pages.table(GOALS, goals),
        "tables": "\n".join(_section(table) for table in shown)}, out / PAGE.name)
    for name in BESIDE:
        if name in record["tables"]:
            pages.write_csv(out / f"{name}.csv", record["tables"][name]["head"], record["tables"][name]["rows"])
    pages.write_csv(out / "points.csv", POINTS, list(_points(record["curves"])))
    return out / PAGE.name


def _section(table: dict[str, Any]) -> str:
    made = f"\nMeasured {table['date'][:10]} at commit {table['commit']}.\n" if "commit" in table else ""
    return f"## {table['title']}\n\n{pages.table(table['head'], table['rows'])}\n\n{table['note']}\n{made}"


def _points(curves: Sequence[dict[str, Any]]) -> Iterator[list[str]]:
    for curve in curves:
        for p in curve["points"]:
            yield [curve["title"], curve["label"], p["setting"], "yes" if p["default"] else "", f"{p['seconds']:.4g}",
                   f"{p['albedo']:.5f}", f"{p['roughness']:.5f}", percent(p["failures"], 2), f"{curve['compile']:.3g}"]


def duration(seconds: float) -> str:
    """Three digits and a unit."""
    if seconds < 0.9995:
        return f"{seconds * 1e3:.3g} ms"
    return f"{seconds:.3g} s" if seconds < 999.5 else f"{seconds:.0f} s"
