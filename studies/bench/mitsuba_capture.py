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
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
from irpso_addon.cli.chart import Curve, Panel, draw  # noqa: E402
from irpso_addon.core.evaluation.metrics import map_errors  # noqa: E402
from irpso_addon.core.phrases import percent  # noqa: E402
from studies import pages  # noqa: E402

HERE = Path(__file__).resolve().parent
PARTS = ("judge", "irpso", "stock", "matched")
LABELS = {"auto": "as it comes", "refined": "one lobe", "draft": "one lobe, draft", "stock": "Mitsuba, principled",
          "matched": "Mitsuba, matched", "nosolver": "no solver"}
COLUMNS = (  # title, mask, error, log axis, more is better
    ("base colour, PSNR in dB", "seen", "albedo_psnr", False, True),
    ("roughness, mean error", "seen", "rough_mae", True, False),
    ("informed roughness, mean error", "informed", "rough_mae", True, False))
HEAD = ("method", "setting", "seconds", "first", "base colour, dB", "roughness, mean error", "the same, informed",
        "share off by > 0.1", "the same, informed")


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
    rows = {"auto": [], "refined": [], "draft": []}
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
    versions = next(iter(results.values()))["versions"]
    return {"cpu": pages.processors(), "date": pages.today(), "commit": pages.commit(), **versions}


def machine_line(record):
    at = record["machine"]
    return pages.made(at["date"], at["commit"], at["cpu"], at["renderer"],
                      f"IRPSO {at['irpso']}, Blender {at['blender']}, Mitsuba {at['mitsuba']}")


def chart(record, stem):
    columns = []
    for name, capture in record["captures"].items():
        columns.append([Panel(f"{name}: {title}", [
            Curve(LABELS[method], place, None if rows[0]["seconds"] is None else [row["seconds"] for row in rows],
                  [row[mask][error] for row in rows],
                  [str(row["size"]) if row in (rows[0], rows[-1]) else "" for row in rows]
                  if method == "auto" else ())
            for place, (method, rows) in zip((3, 0, 1, 4, 5, 6), capture["rows"].items(), strict=True)],
            log=log, up=up) for title, mask, error, log, up in COLUMNS])
    first = next(iter(record["captures"].values()))
    draw(list(zip(*columns, strict=True)),
         f"Captures of {first['views']} views, {first['pixels']} pixels: accuracy against the time of the whole solve "
         "(IRPSO: the points are map sizes)", machine_line(record), stem)


def page(record, path):
    tables = []
    for name, capture in record["captures"].items():
        rows = [table_row(method, row) for method, rows in capture["rows"].items() for row in rows]
        texels = capture["texels"]
        tables.append(f"## {name}\n\n{texels['seen']:,} texels seen, {texels['informed']:,} informed.\n\n"
                      f"{pages.table(HEAD, rows)}\n")
    pages.fill(pages.DOCS / "benchmarks" / "captures.md",
               {"made": machine_line(record), "tables": "\n".join(tables)}, path)


def table_row(method, row):
    seen, informed = row["seen"], row["informed"]
    number = lambda value, digits: "" if value is None else f"{value:.{digits}f}"  # noqa: E731
    setting = f"{row['size']} x {row['size']}" if "size" in row else ""
    return [LABELS[method], setting, number(row["seconds"], 2), number(row.get("first_seconds"), 2),
            number(seen["albedo_psnr"], 1), number(seen["rough_mae"], 3), number(informed["rough_mae"], 4),
            percent(seen["rough_fail"], 1), percent(informed["rough_fail"], 1)]


if __name__ == "__main__":
    main()
