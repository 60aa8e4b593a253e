"""The page docs/budget.md: its rows, tables and chart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from irpso_addon.core.phrases import percent
from studies import pages

from .instrument import FILES, KERNELS, PARTS, PICTURES, SCENE, START
from .ledger import COMPILE, GPU, NOTHING, READ_BACK, UPLOAD
from .needs import Need

SMALL = 0.005  # of a command: rows that are smaller in every case are one row
SMALLER = f"parts below {percent(SMALL, 1)}"
PAGE = pages.DOCS / "budget.md"
COMPILED, UPLOADED, RETURNED = "shader compile", "making textures, upload", "read-back"
OF_WHOLE = (START, SCENE, PICTURES, FILES, NOTHING)  # rows that are a part, whatever kind
BY_KIND = {COMPILE: COMPILED, UPLOAD: UPLOADED, READ_BACK: RETURNED}  # rows that are a kind, whatever part
WORKING = list(dict.fromkeys(part for name in PARTS for part in (
    [*KERNELS.values(), name] if name == "neighbours" else [name])))  # parts in the order of a solve
ROWS = (START, SCENE, PICTURES, UPLOADED, COMPILED, *(f"GPU: {part}" for part in WORKING), RETURNED,
        *(f"Python: {part}" for part in WORKING), FILES, NOTHING)
GROUPS = {  # of the chart
    START: ((START,), "#999999"), "scene, pictures": ((SCENE, PICTURES), "#c9a66b"),
    COMPILED: ((COMPILED,), "#D55E00"), "upload, read-back": ((UPLOADED, RETURNED), "#E69F00"),
    "GPU: views": (("GPU: making the device", "GPU: G-buffer", "GPU: visibility", "GPU: observations",
                    "GPU: indirect light"), "#08306b"),
    "GPU: gathering": (("GPU: gathering to texels",), "#2171b5"),
    "GPU: search": (("GPU: search",), "#4292c6"),
    "GPU: neighbours": (("GPU: tables", "GPU: polish", "GPU: neighbours", "GPU: rest of the solve"), "#6baed6"),
    "GPU: trials": (("GPU: trials of models", "GPU: calibration", "GPU: normals"), "#9ecae1"),
    "GPU: base colour": (("GPU: base colour of pixels", "GPU: back-projection", "GPU: fill", "GPU: standard errors",
                          "GPU: rest of the maps"), "#56B4E9"),
    "GPU: checks": (("GPU: checks",), "#c6dbef"),
    "Python: trials": (("Python: trials of models", "Python: calibration", "Python: normals"), "#006d2c"),
    "Python: the rest": (tuple(f"Python: {part}" for part in WORKING if part not in
                               ("trials of models", "calibration", "normals")), "#74c476"),
    FILES: ((FILES,), "#CC79A7"), NOTHING: ((NOTHING,), "#000000"),
}


@dataclass(frozen=True)
class Run:
    """One measured command."""

    wall: float  # seconds from start to end of its process
    cpu: float  # seconds of processors, in it and in what it starts
    record: Mapping[str, Any]  # of its ledger; empty where it was not measured

    @property
    def rows(self) -> dict[str, float]:
        """Seconds by row; what happened after the ledger was closed is the start's and end's."""
        found = dict.fromkeys(ROWS, 0.0)
        for part, kind, seconds in self.record["seconds"]:
            found[row_of(part, kind)] += seconds
        found[START] += self.wall - sum(found.values())
        return found


@dataclass(frozen=True)
class Measured:
    """All runs of one case."""

    name: str
    words: str
    first: Run  # with an empty cache of compiled shaders
    again: Run
    plain: Run  # of the command as it is
    needs: Sequence[Need] = ()


def row_of(part: str, kind: str) -> str:
    """In which row of the table a ledger's entry is."""
    if kind in BY_KIND:
        return BY_KIND[kind]
    if part in OF_WHOLE:
        return part
    return f"{'GPU' if kind == GPU else 'Python'}: {part}"


def write(found: Sequence[Measured], renderer: str, programs: Sequence[str], rate: Mapping[str, float],
          page: Path = PAGE, out: Path | None = None) -> None:
    """Fill the page, and draw its chart beside it."""
    pages.fill(page, {
        "made": pages.measured(renderer, *programs),
        "cases": "\n".join(f"* **{case.name}**: {case.words}." for case in found), "runs": runs(found),
        "table": table(found), "bytes": traffic(found), "needs": needed(found, rate)}, out)
    draw(found, (out or page).with_suffix(".png"))


