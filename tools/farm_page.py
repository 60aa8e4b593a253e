"""docs/farms.md and its two charts, from what tools/farm_efficiency.py measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from irpso_addon.core.phrases import percent
from studies import pages
from tools.farm_simulation import KINDS, Costs, Outcome, Work, alone, knee, most, simulate

SQUARES, SIZE, BLOCK = 63, 8192, 512  # texels
TILES = (512, 1024, 2048, 4096, 8192)
SHOWN_TILE = 2048  # 1,008 of them
WORKERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
PLAN = 4.0  # times the texels of the plan that was measured: 2048 x 2048 against 1024 x 1024
GPU = 30.0  # times as fast: an assumption, said on the page
NAMES = {"solve": "solving", "merge": "merging", "plan": "while the plan is made", "start": "starting processes",
         "slow": "slow tasks", "wait": "nothing left to do"}
COLOURS = ("#2166ac", "#92c5de", "#fdb863", "#b35806", "#b2182b", "#cccccc")
CURVES = ("#b2182b", "#e08214", "#2166ac", "#1b7837", "#762a83")
STYLE = {"font.size": 9, "svg.hashsalt": "irpso", "svg.fonttype": "none", "axes.spines.top": False,
         "axes.spines.right": False}
Runs = dict[int, dict[int, Outcome]]  # by tile, by workers


def write_page(record: dict[str, Any], docs: Path) -> None:
    """The page and its charts into ``docs``."""
    measured = Costs(**{key: tuple(value) if isinstance(value, list) else value
                        for key, value in record["costs"].items()})
    costs = replace(measured, plan=measured.plan * PLAN)
    quick = replace(costs, plan=costs.start + (costs.plan - costs.start) / GPU,
                    blocks=tuple(seconds / GPU for seconds in costs.blocks))
    cases = {"Workers as measured": _runs(costs), f"Workers {GPU:g} times as fast at solving": _runs(quick)}
    with plt.rc_context(STYLE):
        _draw_measured(record, docs / "farms_measured")
        _draw_simulated(cases, docs / "farms_simulated")
    page = (docs.parent / "tools" / "farms.in.md").read_text(encoding="utf-8")
    docs.joinpath("farms.md").write_text(page.format(**_words(record, measured, [costs, quick], cases)),
                                         encoding="utf-8")


def _work(tile: int) -> Work:
    return Work(SQUARES, SIZE // BLOCK, tile // BLOCK)


def _runs(costs: Costs) -> Runs:
    return {tile: {workers: simulate(costs, _work(tile), workers) for workers in WORKERS} for tile in TILES}


# ---- charts


def _draw_measured(record: dict[str, Any], stem: Path) -> None:
    """Times as fast as one machine without a farm."""
    figure, axes = plt.subplots(figsize=(4.6, 3.6), dpi=160, layout="constrained")
    workers = [int(count) for count in record["workers"]]
    times = [record["alone"] / seconds for seconds in record["workers"].values()]
    axes.plot(workers, workers, color="#999999", linestyle=(0, (4, 3)), linewidth=1)
    axes.annotate("ideal", (workers[-1], workers[-1]), (-10, 0), textcoords="offset points", ha="right",
                  color="#666666", fontsize=8)
    axes.plot(workers, times, color=CURVES[2], marker="o", markersize=5)
    for count, value in zip(workers, times, strict=True):
        axes.annotate(f"{value:.2f}", (count, value), (0, -14), textcoords="offset points", ha="center", fontsize=8)
    axes.set(xticks=workers, xlabel="workers", ylim=(0, workers[-1] * 1.1), xlim=(0.7, workers[-1] + 0.3))
    axes.set_title("Times as fast as one machine, plan aside", loc="left", fontsize=10)
    _save(figure, stem)


def _draw_simulated(cases: dict[str, Runs], stem: Path) -> None:
    """A row for each kind of workers: efficiency by the size of tasks, and where the time goes."""
    figure, grid = plt.subplots(len(cases), 2, figsize=(9.6, 7.2), dpi=160, layout="constrained", squeeze=False)
    for (name, runs), (left, right) in zip(cases.items(), grid, strict=True):
        for colour, tile in zip(CURVES, TILES, strict=True):
            left.plot(WORKERS, [100 * runs[tile][n].efficiency for n in WORKERS], color=colour, marker="o",
                      markersize=3.5, label=f"{tile}")
        left.set_title(f"{name}: useful share of their time (%)", loc="left", fontsize=9)
        left.set_ylim(0, 103)
        shares = [[100 * runs[SHOWN_TILE][n].spent[kind] / sum(runs[SHOWN_TILE][n].spent.values()) for n in WORKERS]
                  for kind in KINDS]
        right.stackplot(WORKERS, shares, colors=COLOURS, labels=[NAMES[kind] for kind in KINDS])
        right.set_title(f"Where it goes, tasks of {SHOWN_TILE} x {SHOWN_TILE} (%)", loc="left", fontsize=9)
        right.set_ylim(0, 100)
        for axes in (left, right):
            axes.set_xscale("log", base=2)
            axes.set_xticks(WORKERS, [str(n) for n in WORKERS])
            axes.set_xlim(WORKERS[0], WORKERS[-1])
            axes.set_xlabel("workers")
    grid[0, 0].legend(title="texels across a task", fontsize=7, title_fontsize=7, frameon=False, loc="lower left")
    grid[0, 1].legend(fontsize=7, loc="lower left", framealpha=0.9)
    _save(figure, stem)


def _save(figure: Any, stem: Path) -> None:
    for kind in ("png", "svg"):
        figure.savefig(stem.with_suffix(f".{kind}"), metadata={"Date": None} if kind == "svg" else None)
    plt.close(figure)


# ---- words


def _words(record: dict[str, Any], measured: Costs, costs: list[Costs], cases: dict[str, Runs]) -> dict[str, str]:
    """What the page's braces stand for."""
    rows = [f"| {count} | {seconds:.1f} | {record['alone'] / seconds:.2f} | "
            f"{percent(record['alone'] / seconds / int(count))} |"
            for count, seconds in record["workers"].items()]
    table = [f"| {name} | {workers} | {_time(run.seconds)} | {percent(run.efficiency)} | {NAMES[most(run)]} |"
             for name, runs in cases.items() for workers, run in runs[SHOWN_TILE].items()
             if workers in (1, 16, 64, 256)]
    tiles = [f"| {tile} | {SQUARES * (SIZE // tile) ** 2:,} | " + " | ".join(
        f"{_time(runs[tile][256].seconds)}, {percent(runs[tile][256].efficiency)}, to {knee(list(runs[tile].items()))}"
        for runs in cases.values()) + " |" for tile in TILES]
    return {
        "measured": "\n".join(rows), "simulated": "\n".join(table), "tiles": "\n".join(tiles),
        "alone": f"{record['alone']:.1f}", "plan": f"{measured.plan:.1f}", "session": f"{measured.session:.2f}",
        "dispatch": f"{1000 * measured.dispatch:.0f}", "start": f"{measured.start:.1f}",
        "block": f"{median(measured.blocks):.1f}",
        "blocks": f"{min(measured.blocks):.1f} to {max(measured.blocks):.1f}",
        "merge_start": f"{measured.merge_start:.1f}", "merge": f"{measured.merge:.2f}",
        "slow": f"{max(measured.slowness):.2f}",
        "made": pages.made(record["date"], record["commit"], record["cpu"], record["device"], record["software"]),
        "size": str(record["size"]), "tile": str(record["tile"]), "views": str(record["views"]),
        "pixels": str(record["pixels"]), "squares": str(SQUARES), "gpu": f"{GPU:g}", "plan_times": f"{PLAN:g}",
        "alone_all": _time(alone(costs[0], _work(SHOWN_TILE))), "alone_gpu": _time(alone(costs[1], _work(SHOWN_TILE))),
    }


def _time(seconds: float) -> str:
    if seconds >= 3600:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 60:.1f} min" if seconds >= 60 else f"{seconds:.0f} s"
