"""``python -m studies.rungs --data DIR``: makes docs/rungs.md, which further sockets of the Principled BSDF pay.

Each of the measured materials of studies/stability/measured is one material on a sphere; a third of the lamps is left
out, three times.  Rung by rung the Principled BSDF gets another number, and the held-out lamps say whether it pays.
"""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from studies.stability.measured import merl

from . import page
from .measure import one

OUT = Path(__file__).resolve().parents[2] / "docs"


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.rungs", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help=f"folder with {merl.NETWORKS}")
    parser.add_argument("--only", default="", metavar="TEXT", help="materials with this in their names")
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for rungs.md and rungs.png")
    options = parser.parse_args()
    from . import cycles  # needs bpy, and no other process does

    table = cycles.sheen_table()
    near = {name: error for name, error in cycles.errors(table, 64)}
    results, seconds = {}, time.process_time()
    networks = [network for network in merl.networks(options.data) if options.only in network.name]
    with get_context("spawn").Pool(options.jobs) as pool:
        for name, used, found in pool.imap(partial(one, table=table, noises=page.FOLDS), networks):
            results[name], seconds = found, seconds + used
            print(f"{len(results):3d} {name:28s} {used:5.1f} s", file=sys.stderr)
    page.chart(results, options.out / "rungs.png")
    page.write(results, near, options.out / "rungs.md")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
