"""``python -m studies.corrected``: makes docs/corrected.md, what errors of a scene cost, and what is left of that.

The patches of studies/stability are solved with one thing wrong (and with all of them at once), as given and after the
corrections that a solve makes by itself.  --seeds: patches of each case (default 4); with another number, no page.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from irpso_addon.core.phrases import percent
from irpso_addon.gpu.device.context import Device
from studies import charts, pages
from studies.stability.measure import Record, record
from studies.stability.methods import BY_KEY, Table
from studies.stability.problem import Problem, Trial, make
from studies.stability.righted import righted
from studies.stability.sweep import answered

PAGE = pages.DOCS / "corrected.md"
SEEDS = 4
CASES = (
    ("nothing", "as it is", Trial()),
    *(("places of lamps", f"{percent(by, 1)} of their distance", Trial(moved=by)) for by in (0.005, 0.01, 0.02)),
    *(("powers", percent(by), Trial(gain=by)) for by in (0.01, 0.03, 0.1)),
    *(("response", f"exponent {power:g}", Trial(tone=power)) for power in (0.95, 0.8, 0.4545)),
    *(("ambient light", f"{percent(by)} of a lamp's", Trial(bounce=by)) for by in (0.01, 0.05, 0.2)),
    ("all of these", "1 %, 3 %, exponent 0.97, 1 %", Trial(moved=0.01, gain=0.03, tone=0.97, bounce=0.01)),
    ("the material", "diffuse that is not Lambert's", Trial(diffuse=1.0)),
)
HEAD = ("wrong", "by", "off, as given", "off, corrected", "roughness, as given", "roughness, corrected", "changed")


def solved(device: Device, problem: Problem) -> Record:
    """How far the default method is off."""
    table = Table(device, problem)
    answer, warnings = answered(device, table, BY_KEY["refined"])
    table.release()
    return record(problem, answer, warnings=warnings)


def row(device: Device, name: str, by: str, trial: Trial, seeds: int) -> list[str]:
    """Of the table."""
    given, after, changed = [], [], 0
    for seed in range(seeds):
        problem = make(replace(trial, seed=seed))
        better = righted(problem)
        given.append(solved(device, problem))
        after.append(given[-1] if better is problem else solved(device, better))
        changed += better is not problem

    def mean(records: list[Record], key: str) -> float:
        return float(np.mean([found[key] for found in records]))

    return [name, by, *(percent(mean(found, "failures"), 1) for found in (given, after)),
            *(f"{mean(found, 'roughness'):.4f}" for found in (given, after)), f"{changed} of {seeds}"]


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.corrected", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"default {SEEDS}")
    parser.add_argument("--out", type=Path, default=PAGE, help="the page")
    options = parser.parse_args()
    device, rows = Device(), []
    for name, by, trial in CASES:
        rows.append(row(device, name, by, trial, options.seeds))
        print(" | ".join(rows[-1]), flush=True)
    renderer = str(device.describe().get("renderer", ""))
    device.release()
    if options.seeds == SEEDS:
        pages.fill(PAGE, {"made": pages.measured(renderer), "table": pages.table(HEAD, rows)}, options.out)
        charts.draw("corrected")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
