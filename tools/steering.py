"""What a solve of a part, and a start at the last result, save and cost: the demo's vase.

    python tools/steering.py [--size 512]

Writes docs/steering.md.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

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

PAGE = """\
# Solving a part, and starting from the last result

**Part** (Solve panel) solves only a region of an object: where a vertex group weighs more than 0.5, where an image
over the UV map is white, or the faces selected in Edit Mode. The button below it enters the mode in which you mark
the region. Elsewhere the object keeps the last result since the file was opened, or else the maps that the materials
carry. At the border the new result fades into the old one over {seam} texels (at most 1/32 of the map). The distance
is measured on the surface, so the fade crosses seams of the UV map, but it does not enter other materials. A material
of which only a part is solved keeps its model and its Specular IOR Level.

**Start: Last** begins the search of each texel at the last result. It uses half the particles: the first starts at
the last result, the others start elsewhere in case that was wrong. With model Auto the materials keep their models.
Method `paper` has no such start.

On the command line: `irpso solve SCENE_irpso.blend --vertex-group NAME`, `--part-image FILE` or `--selected-faces`,
and `--start last`.

## What that saves

Made by `python tools/steering.py`: the demo's vase at {size} x {size}, {views} views, after a solve that has compiled
its shaders. Errors against the truth over the texels that the solve anew has solved.

| | texels solved | seconds | of them solve | roughness, mean error | base colour, PSNR |
|---|---|---|---|---|---|
{rows}

Without noise, the texels of the part agree with the whole solve to 0.001, and texels beyond the seam keep their values
(`tests/gpu/test_part.py`).
"""


def main() -> None:
    """Solve and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=512)
    size = parser.parse_args().size
    with tempfile.TemporaryDirectory() as folder:
        made = make(Path(folder), demo.Plan(texels=size))
        open_blend(made.scene)
        scene = read_scene(None, demo.NAME, made.captures)
        rows = measure(scene, SolveSettings(size=size, indirect="off", registration="given"))
    (ROOT / "docs" / "steering.md").write_text(PAGE.format(
        size=size, views=len(scene.views), rows="\n".join(rows), seam=8), encoding="utf-8")


def measure(scene: SceneData, settings: SolveSettings) -> list[str]:
    """A row for each way; each is solved twice, the second time counts."""
    anew, _ = timed(scene, settings)
    draft, _ = timed(scene, replace(settings, method="draft"))
    where = anew.maps.coverage & ~anew.maps.filled
    truth = vase.truth(settings.size)
    last = replace(settings, start="last")
    ways: dict[str, tuple[SceneData, SolveSettings]] = {
        "anew": (scene, settings),
        "from that result": (replace(scene, start=bare(anew)), last),
        "from a draft": (replace(scene, start=bare(draft)), last),
        "a part of a twentieth": (replace(scene, start=bare(anew), region=nearest(scene, 0.05)), settings),
        "a part of a fifth": (replace(scene, start=bare(anew), region=nearest(scene, 0.2)), settings),
        "a fifth, from that result": (replace(scene, start=bare(anew), region=nearest(scene, 0.2)), last),
    }
    rows = []
    for name, (data, how) in ways.items():
        timed(data, how)
        solution, seconds = timed(data, how)
        found = solution.maps.base_color, solution.maps.roughness
        errors = map_errors(*(array.astype(np.float64) for array in (*found, *truth)), where)
        rows.append(f"| {name} | {solution.texels['solved']:,} | {seconds:.1f} | {solution.seconds['solve']:.1f} | "
                    f"{errors.rough_mae:.4f} | {errors.albedo_psnr:.1f} dB |")
        print(rows[-1], flush=True)
    return rows


def timed(scene: SceneData, settings: SolveSettings) -> tuple[Solution, float]:
    """The solution and how long it took, seconds."""
    start = time.perf_counter()
    job: Callable[[], Any] = lambda: pipeline.solve(scene, settings)  # noqa: E731
    return thread.run(job), time.perf_counter() - start


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
