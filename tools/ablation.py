"""What each part of the method is worth: the demo's vase solved without it.  Writes docs/ablation.md.

    python tools/ablation.py [--size 512]

The references are the demo's, rendered once into build/bench.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.blender.files import open_blend  # noqa: E402
from irpso_addon.blender.scene.scene import read_scene  # noqa: E402
from irpso_addon.cli.demo import make, score  # noqa: E402
from irpso_addon.core.data import Solution  # noqa: E402
from irpso_addon.core.params import SolveSettings  # noqa: E402
from irpso_addon.core.samples import vase  # noqa: E402
from irpso_addon.gpu.device import thread  # noqa: E402
from irpso_addon.gpu.solve.neighbours import ALIKE  # noqa: E402
from irpso_addon.solve import pipeline  # noqa: E402  # the checkout is no installed package
from studies import charts, pages  # noqa: E402

VARIANTS: list[tuple[str, dict[str, Any], bool]] = [
    ("all of it", {}, False),
    ("pixels taken for points (no footprint)", {}, True),
    ("a pixel counts in full however far from the texel", {"observe.observation_atlas.REACH": 1e6}, False),
    ("edges count like other pixels", {"observe.view_drawing.EDGE_WEIGHT": 1.0}, False),
    ("one base colour for all cameras",
     {"solve.solver.FIRST_SLACK": 0.0, "observe.observation_atlas.CAMERA_SLACK": 0.0}, False),
    ("normals taken as exact", {"observe.observation_atlas.Tilts": lambda *_: None}, False),
    ("no neighbours", {"solve.neighbours.ROUGHNESS_SLOPE": 1e6}, False),
    ("neighbours' errors taken for alike", {"solve.neighbours.Shared.gain": lambda *_: ALIKE}, False),
    ("base colour: no outliers expected", {"maps.albedo.ROBUST_PASSES": 1}, False),
    ("base colour: mean of what the cameras show", {"maps.finish_maps.ITERATIONS": 0}, False),
]
HEAD = """\
| | base colour (dB) | roughness mean | median | mean of the confident texels |
|---|---|---|---|---|"""


def main() -> int:
    """Solve the vase once for each variant and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=512)
    size = parser.parse_args().size
    out = ROOT / "build" / "bench"
    out.mkdir(parents=True, exist_ok=True)
    made = make(out)
    open_blend(made.scene)
    scene = read_scene(None, None, made.captures)
    rows, solved = [], None
    for name, constants, points in VARIANTS:
        with ExitStack() as stack:
            for key, value in constants.items():
                stack.enter_context(patch(f"irpso_addon.gpu.{key}", value))
            data = replace(scene, pixel_filter=0.01) if points else scene
            solution: Solution = thread.run(lambda data=data: pipeline.solve(data, SolveSettings(size=size)))
        solved = solution.maps.filled if solved is None else solved  # the same texels are judged for all
        found = score(vase.truth(size), replace(solution.maps, filled=solved))
        rows.append(f"| {name} | {found.albedo_psnr:.1f} | {found.rough_mae:.4f} | {found.rough_median:.4f} "
                    f"| {found.rough_mae_confident:.4f} |")
        print(rows[-1], flush=True)
    pages.fill(pages.DOCS / "ablation.md", {
        "made": pages.measured(solution.device["renderer"]), "table": "\n".join([HEAD, *rows])})
    charts.draw("ablation")
    return 0


if __name__ == "__main__":
    sys.exit(main())
