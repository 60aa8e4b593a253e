"""The numpy solver beside the pipeline on OpenGL: processor seconds and errors on the demo's vase.

    make demo; python tools/numpy_reference.py [--sizes 32 64 128]

Prints the table of docs/troubleshooting.md.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.blender.files import open_blend  # noqa: E402
from irpso_addon.blender.sample.demo import NAME  # noqa: E402
from irpso_addon.blender.scene.scene import read_scene  # noqa: E402
from irpso_addon.core.data import SceneData, Solution  # noqa: E402
from irpso_addon.core.evaluation.metrics import map_errors  # noqa: E402
from irpso_addon.core.params import DeviceSettings, SolveSettings  # noqa: E402
from irpso_addon.core.samples import vase  # noqa: E402
from irpso_addon.gpu.device import thread  # noqa: E402
from irpso_addon.solve import pipeline  # noqa: E402  # the checkout is no installed package


def main() -> None:
    """Solve and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--demo", type=Path, default=ROOT / "build" / "demo", help="folder that `make demo` has filled")
    parser.add_argument("--sizes", type=int, nargs="*", default=[32, 64, 128])
    arguments = parser.parse_args()
    open_blend(arguments.demo / "scene.blend")
    scene = read_scene(None, NAME, arguments.demo / "captures.json")
    print(f"{len(scene.views)} views, {len(scene.mesh.positions):,} triangles\n")
    print("| texels | device | processor s | texels solved | roughness, median error | mean | base colour, PSNR |")
    print("|---|---|---|---|---|---|---|")
    for size in arguments.sizes:
        found = {device: solved(scene, size, device) for device in ("opengl", "numpy")}
        maps = [solution.maps for solution, _ in found.values()]
        both = np.all([m.coverage & ~m.filled & (m.confidence > 0.5) for m in maps], axis=0)
        truth = vase.truth(size)
        for device, (solution, seconds) in found.items():
            own = solution.maps.base_color, solution.maps.roughness
            errors = map_errors(*(array.astype(np.float64) for array in (*own, *truth)), both)
            print(f"| {size} x {size} | {device} | {seconds:.0f} | {solution.texels['solved']:,} | "
                  f"{errors.rough_median:.4f} | {errors.rough_mae:.4f} | {errors.albedo_psnr:.1f} dB |", flush=True)


def solved(scene: SceneData, size: int, device: str) -> tuple[Solution, float]:
    """The solution and what it took, seconds of one processor."""
    thread.configure(DeviceSettings(device=device))
    settings = SolveSettings(size=size, model="one-lobe", indirect="off", registration="given")
    start = time.process_time()
    return thread.run(lambda: pipeline.solve(scene, settings)), time.process_time() - start


if __name__ == "__main__":
    main()
