"""Accuracy against time on captures: the product, Mitsuba 3 and no solver at all; chart, page and JSON by one command.

  python studies/bench/mitsuba_capture.py CAPTURE... [--work DIR] [--out docs/benchmarks] [--blender-python PYTHON]
        [--budget 90] [--again PART]

Runs under a Python with Mitsuba and matplotlib (requirements-bench.txt) and starts the parts that need Blender with
--blender-python.  A CAPTURE is a folder as capture_judge.py describes it.  Every part leaves a file in --work and is
not run again while that is there, unless --again names it (judge, irpso, stock, matched, or all).  Parts run one at a
time: the times are those of a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
from irpso_addon.cli.chart import Curve, Panel, draw  # noqa: E402
from irpso_addon.core.evaluation.metrics import map_errors  # noqa: E402

HERE = Path(__file__).resolve().parent
PARTS = ("judge", "irpso", "stock", "matched")
LABELS = {"refined": "refined", "draft": "draft", "stock": "Mitsuba, principled", "matched": "Mitsuba, matched",
          "nosolver": "no solver"}
COLUMNS = (  # title, mask, error, log axis, more is better
    ("base colour, PSNR in dB", "seen", "albedo_psnr", False, True),
    ("roughness, mean error", "seen", "rough_mae", True, False),
    ("informed roughness, mean error", "informed", "rough_mae", True, False))
PAGE = """\
# Captures: accuracy against the time of the whole solve

Objects rendered by Cycles with known maps, {views} views of {pixels} pixels each (one point light on in each); every
method gets the same pictures and is judged on the same 256 x 256 texels by `studies/bench/capture_judge.py`: texels
that at least three views see lit, and of those the *informed* ones, near which a highlight came.  {machine}

![chart](captures.png)

* **refined, draft**: `pipeline.solve` from the scene's arrays, every reference read from disk, to the maps; the points
  are map sizes.  Starting Python, Blender and OpenGL and opening the .blend are not in the time.  The first solve in a
  process, which also compiles the shaders, is the column *first*.
* **Mitsuba, principled**: Mitsuba 3's own `principled` BSDF and Adam, as a practitioner would set it up; **matched**:
  the same with a BSDF that equals Cycles'.  The settings are the best found by their score on the truth
  (`studies/bench/capture_mitsuba.py`).  Seconds inside the optimisation's loop; importing Mitsuba and loading the scene
  are not in the time.
* **no solver**: each texel's median over the views of radiance divided by the irradiance of an unshadowed Lambert
  surface, roughness 0.5.  It is drawn as a level.

{tables}
Made by `python studies/bench/mitsuba_capture.py CAPTURE...`; all figures in `captures.json`.
"""


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    options.add_argument("--work", type=Path, default=ROOT / "build" / "captures")
    options.add_argument("--out", type=Path, default=ROOT / "docs" / "benchmarks")
    options.add_argument("--blender-python", default=str(ROOT / ".venv" / "bin" / "python"))
    options.add_argument("--budget", type=float, default=90.0, help="seconds of each Mitsuba run")
    options.add_argument("--again", choices=(*PARTS, "all"), action="append", default=[])
    given = options.parse_args()
    results = {}
    for capture in given.captures:
        work = given.work / capture.name
        for part in PARTS:
            run_part(part, capture, work, given)
        results[capture.name] = collect(capture, work)
    given.out.mkdir(parents=True, exist_ok=True)
    record = {"machine": machine(results), "captures": results}
    (given.out / "captures.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    chart(record, given.out / "captures")
    page(record, given.out / "captures.md")
    print(f"{given.out}: captures.json, captures.md, captures.png, captures.svg")


def run_part(part, capture, work, given):
    """Run one part unless its file is there."""
    product = work / ("judge.npz" if part == "judge" else f"{part}.json")
    if product.exists() and part not in given.again and "all" not in given.again:
        return
    work.mkdir(parents=True, exist_ok=True)
    script, python, more = {
        "judge": ("capture_judge.py", given.blender_python, [work]),
        "irpso": ("capture_irpso.py", given.blender_python, [work, product]),
    }.get(part, ("capture_mitsuba.py", sys.executable, [work, product, "--bsdf", part, "--budget", given.budget]))
    print(f"{capture.name}: {part}", flush=True)
    subprocess.run([python, HERE / script, capture, *map(str, more)], check=True)


def collect(capture, work):
    """All of one capture's rows: method -> list of {seconds, seen, informed, ...}."""
    irpso = json.loads((work / "irpso.json").read_text())
    judge, nosolver = np.load(work / "judge.npz"), np.load(work / "nosolver.npz")
    rows = {"refined": [], "draft": []}
    for row in irpso["rows"]:
        rows[row["method"]].append(row)
    versions = irpso["versions"] | {"renderer": irpso["device"]["renderer"]}
    for part in ("stock", "matched"):
        run = json.loads((work / f"{part}.json").read_text())
        rows[part] = run["rows"]
        versions |= run["versions"]
    rows["nosolver"] = [{"seconds": None, **{
        where: asdict(map_errors(nosolver["base"], nosolver["rough"], judge["base"], judge["rough"], judge[where]))
        for where in ("seen", "informed")}}]
    views = json.loads((capture / "captures.json").read_text())["views"]
    return {"rows": rows, "versions": versions, "views": len(views),
            "pixels": picture_size(capture / views[0]["image"]),
            "texels": {where: int(judge[where].sum()) for where in ("seen", "informed")}}