def runs(found: Sequence[Measured]) -> str:
    """Seconds of each case as a whole."""
    rows = []
    for case in found:
        again, passes = case.again, drawing(case.again)
        rows.append([case.name, f"{case.plain.wall:.1f}", f"{again.wall:.1f}",
                     percent(again.cpu / case.plain.cpu - 1), f"{case.first.wall:.1f}",
                     f"{case.first.rows[COMPILED]:.1f}", f"{again.wall - passes:.1f}",
                     percent(again.rows[NOTHING] / again.wall, 1)])
    return pages.table(["case", "as it is (s)", "measured (s)", "measuring adds (CPU time)",
                        "measured, first solve (s)", "of it shader compile (s)", "measured, without GPU passes (s)",
                        "unattributed"], rows)


def drawing(run: Run) -> float:
    """Seconds of all passes."""
    return sum(seconds for row, seconds in run.rows.items() if row.startswith("GPU"))


def table(found: Sequence[Measured]) -> str:
    """Seconds and share of each row, with a cache of compiled shaders; small rows of a kind together."""
    every, walls = [case.again.rows for case in found], [case.again.wall for case in found]
    small = {kind: [row for row in ROWS if row.startswith(kind) and all(
        of[row] < SMALL * wall for of, wall in zip(every, walls, strict=True))] for kind in ("GPU", "Python")}

    def line(name: str, rows: Sequence[str]) -> list[str]:
        seconds = [sum(of[row] for row in rows) for of in every]
        return [name, *(f"{n:.2f} ({percent(n / wall)})" for n, wall in zip(seconds, walls, strict=True))]

    lines = [line(row, [row]) for row in ROWS if row not in small["GPU"] + small["Python"]]
    lines[-2:-2] = [line(f"{kind}: {SMALLER}", rows) for kind, rows in small.items() if rows]
    lines.append(["**all**", *(f"**{wall:.2f}**" for wall in walls)])
    notes = [f"{kind}: {SMALLER}, each: {', '.join(row.split(': ')[1] for row in rows)}."
             for kind, rows in small.items() if rows]
    return "\n\n".join([pages.table(["seconds (share)", *(case.name for case in found)], lines), *notes])


def traffic(found: Sequence[Measured]) -> str:
    """Memory and bytes moved."""
    rows = []
    for case in found:
        record = case.again.record
        estimated = record.get("estimated")
        memory, moved = record["memory"], record["bytes"]
        rows.append([case.name, *(f"{n / 1e6:.0f}" if n else "" for n in (
            memory, moved.get("device", 0), estimated, moved.get("uploaded", 0), moved.get("read back", 0)))])
    return pages.table(["case", "peak resident memory (MB)", "textures and buffers at most (MB)",
                        "device memory as estimated before (MB)", "uploaded (MB)", "read back (MB)"], rows)


def needed(found: Sequence[Measured], rate: Mapping[str, float]) -> str:
    """The bounds, and the rates that they are from."""
    rows = [[case.name, of.name, f"{of.evaluations / 1e6:.1f}" if of.evaluations else "",
             f"{of.observations:.1f}" if of.observations else "", f"{of.operations / 1e9:.2f}",
             f"{of.bytes / 1e9:.2f}", f"{of.arithmetic:.2f}", f"{of.memory:.2f}", f"{of.seconds:.2f}",
             percent(of.share), percent(of.unskipped / of.seconds) if of.unskipped else ""]
            for case in found for of in case.needs]
    head = ["case", "pass", "evaluations at most (10^6)", "observations of a texel", "operations (10^9)", "GB",
            "least for operations (s)", "least for bytes (s)", "took (s)", "ratio", "ratio with all views"]
    speeds = "; ".join(f"{name} {value / 1e9:.1f}" for name, value in rate.items())
    return f"{pages.table(head, rows)}\n\nRates of this device, 10^9 a second, each alone at its best: {speeds}."


def draw(found: Sequence[Measured], path: Path) -> None:
    """A bar for each case: shares of its seconds, stacked."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 0.55 * len(found) + 2.3), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    labels = [f"{case.name}, {case.again.wall:.0f} s" for case in found]
    left = [0.0] * len(found)
    for name, (rows, colour) in GROUPS.items():
        shares = [100 * sum(case.again.rows[row] for row in rows) / case.again.wall for case in found]
        axis.barh(labels, shares, left=left, label=name, color=colour, edgecolor="white", linewidth=0.5)
        for n, share in enumerate(shares):
            if share >= 4:
                axis.text(left[n] + share / 2, n, f"{share:.0f}", ha="center", va="center", fontsize=8,
                          color="black" if colour in ("#9ecae1", "#c6dbef", "#56B4E9", "#E69F00", "#74c476", "#c9a66b",
                                                      "#6baed6") else "white")
        left = [a + b for a, b in zip(left, shares, strict=True)]
    axis.invert_yaxis()
    axis.set_xlim(0, 100)
    axis.set_xlabel("share of the command's seconds, %")
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper left", ncols=4, frameon=False, fontsize=8)
    figure.savefig(path, facecolor="white", pil_kwargs={"optimize": True})
