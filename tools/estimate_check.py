"""How near the estimate before a solve comes: the demo's vase solved in worker processes, as the add-on does.

    python tools/estimate_check.py

Writes the figures of docs/estimate.md.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.blender.files import blender_version, open_blend  # noqa: E402
from irpso_addon.blender.sample import demo  # noqa: E402  # the checkout is no installed package
from irpso_addon.blender.scene.scene import read_scene  # noqa: E402
from irpso_addon.cli.demo import make  # noqa: E402
from irpso_addon.core.data import SceneData, Solution  # noqa: E402
from irpso_addon.core.params import DeviceSettings, SolveSettings  # noqa: E402
from irpso_addon.core.reporting.estimates import ViewSize, estimate, learnt  # noqa: E402
from irpso_addon.process.remote import Remote  # noqa: E402
from studies import charts, pages  # noqa: E402

HEAD = """\
| views | size | model | method | measured | first | learnt | learnt / measured |
|---|---|---|---|---|---|---|---|"""
CASES = [  # the first is what is learnt from
    (16, 256, "auto", "refined"), (16, 256, "auto", "refined"), (16, 512, "auto", "refined"),
    (8, 256, "auto", "refined"), (31, 256, "auto", "refined"), (16, 1024, "auto", "refined"),
    (16, 256, "lambert", "refined"), (16, 256, "one-lobe", "refined"), (16, 256, "one-lobe-specular", "refined"),
    (16, 256, "two-lobe", "refined"), (16, 256, "auto", "draft"), (16, 256, "auto", "swarm")]


def main() -> None:
    """Solve and write the page."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["MESA_SHADER_CACHE_DIR"] = folder  # as on a machine that has solved nothing yet
        made = make(Path(folder))
        open_blend(made.scene)
        data = read_scene(None, demo.NAME, made.captures)
        rows, factors, worst = [], None, 1.0
        for count, size, model, method in CASES:
            part = replace(data, views=data.views[::max(1, len(data.views) // count)][:count])
            settings = SolveSettings(size=size, model=model, method=method, indirect="off")
            taken = [ViewSize(demo.PIXELS, demo.PIXELS, v.camera.name, len(v.lights)) for v in part.views]
            solution, wall = solve(part, settings)
            first = estimate(taken, settings, {}, DeviceSettings().memory).seconds
            later = estimate(taken, settings, factors or {}, DeviceSettings().memory).seconds
            learnt_words = "", ""
            if factors is None:
                factors = learnt({}, taken, settings, solution.seconds, wall)
            else:
                worst = max(worst, later / wall, wall / later)
                learnt_words = f"{later:.1f} s", f"{later / wall:.2f}"
            rows.append(f"| {count} | {size} | {model} | {method} | {wall:.1f} s | {first:.1f} s | "
                        f"{learnt_words[0]} | {learnt_words[1]} |")
            print(rows[-1], flush=True)
    pages.fill(pages.DOCS / "estimate.md", {
        "made": pages.measured(solution.device["renderer"], f"Blender {blender_version()}"),
        "table": "\n".join([HEAD, *rows]),
        "worst": f"The largest error after one solve is a factor of {worst:.2f}."})
    charts.draw("estimate")


def solve(data: SceneData, settings: SolveSettings) -> tuple[Solution, float]:
    """A solve in a process of its own, and its seconds from start to result."""
    start = time.perf_counter()
    solution: Solution = Remote("solve.pipeline:solve", data, settings).result()
    return solution, time.perf_counter() - start


if __name__ == "__main__":
    main()
