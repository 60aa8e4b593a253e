"""``python -m studies.charts``: draws the charts of the pages that have a table and no picture, from these tables.

A row for each case, a mark for each of what is compared.  The file of a chart holds the stamp of its table, by which
tests/studies/test_pages.py sees a chart that is older than its page.  Needs matplotlib.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from studies.pages import DOCS

MARKS = (("o", "#777777"), ("D", "#D55E00"), ("s", "#0072B2"))


@dataclass(frozen=True)
class Chart:
    """What is drawn of a page's table, by its columns from 0 on."""

    unit: str
    rows: tuple[int, ...]  # whose cells name a row
    values: Mapping[str, int]  # columns by their names; of one column with ``by``, the name is not shown
    by: int | None = None  # column whose cells name the marks
    log: bool = False


CHARTS = {
    "ablation": Chart("error of roughness", (0,), {"mean": 2, "median": 3}),
    "calibration": Chart("mean error of roughness", (0, 1), {"": 4}, by=2),
    "corrected": Chart("share of texels off by more than 0.1, %", (0, 1), {"as given": 2, "corrected": 3}),
    "estimate": Chart("seconds", (0, 1, 2, 3), {"measured": 4, "estimated": 6}, log=True),
    "flash_shoot": Chart("error of roughness", (0,), {"mean": 4, "median": 5}),
    "normals": Chart("mean error of the normals, degrees", (0, 1), {"": 3}, by=2),
}


def table(page: str) -> str:
    """The text of a page's table."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    return text.split("<!-- table: begin -->\n")[1].split("<!-- table: end -->")[0]


def stamp(page: str) -> str:
    """Of a page's table."""
    return "table " + hashlib.sha256(table(page).encode()).hexdigest()[:16]


def draw(page: str) -> None:
    """A page's chart, beside it."""
    chart = CHARTS[page]
    found: dict[str, dict[str, float]] = {}  # row -> mark -> value
    head, _, *lines = table(page).splitlines()
    for line in lines:
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        row = ", ".join(cells[column] for column in chart.rows)
        numbers = {name: re.match(r"[\d.]+", cells[column]) for name, column in chart.values.items()}
        if all(numbers.values()):
            marks = {name if chart.by is None else cells[chart.by]: float(n[0]) for name, n in numbers.items() if n}
            found.setdefault(row, {}).update(marks)
    names = list(next(iter(found.values())))
    columns = [cell.strip() for cell in head.strip("|").split("|")]
    _dots(DOCS / f"{page}.png", list(found), {n: [marks[n] for marks in found.values()] for n in names}, chart,
          ", ".join(columns[column] for column in chart.rows), stamp(page))


def _dots(out: Path, rows: Sequence[str], series: Mapping[str, Sequence[float]], chart: Chart, what: str,
          made: str) -> None:
    """Legible at a width of 700 pixels.  The first row is on top; a linear scale begins at 0."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 0.34 * len(rows) + 1.3), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)  # no window, whatever the machine
    axis, places = figure.subplots(), range(len(rows))
    pairs = list(zip(*series.values(), strict=True))
    axis.hlines(places, [min(pair) for pair in pairs], [max(pair) for pair in pairs], color="#cccccc", zorder=1)
    for (name, values), (mark, colour) in zip(series.items(), MARKS, strict=False):
        axis.plot(values, places, mark, color=colour, label=name, markersize=7, zorder=2, clip_on=False)
    axis.set_yticks(places, rows)
    axis.set_ylabel(what)
    axis.set_ylim(len(rows) - 0.5, -0.5)
    axis.set_xlabel(chart.unit)
    if chart.log:
        from matplotlib.ticker import LogLocator, NullFormatter

        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter("{x:g}")
        axis.xaxis.set_minor_formatter(NullFormatter())
    else:
        axis.set_xlim(0, None)
    axis.grid(axis="x", alpha=0.4)
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper left", ncols=len(series), frameon=False)
    figure.savefig(out, facecolor="white", metadata={"Description": made}, pil_kwargs={"optimize": True})


def main() -> int:
    """All of them."""
    for page in CHARTS:
        draw(page)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
