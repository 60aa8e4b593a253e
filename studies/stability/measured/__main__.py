"""``python -m studies.stability.measured --data DIR``: makes docs/stability/measured.md with its charts and picture."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from irpso_addon.gpu.device.context import Device

from . import foreseen, merl, page, picture
from .run import run

OUT = Path(__file__).resolve().parents[3] / "docs" / "stability"


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.stability.measured", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, metavar="DIR",
                        help=f"folder with {merl.NETWORKS} and {', '.join(merl.FITS.values())}")
    parser.add_argument("--cow", type=Path, metavar="OBJ", help="a mesh with UVs: solved beside the sphere")
    parser.add_argument("--only", default="", metavar="TEXT", help="materials with this in their names")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for measured.md and its pictures")
    options = parser.parse_args()
    start, device, materials = time.perf_counter(), Device(), []
    for material in run(device, options.data, options.cow, lambda name: options.only in name):
        materials.append(material)
        print(f"{len(materials):3d} {material.name:28s} {time.perf_counter() - start:6.1f} s", file=sys.stderr)
    options.out.mkdir(parents=True, exist_ok=True)
    picture.chart(materials, options.out / "measured.png")
    picture.spheres(materials, options.out / "measured-spheres.jpg")
    foreseen.chart(materials, options.out / "measured-foreseen.png")
    page.write(materials, device.describe()["renderer"], options.out / "measured.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
