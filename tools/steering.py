"""What a solve of a region, and a start at the last result, save and cost: the demo's vase.

    python tools/steering.py [--size 512]

Fills a table of docs/guide.md and the line that says where it was measured; the size and the number of views stand in
the text above it.  Seconds are those of a processor, which other programs on the machine hardly change.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.blender.files import open_blend  # noqa: E402
from irpso_addon.blender.sample import demo  # noqa: E402
from irpso_addon.blender.scene.scene import read_scene  # noqa: E402
from irpso_addon.cli.demo import make  # noqa: E402
from irpso_addon.core.data import Region, SceneData, Solution  # noqa: E402
from irpso_addon.core.evaluation.metrics import map_errors  # noqa: E402
from irpso_addon.core.params import SolveSettings  # noqa: E402
from irpso_addon.core.samples import vase  # noqa: E402
from irpso_addon.gpu.device import thread  # noqa: E402
from irpso_addon.solve import pipeline  # noqa: E402  # the checkout is no installed package
from studies import pages  # noqa: E402

PAGE = ROOT / "docs" / "guide.md"


def main() -> None:
    """Solve and fill the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=512)
    size = parser.parse_args().size
    with tempfile.TemporaryDirectory() as folder:
        made = make(Path(folder), demo.Plan(texels=size))
        open_blend(made.scene)
        scene = read_scene(None, demo.NAME, made.captures)
        rows, renderer = measure(scene, SolveSettings(size=size, indirect="off", registration="given"))
    table = re.compile(r"(<!-- steering -->\n\n\|.*\n\|.*\n)(\|.*\n)*")
    page, count = table.subn(lambda found: found[1] + "\n".join(rows) + "\n", PAGE.read_text(encoding="utf-8"))
    assert count == 1, f"{PAGE}: no table 'steering'"
    PAGE.write_text(page, encoding="utf-8")
    pages.fill(PAGE, {"steering made": pages.measured(renderer, f"Blender {bpy.app.version_string}")})


def measure(scene: SceneData, settings: SolveSettings) -> tuple[list[str], str]:
    """A row for each way, each solved twice, of which the second time counts; the renderer."""
    anew, _ = timed(scene, settings)
    draft, _ = timed(scene, replace(settings, method="draft"))
    where = anew.maps.coverage & ~anew.maps.filled
    truth = vase.truth(settings.size)
    last = replace(settings, start="last")
    ways: dict[str, tuple[SceneData, SolveSettings]] = {
        "from scratch": (scene, settings),
        "from that result": (replace(scene, start=bare(anew)), last),
        "from a draft": (replace(scene, start=bare(draft)), last),
        "a twentieth of the object": (replace(scene, start=bare(anew), region=nearest(scene, 0.05)), settings),
        "a fifth of the object": (replace(scene, start=bare(anew), region=nearest(scene, 0.2)), settings),
        "a fifth, from that result": (replace(scene, start=bare(anew), region=nearest(scene, 0.2)), last),
    }
    rows = []
    for name, (data, how) in ways.items():
        timed(data, how)
        solution, seconds = timed(data, how)
        found = solution.maps.base_color, solution.maps.roughness
        errors = map_errors(*(array.astype(np.float64) for array in (*found, *truth)), where)
        rows.append(f"| {name} | {solution.texels['solved']:,} | {seconds:.1f} | "
                    f"{errors.rough_mae:.4f} | {errors.albedo_psnr:.1f} dB |")
        print(rows[-1], flush=True)
    return rows, anew.device["renderer"]


def timed(scene: SceneData, settings: SolveSettings) -> tuple[Solution, float]:
    """The solution and how long it took, processor seconds of this process."""
    start = time.process_time()
    job: Callable[[], Any] = lambda: pipeline.solve(scene, settings)  # noqa: E731
    return thread.run(job), time.process_time() - start


def bare(solution: Solution) -> Solution:
    """As the last result is handed over."""
    return replace(solution, checks=None, pictures=())


def nearest(scene: SceneData, share: float) -> Region:
    """That share of the faces, round one in the middle of the vase."""
    middle = scene.mesh.positions.mean(axis=1)
    far = np.linalg.norm(middle - middle[np.argmin(np.abs(middle[:, 2] - np.median(middle[:, 2])))], axis=1)
    return Region(corners=np.repeat((far < np.quantile(far, share))[:, None], 3, axis=1).astype(np.float32))


if __name__ == "__main__":
    main()