def picture_size(path):
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    width, height = mi.Bitmap(str(path)).size()
    return f"{width} x {height}"


def machine(results):
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        processor = platform.processor() or "unknown CPU"
    versions = next(iter(results.values()))["versions"]
    return {"processor": processor, "cores": os.cpu_count(), "system": f"{platform.system()} {platform.machine()}",
            "date": time.strftime("%Y-%m-%d"), **versions}


def machine_line(record):
    at = record["machine"]
    return (f"{at['processor']}, {at['cores']} cores, {at['renderer']}; IRPSO {at['irpso']}, Blender {at['blender']}, "
            f"Mitsuba {at['mitsuba']}; {at['date']}.")


def chart(record, stem):
    panels = []
    for name, capture in record["captures"].items():
        panels.append([Panel(f"{name}: {title}", [
            Curve(LABELS[method], place, None if rows[0]["seconds"] is None else [row["seconds"] for row in rows],
                  [row[mask][error] for row in rows],
                  [str(row["size"]) for row in rows] if method == "refined" else ())
            for place, (method, rows) in zip((0, 1, 4, 5, 6), capture["rows"].items(), strict=True)],
            log=log, up=up) for title, mask, error, log, up in COLUMNS])
    first = next(iter(record["captures"].values()))
    draw(panels, f"Captures of {first['views']} views, {first['pixels']} pixels: accuracy against the time of the "
                 "whole solve (refined: the points are map sizes)", machine_line(record), stem)


def page(record, path):
    tables = []
    for name, capture in record["captures"].items():
        lines = [f"## {name}", "", f"{capture['texels']['seen']:,} texels seen, {capture['texels']['informed']:,} "
                 "informed.", "", "| method | setting | seconds | first | base colour, dB | roughness, mean error | "
                 "informed | share off by > 0.1 | informed |", "|---|---|---:|---:|---:|---:|---:|---:|---:|"]
        for method, rows in capture["rows"].items():
            lines += [table_row(method, row) for row in rows]
        tables.append("\n".join([*lines, ""]))
    first = next(iter(record["captures"].values()))
    path.write_text(PAGE.format(views=first["views"], pixels=first["pixels"], machine=machine_line(record),
                                tables="\n".join(tables)), encoding="utf-8")


def table_row(method, row):
    seen, informed = row["seen"], row["informed"]
    number = lambda value, digits: "" if value is None else f"{value:.{digits}f}"  # noqa: E731
    setting = f"{row['size']} x {row['size']}" if "size" in row else ""
    return " | ".join([f"| {LABELS[method]}", setting, number(row["seconds"], 2), number(row.get("first_seconds"), 2),
                       number(seen["albedo_psnr"], 1), number(seen["rough_mae"], 3), number(informed["rough_mae"], 4),
                       f"{seen['rough_fail']:.1%}", f"{informed['rough_fail']:.1%} |"])


if __name__ == "__main__":
    main()
