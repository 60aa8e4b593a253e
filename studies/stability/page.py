"""docs/stability: atlas.json, a chart and a picture for each axis, and README.md with the figures in its words."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from irpso_addon.core.phrases import percent
from irpso_addon.gpu.device.context import Device
from studies import pages
from studies.bench.measure import machine

from . import chart
from .axes import ALONE, AXES, PAIRS, ROW, Axis
from .methods import BY_KEY, METHODS
from .store import FOLDER, ROOT, Store
from .words import filled, parts, wrapped

OUT = ROOT / "docs" / "stability"
LOW_SHARE = 0.95  # of failing texels in the worst-confidence half of their maps
SHOWN = "tone"  # the axis whose chart opens the page
PRODUCT = ("refined",)  # on axes of another material with model auto, as it comes
BESIDE = {"registration.md": "Misregistration and drifting exposure, corrected", "indirect.md": "Indirect light",
          "measured.md": "Measured materials"}
Summaries = Mapping[str, Any]  # {point: {method: summary}}


def publish(device: Device, seeds: int, out: Path = OUT) -> list[Path]:
    """What the store holds; axes without records stay as an earlier run has left them, or are left out."""
    out.mkdir(parents=True, exist_ok=True)
    by_axis = {axis.key: Store(axis).summaries(seeds) for axis in (*AXES, ROW)}
    by_axis = {key: points for key, points in by_axis.items() if points}
    written = [out / "atlas.json"]
    before = json.loads(written[0].read_text("utf-8")) if written[0].exists() else {}
    measured = joined(before, {"machine": machine(device), "seeds": seeds, "axes": by_axis, "identical": _identical()})
    lines = json.dumps(measured).replace('{"seeds"', '\n{"seeds"')
    written[0].write_text(lines + "\n", encoding="utf-8")
    for axis in AXES:
        if axis.key not in by_axis:
            continue
        written.append(chart.draw(axis, by_axis[axis.key], out / f"{axis.key}.png"))
        records = {p.label: Store(axis).seeds(p, BY_KEY["refined"], any_age=True) for p in axis.points}
        if any(records.values()):
            chart.worst_map(device, axis, records, out / f"{axis.key}_worst.png")
            written.append(out / f"{axis.key}_worst.png")
    written.append(out / "bars.csv")
    rows = [[cell.replace("**", "") for cell in row] for row in bars(measured["axes"])]
    pages.write_csv(written[-1], BARS, rows)
    written.append(out / "README.md")
    written[-1].write_text(page(measured, out), encoding="utf-8")
    return written


def joined(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, Any]:
    """What an earlier run measured with what this one did; ``apart``: when, of axes that were not part of the former.

    The machine and the number of seeds stay those of the run that measured most.
    """
    kept = {key: points for key, points in before.get("axes", {}).items() if key not in now["axes"]}
    if not kept:
        return dict(now)
    order = [axis.key for axis in (*AXES, ROW)]
    axes = {**kept, **now["axes"]}
    made = {"commit": now["machine"]["commit"], "date": now["machine"]["date"], "seeds": now["seeds"]}
    fresh = [key for key, points in now["axes"].items() if before["axes"].get(key) != points]  # others are older
    apart = {**before.get("apart", {}), **dict.fromkeys(fresh, made)}
    return {"machine": before["machine"], "seeds": before["seeds"], "apart": apart,
            "identical": now["identical"] or before.get("identical"),
            "axes": {key: axes[key] for key in order if key in axes}}


def _identical() -> str | None:
    """What came of the runs that must not differ; None where there were none."""
    path = FOLDER / "identical.json"
    return str(json.loads(path.read_text("utf-8"))["words"]) if path.exists() else None


def page(measured: Mapping[str, Any], out: Path) -> str:
    """README.md."""
    by_axis = measured["axes"]
    words = parts()
    m, first = measured["machine"], [axis for axis in AXES if axis.key in by_axis]
    shown = next((axis for axis in first if axis.key == SHOWN), first[0])
    head = words["head"].strip().format(
        seeds=measured["seeds"], identical=measured.get("identical") or "not run", first=shown.title,
        picture=f"{shown.key}.png", made=pages.made(m["date"], m["commit"], m["cpu"], m["gl"], m["packages"]))
    text = [wrapped(head) + "\n"]
    beside = [f"[{title}]({name})" for name, title in BESIDE.items() if (out / name).exists()]
    if beside:
        text.append(f"\nSee also: {'; '.join(beside)}.\n")
    text.append("\n## Whether it warns\n\n" + wrapped(words["bars"]) + "\n\n" + failing(bars(by_axis)))
    if ROW.key in by_axis:
        text.append("\n## Outliers\n\n" + row(by_axis[ROW.key]))
    for title, axes in (("One error", ALONE), ("Two errors together", PAIRS)):
        text.append(f"\n## {title}\n")
        for axis in axes:
            if axis.key in by_axis:
                when = measured.get("apart", {}).get(axis.key)
                made = when and f"Measured {when['date'][:10]} at commit {when['commit']} with {when['seeds']} seeds."
                text.append(f"\n### {axis.title}\n\n![{axis.title}]({axis.key}.png)\n\n"
                            f"{filled(words.get(axis.key, ''), by_axis[axis.key])}\n\n"
                            f"{made + chr(10) * 2 if made else ''}"
                            f"![The worst map]({axis.key}_worst.png)\n")
    return "".join(text)


BARS = ("axis", "failing texels", "in the less trusted half", "or confidence below 0.5", "not a number",
        "maps off by more than 0.15 on > 10 %", "of these unwarned", "warned of")


def failing(rows: Sequence[Sequence[str]]) -> str:
    """The table of the axes that miss a bar, and of all together."""
    return pages.table(BARS, [row for row in rows if any("**" in cell for cell in row)]) + "\n"


def bars(by_axis: Mapping[str, Summaries]) -> list[list[str]]:
    """What every axis must hold, in the columns BARS; bold where it does not."""
    lines = []
    titles = {axis.key: axis.title for axis in (*AXES, ROW)}
    total = {"halved": 0, "halved_low": 0, "failed": 0, "failed_told": 0, "gross_maps": 0, "unwarned": 0}
    for key, points in by_axis.items():
        default = ("auto",) if any("auto" in s for s in points.values()) else PRODUCT
        trials = [s[m] for s in points.values() for m in default if m in s]
        if not trials:
            continue
        nan = sum(s["nan"] for point in points.values() for s in point.values())
        part = {name: sum(t.get(name, 0) for t in trials) for name in total}
        total = {name: total[name] + part[name] for name in total}
        kinds: dict[str, int] = {}
        for kind, count in (item for t in trials for item in t.get("kinds", {}).items()):
            kinds[kind] = kinds.get(kind, 0) + count
        words = ", ".join(f"{kind} ({count})" for kind, count in sorted(kinds.items(), key=lambda item: -item[1]))
        lines.append(_bar(titles[key], part, str(nan), words))
    return [*lines, _bar("**All**", total, "", "")]


def _bar(title: str, part: Mapping[str, int], nan: str, words: str) -> list[str]:
    low, warned = (_share(part[a], part[b]) for a, b in (("halved_low", "halved"), ("failed_told", "failed")))
    unwarned = f"**{part['unwarned']}**" if part["unwarned"] else "0"
    return [title, str(part["failed"]), low, warned, nan, str(part["gross_maps"]), unwarned, words]


def _share(count: int, whole: int) -> str:
    if not whole:
        return "-"
    text = f"{percent(count / whole, 1)}"
    return text if count / whole >= LOW_SHARE else f"**{text}**"


def row(points: Summaries) -> str:
    """Failures without and with outliers."""
    kept = [m for m in METHODS if any(m.key in s for s in points.values())]
    lines = ["| outliers | " + " | ".join(m.label for m in kept) + " |\n", "|---|" + "---|" * len(kept) + "\n"]
    for label, methods in points.items():
        cells = [f"{percent(methods[m.key]['failures'], 2)}" if m.key in methods else "" for m in kept]
        lines.append(f"| {label} | " + " | ".join(cells) + " |\n")
    return "".join(lines)


def table(axis: Axis, points: Summaries) -> str:
    """For the terminal: mean roughness error and failures of every method at every point."""
    lines = [f"\n{axis.title} ({axis.unit}): roughness error / failures"]
    for label, methods in points.items():
        cells = [f"{key} {s['roughness']:.3f}/{percent(s['failures'], 1)}" for key, s in methods.items()]
        lines.append(f"  {label:>24}  " + "  ".join(cells))
    return "\n".join(lines)
