"""What was asked of the methods, and what this run reached."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from irpso_addon.core.phrases import percent
from tests.support.texel_problem import Spec

Record = dict[str, Any]
NEAR = 0.01  # albedo error to arrive at, where the time to it is compared
CLEAN_ONE, CLEAN_TWO, PLANE = Spec(), Spec("two-lobe", 12), Spec(plane=True)
NOISY_ONE, NOISY_TWO = Spec("one-lobe", 12, noise=0.01), Spec("two-lobe", 12, noise=0.01)


@dataclass(frozen=True)
class Row:
    """One line of the list."""

    comparison: str
    wanted: str
    reached: str
    met: bool | None  # None: nothing was asked


def judge(record: Record) -> list[Row]:
    """Every comparison that the record has the figures for."""
    size = record["size"]
    rows: list[Row] = []
    tables = record["tables"]

    def curve(spec: Spec, method: str) -> list[dict[str, Any]]:
        wanted = {**asdict(spec), "size": size}
        return next((c["points"] for c in record["curves"] if c["problem"] == wanted and c["method"] == method), [])

    def add(comparison: str, wanted: str, reached: str, met: bool | None) -> None:
        rows.append(Row(comparison, wanted, reached, met))

    refined, paper = default(curve(CLEAN_ONE, "refined")), last(curve(CLEAN_ONE, "paper"))
    if refined and paper:
        ratio = paper["seconds"] / refined["seconds"]
        add(f"`refined` against `paper` at {paper['setting']}, one lobe",
            "300 times faster, roughness error 1e-4 or less",
            f"{ratio:.0f} times, {refined['roughness']:.1e} ({paper['roughness']:.2f})",
            ratio >= 300 and refined["roughness"] <= 1e-4)
    two, paper_two = default(curve(CLEAN_TWO, "refined")), last(curve(CLEAN_TWO, "paper"))
    if two and paper_two:
        ratio = paper_two["seconds"] / two["seconds"]
        add(f"the same, two lobes, K = 12, {paper_two['setting']}", "150 times faster, failures 0.5 % or less",
            f"{ratio:.0f} times, {percent(two['failures'], 2)} ({percent(paper_two['failures'])})",
            ratio >= 150 and two["failures"] <= 0.005)
    for spec, method, name, wanted in (
        (PLANE, "mitsuba", "Mitsuba Adam, flat plane", 500), (PLANE, "torch-adam", "PyTorch Adam, flat plane", 60),
        (CLEAN_ONE, "torch-adam", "PyTorch Adam", 60),
        (PLANE, "torch-adam-c", "PyTorch Adam, compiled, flat plane", None),
        (CLEAN_ONE, "torch-adam-c", "PyTorch Adam, compiled", None),
    ):
        ours, theirs = default(curve(spec, "refined")), curve(spec, method)
        if ours and theirs:
            there = next((p for p in theirs if p["albedo"] <= NEAR), None)
            ratio = (there or theirs[-1])["seconds"] / ours["seconds"]
            words = f"{ratio:.0f} times"
            if not there:
                words = f"more than {words}: not there at {theirs[-1]['setting']}"
            add(f"`refined` against {name}, to albedo RMSE {NEAR}", f"{wanted} times" if wanted else "", words,
                ratio >= wanted if wanted else None)
    for method, name, wanted in (("torch-lm", "PyTorch", 8), ("torch-lm-c", "PyTorch, compiled", None)):
        theirs = last(curve(CLEAN_ONE, method))
        if refined and theirs:
            ratio = theirs["seconds"] / refined["seconds"]
            add(f"against LM batched in {name} (8 starts, {theirs['setting']})", f"{wanted} times" if wanted else "",
                f"{ratio:.1f} times", ratio >= wanted if wanted else None)
    if "fused" in tables:
        value = tables["fused"]["value"]
        add("a swarm in one draw against one particle a pass, evaluations a second", "15 times", f"{value:.1f} times",
            value >= 15)
    swarm = default(curve(CLEAN_ONE, "swarm"))
    if refined and swarm:
        ratio = swarm["seconds"] / refined["seconds"]
        add("`swarm` against `refined`", "within 8 times the time, error 0.001 or less",
            f"{ratio:.1f} times, {swarm['roughness']:.1e}", ratio <= 8 and swarm["roughness"] <= 1e-3)
    if "noise" in tables:
        smooth, sharp = (tables["noise"]["value"][f"12 {name}"] for name in ("smooth", "sharp borders"))
        add("one lobe, K = 12, 1 % noise: failures", "smooth 1 % or less, sharp borders 3 % or less",
            f"{percent(smooth, 2)}, {percent(sharp, 2)}", smooth <= 0.01 and sharp <= 0.03)
    if "confidence" in tables:
        value = tables["confidence"]["value"][NOISY_ONE.title]
        add("confidence at 1 % noise, K = 12", "rank correlation 0.75 or more; 90 % intervals hold 85 to 95 %",
            f"{value['rank']:.2f} (errors drawn from these standard errors have {value['drawn']:.2f}), "
            f"{percent(value['held'], 1)}", value["rank"] >= 0.75 and 0.85 <= value["held"] <= 0.95)
    if "auto" in tables:
        value = tables["auto"]["value"]
        wanted = {"lambert": 0.99, "one-lobe": 0.97, "two-lobe": 0.90}
        add("`auto` at 1 % noise, K = 12, by region", "Lambert 99 %, one lobe 97 %, two lobes 90 % right",
            ", ".join(f"{percent(value[name])}" for name in wanted), all(value[k] >= v for k, v in wanted.items()))
    if "arithmetic" in tables:
        value = tables["arithmetic"]["value"]
        add("fraction of the device's arithmetic that `refined` reaches", "60 % on llvmpipe", f"{percent(value)}",
            value >= 0.6)
    if "throughput" in tables and tables["throughput"]["value"]["gpu"]:
        value = tables["throughput"]["value"]["seconds"]
        add("4096 x 4096 texels, K = 12, one lobe, at the best rate", "100 ms", f"{value * 1e3:.0f} ms", value <= 0.1)
    return rows


def default(points: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """The point of the setting that a user gets."""
    return next((p for p in points if p["default"]), None)


def last(points: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """The point of the largest budget."""
    return points[-1] if points else None
