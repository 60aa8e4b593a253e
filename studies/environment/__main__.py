"""``python -m studies.environment``: makes docs/environment.md, how exact light from all around is, and what it tells.

Needs Blender as a module and matplotlib.  Pictures are kept in build/environment.  --rigs: these alone, and no page.
--radiance, --solves, --turned, --poor: the tables of the forward model, of solves, of worlds that are turned, or of
worlds whose picture is poor, alone.
--mitsuba PYTHON: the comparison with Mitsuba, alone.
--photographs DIR: the table of summed photographs, alone, of a folder with scene.blend and captures.json.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.shading import environment
from irpso_addon.gpu.device import thread
from irpso_addon.solve.device_test import detect
from studies.environment import photographs, poor, radiance
from studies.environment.contest import compare
from studies.environment.converge import convergence
from studies.environment.hdris import KINDS
from studies.environment.page import (
    draw,
    error_row,
    poor_row,
    recovered_row,
    turned_row,
    write,
    write_photographs,
    write_poor,
    write_solves,
    write_turned,
)
from studies.environment.recover import recover
from studies.environment.recover import turned as about
from studies.environment.shoot import RIGS

ROOT = Path(__file__).resolve().parents[2]
ROUGHNESS = (0.1, 0.2, 0.4, 0.7)
TURNS = (1.0, 3.0, 8.0)  # degrees
PIXELS, SAMPLES = 28, 8192


def turned(pictures: Path, page: Path) -> None:
    """One HDRI that is off about Z, as given and corrected."""
    rig, rows = RIGS[0], []
    for degrees, lamps in itertools.product((0.0, *TURNS), ("given", "auto")):
        found, solution = recover(rig, pictures / rig.name, lamps=lamps, change=about(degrees))
        rows.append(turned_row(degrees, lamps, found, solution))
        print(rows[-1], flush=True)
    write_turned(rows, solution.device.get("renderer", ""), page)


def poor_pictures(pictures: Path, page: Path) -> None:
    """One HDRI of fewer pixels, or clipped."""
    found = []
    for each in poor.measured(pictures):
        found.append(each)
        print(poor_row(each), flush=True)
    write_poor(found, thread.run(detect).renderer, page)


def forward(samples: int, out: Path) -> None:
    """The forward model beside Cycles, and beside sums over all pixels of the HDRIs."""
    errors = []
    for shape in radiance.SHAPES:
        for kind in KINDS:
            for error in radiance.errors(shape, kind, ROUGHNESS, PIXELS, samples, environment.COUNT):
                errors.append(error)
                print(error_row(error), flush=True)
    converged = list(convergence())
    draw(converged, out / "environment.svg")
    write(converged, errors, thread.run(detect).renderer, out / "environment.md")


def main() -> int:
    """Command line."""
    names = [rig.name for rig in RIGS]
    parser = argparse.ArgumentParser(prog="python -m studies.environment", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rigs", nargs="+", choices=names, metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--radiance", action="store_true", help="the tables of the forward model, and no other")
    parser.add_argument("--solves", action="store_true", help="the table of solves, and no other")
    parser.add_argument("--turned", action="store_true", help="the table of worlds that are turned, and no other")
    parser.add_argument("--poor", action="store_true", help="the table of worlds whose picture is poor, and no other")
    parser.add_argument("--mitsuba", metavar="PYTHON", help="a Python that has Mitsuba (requirements-bench.txt): the "
                        "comparison with it, and no other table")
    parser.add_argument("--photographs", metavar="DIR", type=Path, help="a capture folder of photographs from one "
                        "camera under one sun each, of which \"split\" says which are fitted: the table of their sums "
                        "under worlds, and no other")
    parser.add_argument("--counts", type=int, nargs="+", default=photographs.COUNTS, help="of summed photographs")
    parser.add_argument("--budget", type=float, default=60.0, help="seconds of each run of Mitsuba")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="of Cycles, a pixel, where radiance is compared")
    parser.add_argument("--pictures", type=Path, default=ROOT / "build" / "environment", help="folder that keeps them")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder for environment.md and its chart")
    options = parser.parse_args()
    ensure_openimageio()
    if options.mitsuba:
        compare(options.pictures, options.mitsuba, options.budget, options.out)
        return 0
    if options.photographs:
        rows = []
        for row in photographs.compare(options.photographs, options.counts):
            rows.append(row)
            print(row, flush=True)
        write_photographs(rows, thread.run(detect).renderer, options.out / "environment.md")
        return 0
    if options.radiance:
        forward(options.samples, options.out)
        return 0
    if options.turned:
        turned(options.pictures, options.out / "environment.md")
        return 0
    if options.poor:
        poor_pictures(options.pictures, options.out / "environment.md")
        return 0
    solves = []
    for rig in RIGS:
        if rig.name in (options.rigs or names):
            found, solution = recover(rig, options.pictures / rig.name)
            solves.append(found)
            print(recovered_row(solves[-1]), flush=True)
    if options.rigs is not None:
        return 0
    write_solves(solves, solution.device.get("renderer", ""), options.out / "environment.md")
    if options.solves:
        return 0
    forward(options.samples, options.out)
    turned(options.pictures, options.out / "environment.md")
    poor_pictures(options.pictures, options.out / "environment.md")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
