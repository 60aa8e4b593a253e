"""The benchmark: ``python -m studies.bench``.  Needs numpy, moderngl and matplotlib, no Blender; rivals as installed.

Writes front.json, front.png, front.svg and README.md into docs/benchmarks/, and prints the list.  --parts and --methods
pick; --redraw makes chart and page anew from the last figures.  --earlier draws our own methods of an earlier run in
grey, from ``git show COMMIT:docs/benchmarks/front.json``.  --gpu-report writes what a GPU does into one file.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("MESA_SHADER_CACHE_DISABLE", "true")  # else compile times are those of an earlier run

from irpso_addon.gpu.device.context import Device

from . import chart, gpu_report, peak, special
from .entrants import ENTRANTS
from .measure import ROOT, curves, machine
from .page import duration, write
from .verdict import CLEAN_ONE, CLEAN_TWO, NOISY_ONE, NOISY_TWO, PLANE, Record, judge

OUT = ROOT / "docs" / "benchmarks"
FRONT = (CLEAN_ONE, NOISY_ONE, CLEAN_TWO, NOISY_TWO)  # the chart's rows
TABLES: dict[str, Callable[[Device, int, int], dict[str, Any]]] = {
    "noise": special.noise, "confidence": special.confidence, "moves": special.moves, "auto": special.auto,
    "fused": peak.fused, "arithmetic": peak.arithmetic, "throughput": peak.throughput,
}


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.bench", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--size", type=int, default=128, help="texels across (default 128)")
    parser.add_argument("--rounds", type=int, default=5, help="of the curves (default 5)")
    methods, parts = [e.key for e in ENTRANTS], ["curves", "plane", *TABLES]
    parser.add_argument("--methods", nargs="+", choices=methods, default=methods)
    parser.add_argument("--parts", nargs="+", choices=parts, default=parts,
                        help="default: all; the others are kept from the last run")
    parser.add_argument("--redraw", action="store_true", help="measure nothing")
    parser.add_argument("--earlier", type=Path, metavar="FILE", help="an earlier front.json")
    parser.add_argument("--gpu-report", nargs="?", type=Path, const=Path(gpu_report.FILE), metavar="FILE",
                        help=f"measure this device alone, into a file to send (default {gpu_report.FILE})")
    return parser.parse_args()


def main() -> int:
    """Measure, write, print."""
    chosen = arguments()
    if chosen.gpu_report is not None:
        return gpu_report.main(chosen.gpu_report)
    start = time.perf_counter()
    OUT.mkdir(parents=True, exist_ok=True)
    stored = OUT / "front.json"
    record: Record = {"size": chosen.size, "machine": {}, "curves": [], "tables": {}}
    if stored.exists():
        last = json.loads(stored.read_text(encoding="utf-8"))
        record = last if last["size"] == chosen.size or chosen.redraw else record
    if chosen.earlier is not None:
        record["earlier"] = _earlier(json.loads(chosen.earlier.read_text(encoding="utf-8")))
    if not chosen.redraw:
        measure(record, chosen, lambda words: print(f"{time.perf_counter() - start:6.1f} s  {words}", flush=True))
    if not chosen.redraw or chosen.earlier is not None:
        stored.write_text(json.dumps(record).replace('{"problem"', '\n{"problem"') + "\n", encoding="utf-8")
    front = [c for c in record["curves"] if not c["problem"]["plane"]]
    if front:
        chart.draw(front, record["machine"], OUT / "front", record.get("earlier"))
    page = write(record, OUT)
    print(summary(record))
    for row in judge(record):
        print(f"{ {True: 'met', False: 'BELOW', None: ''}[row.met]:7}{row.comparison}")
        print(f"{'':9}{f'wanted {row.wanted}; ' * bool(row.wanted)}reached {row.reached}")
    print(f"{page.relative_to(ROOT)} written; {time.perf_counter() - start:.0f} s")
    return 0


def _earlier(record: Record) -> Record:
    """Our own methods' curves of an earlier run."""
    return {"machine": record["machine"], "curves": [c for c in record["curves"] if c["family"] == "irpso"]}


def summary(record: Record) -> str:
    """The one table: of each curve its default, or its largest budget."""
    lines = [f"{'':40}{'budget':26}{'time':>10}{'albedo':>10}{'roughness':>11}{'failures':>10}"]
    for curve in record["curves"]:
        if curve["title"] not in lines:
            lines.append(curve["title"])
        p = next((p for p in curve["points"] if p["default"]), curve["points"][-1])
        lines.append(f"  {curve['label']:38}{p['setting']:26}{duration(p['seconds']):>10}{p['albedo']:10.5f}"
                     f"{p['roughness']:11.5f}{p['failures']:10.2%}")
    return "\n".join(lines)


def measure(record: Record, chosen: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Fill the record with the chosen parts."""
    device = Device()
    now = machine(device)
    apart = "curves" not in chosen.parts and record["machine"]  # the rest is of an earlier run
    record["machine"] = record["machine"] if apart else now
    when = {key: now[key] for key in ("commit", "date")} if apart else {}
    entrants = [e for e in ENTRANTS if e.key in chosen.methods]
    for entrant in entrants:
        if entrant.missing:
            say(f"{entrant.label}: left out, {entrant.needs} is not installed (requirements-bench.txt)")
    specs = [replace(s, size=chosen.size)
             for s in (*FRONT * ("curves" in chosen.parts), *[PLANE] * ("plane" in chosen.parts))]
    fresh = curves(device, specs, entrants, chosen.rounds, say)
    done = {(c["title"], c["method"]) for c in fresh}
    record["curves"] = [c for c in record["curves"] if (c["title"], c["method"]) not in done] + fresh
    order = {entrant.key: i for i, entrant in enumerate(ENTRANTS)}
    titles = [replace(s, size=chosen.size).title for s in (*FRONT, PLANE)]
    record["curves"].sort(key=lambda c: (titles.index(c["title"]), order[c["method"]]))
    for name, table in TABLES.items():
        if name in chosen.parts:
            say(f"table: {name}")
            record["tables"][name] = {**table(device, 3, chosen.size), **when}
    device.release()


if __name__ == "__main__":
    sys.exit(main())
