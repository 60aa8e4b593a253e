"""``python -m studies.intervals``: makes docs/intervals.md, whether intervals and confidence hold on pictures.

Four assets that were made for it are rendered by Cycles, one of them path-traced too, and solved with `auto`.
Needs Blender as a module and matplotlib.  Pictures are kept in build/intervals.  --assets: these alone, and no page.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.data import Solution
from studies.intervals.assets import ASSETS, Asset
from studies.intervals.measure import Figures, measure
from studies.intervals.page import draw, row, write

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "build" / "intervals"


def main() -> int:
    """Command line."""
    names = [asset.name for asset in ASSETS]
    parser = argparse.ArgumentParser(prog="python -m studies.intervals", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--assets", nargs="+", choices=names, metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--pictures", type=Path, default=PICTURES, help="folder that keeps them")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder for intervals.md and intervals.jpg")
    options = parser.parse_args()
    ensure_openimageio()
    found = list[tuple[Asset, Solution, Figures]]()
    for asset in ASSETS:
        if asset.name in (options.assets or names):
            solution, figures = measure(asset, options.pictures / asset.name)
            found.append((asset, solution, figures))
            print(row(asset, solution, figures), flush=True)
    if options.assets is None:
        draw(found, options.out / "intervals.jpg")
        write(found, options.out / "intervals.md")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
