"""The product on a capture: accuracy against the wall time of the whole solve.

  python studies/bench/capture_irpso.py CAPTURE EXPORT OUT.json        (a Python with bpy)

EXPORT is what capture_judge.py made of CAPTURE.  Seconds are those of pipeline.solve: from the scene's arrays, with
every reference read from disk, to the maps.  Opening the .blend and starting Python, Blender and OpenGL are not in
them, as importing Mitsuba and loading its scene are not in its times.  Each setting is solved once for the warm-up
(`first_seconds`: shaders are compiled in it) and then REPEATS times; the median counts.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from irpso_addon.blender import files
from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.evaluation.metrics import map_errors
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.resampling import at_size
from irpso_addon.core.versions import versions
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline

REPEATS = 3
# Settings and sizes; "auto" is the default.
SETTINGS = {"auto": ({}, (128, 256, 512)), "refined": ({"model": "one-lobe"}, (128, 192, 224, 256, 384, 512)),
            "draft": ({"model": "one-lobe", "method": "draft"}, (128, 256, 512))}


def main(capture: Path, export: Path, out: Path) -> None:
    ensure_openimageio()
    files.open_blend(capture / "scene.blend")
    scene = read_scene(None, None, capture / "captures.json")
    judge = np.load(export / "judge.npz")
    rows, device = [], {}
    for method, (given, sizes) in SETTINGS.items():
        for size in sizes:
            settings = SolveSettings(size=size, **given)
            runs = [solve(scene, settings) for _ in range(1 + REPEATS)]
            seconds = [elapsed for elapsed, _ in runs[1:]]
            solution = runs[-1][1]
            device = solution.device
            rows.append({
                "method": method, "size": size, "seconds": statistics.median(seconds), "first_seconds": runs[0][0],
                "all_seconds": seconds, "stages": solution.seconds, **score(solution.maps, judge)})
            seen, informed = rows[-1]["seen"], rows[-1]["informed"]
            print(f"{capture.name}: {method} {size}: {rows[-1]['seconds']:.2f} s, {seen['albedo_psnr']:.2f} dB, "
                  f"roughness {seen['rough_mae']:.4f}, informed {informed['rough_mae']:.4f}", flush=True)
    out.write_text(json.dumps({"rows": rows, "device": device,
                               "versions": versions() | {"blender": files.blender_version()}}, indent=1))


def solve(scene, settings):
    start = time.perf_counter()
    solution = thread.run(lambda: pipeline.solve(scene, settings))
    return time.perf_counter() - start, solution


def score(maps, judge):
    grid = judge["seen"].shape[0]
    base, rough = at_size(maps.base_color, grid), at_size(maps.roughness, grid)[..., 0]
    return {where: asdict(map_errors(base, rough, judge["base"], judge["rough"], judge[where]))
            for where in ("seen", "informed")}


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:4]))
