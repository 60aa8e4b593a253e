"""The stability atlas: ``python -m studies.stability`` (``make stability``).  Needs numpy, moderngl and matplotlib.

Sweeps every axis on which data can be poor, keeps what it measured in build/stability, and writes atlas.json, charts,
pictures and README.md into docs/stability.  --axes and --methods pick, --seeds says how many (default 20); what is
there already, made by the same code, is not made again.  --redraw: charts and page alone, from what is there.
"""

from __future__ import annotations

import argparse
import os
import sys
import time

from irpso_addon.gpu.device.context import Device

from .axes import AXES, ROW
from .identical import identical
from .methods import METHODS
from .page import publish, table
from .store import Store
from .sweep import sweep_all


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.stability", description=(__doc__ or "").splitlines()[0])
    axes, methods = [axis.key for axis in (*AXES, ROW)], [m.key for m in METHODS]
    parser.add_argument("--axes", nargs="+", choices=[*axes, "identical"], default=[*axes, "identical"], metavar="AXIS",
                        help=f"of {', '.join([*axes, 'identical'])}; default: all")
    parser.add_argument("--methods", nargs="+", choices=methods, default=methods)
    parser.add_argument("--seeds", type=int, default=20, help="default 20")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="axes at a time; default: processors")
    parser.add_argument("--redraw", action="store_true", help="measure nothing")
    parser.add_argument("--no-docs", action="store_true", help="measure and print alone")
    return parser.parse_args()


def main() -> int:
    """Measure, write, print."""
    chosen = arguments()
    start = time.perf_counter()
    axes = [axis for axis in (*AXES, ROW) if axis.key in chosen.axes]
    methods = [m for m in METHODS if m.key in chosen.methods]
    if not chosen.redraw:
        def say(words: str) -> None:
            print(f"{time.perf_counter() - start:6.1f} s  {words}", flush=True)

        sweep_all(axes, methods, chosen.seeds, chosen.jobs, say)
        if "identical" in chosen.axes:
            say("seeds, tile sizes and tile orders")
            device = Device()
            identical(device)
            device.release()
    device = Device()
    for axis in axes:
        print(table(axis, Store(axis).summaries(chosen.seeds)))
    if not chosen.no_docs:
        for path in publish(device, chosen.seeds):
            print(f"{path} written")
    device.release()
    print(f"{time.perf_counter() - start:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
