"""``python -m studies.resilience --kills 1000``: a small large solve, killed at random moments until it is done.

Again and again.  After each kill every file in the output folder must be whole or absent and no finished block lost; a
run that comes to its end must leave the bytes of an undisturbed one.  Also disks that are full, and two runs at once.
Prints a table; exit status 1 and one line for the first thing that is torn.  Linux; disks of its own as root alone.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from .harness import Campaign, Torn


def main() -> int:
    """Run the campaigns, print what happened."""
    parser = argparse.ArgumentParser(prog="python -m studies.resilience", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--pairs", type=int, default=20, help="times that two runs start at once; default 20")
    parser.add_argument("--disks", type=int, default=10, help="full disks; default 10")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time; default: processors")
    chosen = parser.parse_args()
    began = time.perf_counter()
    disks = chosen.disks if os.geteuid() == 0 else 0

    def share(whole: int, n: int) -> int:
        return whole * (n + 1) // chosen.jobs - whole * n // chosen.jobs

    def campaign(n: int) -> tuple[Campaign, int, int]:
        made = Campaign(Path(folder) / str(n), 1000 * chosen.seed + n)
        try:
            told, full = made.pairs(share(chosen.pairs, n)), made.full_disks(share(disks, n))
            wanted = share(chosen.kills, n)
            while made.kills < wanted:
                made.run(min(made.kills + 25, wanted))
                seconds = time.perf_counter() - began
                print(f"{seconds:6.0f} s  seed {made.seed}: {made.kills} kills, {made.rounds} rounds", flush=True)
            return made, told, full
        finally:
            made.close()

    with tempfile.TemporaryDirectory(prefix="irpso-resilience-") as folder, ThreadPoolExecutor(chosen.jobs) as pool:
        try:
            done = list(pool.map(campaign, range(chosen.jobs)))
        except Torn as error:
            print(f"TORN: {error}")
            return 1
    where = sum((made.where for made, _, _ in done), Counter[str]())
    rows = {"kills": sum(made.kills for made, _, _ in done),
            **{f"    at: {stage}": count for stage, count in sorted(where.items())},
            "rounds from nothing or older results to the end": sum(made.rounds for made, _, _ in done),
            "writes refused beyond a size, told in one line": sum(made.refusals for made, _, _ in done),
            f"full disks met on {disks} disks that grew": sum(full for _, _, full in done),
            f"second runs told of the first, of {chosen.pairs} pairs": sum(told for _, told, _ in done),
            "torn files, other bytes, lost blocks, processes left": 0}
    for name, value in rows.items():
        print(f"{name:55} {value:6}")
    print(f"{time.perf_counter() - began:.0f} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
