"""The paper's own experiment on the head scan, and the same with enough lights: pictures and tables of docs/head.md.

    python tools/head_experiment.py HEAD_FOLDER [--size 512] [--out build/head]

HEAD_FOLDER holds LeePerrySmith.glb and Map-COL.jpg (docs/head.md says where they are from).  Needs the development
environment (make setup); Cycles renders the references.  Takes some minutes on two CPU cores.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Generator
from pathlib import Path

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.blender.scene.scene import read_scene  # noqa: E402
from irpso_addon.compare.judge import GLOSS, Judge, make_judge  # noqa: E402
from irpso_addon.core.data import F32, Bool, Maps, SceneData, Solution  # noqa: E402
from irpso_addon.core.errors import BadInput  # noqa: E402
from irpso_addon.core.images.reference_image import read_reference  # noqa: E402
from irpso_addon.core.job import Progress  # noqa: E402
from irpso_addon.core.params import SolveSettings  # noqa: E402
from irpso_addon.core.resampling import at_size, bilinear  # noqa: E402
from irpso_addon.gpu.device import thread  # noqa: E402
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer  # noqa: E402
from irpso_addon.gpu.maps.fill import fill  # noqa: E402
from irpso_addon.gpu.observe.observation_atlas import CameraSource  # noqa: E402
from irpso_addon.gpu.observe.observations import observe  # noqa: E402
from irpso_addon.gpu.solve.ladder_records import Materials  # noqa: E402
from irpso_addon.gpu.solve.model_ladder import Ladder  # noqa: E402
from irpso_addon.solve import pipeline  # noqa: E402  # the checkout is no installed package
from tools import head_page as page  # noqa: E402
from tools import head_scene as scan  # noqa: E402
from tools.head_page import Options, Pixels, Record, Result  # noqa: E402

CAMERA, ONE_LAMP = "Camera 1", "Lamp one image"


def run(options: Options) -> Record:
    """All of it; pictures and figures go to ``options.out``.  Raises BadInput."""
    (options.out / "refs").mkdir(parents=True, exist_ok=True)
    truth = scan.build(options.folder, options.cameras, options.lamps, options.pixels, options.samples)
    scan.wear(scan.bare_maps(truth.base, truth.lobes), in_pixels=False)
    started = time.perf_counter()
    many = _render_views(options)
    fit = scan.render(options.out / "refs" / "one.exr", CAMERA, ONE_LAMP)
    relit = scan.render(options.out / "refs" / "held_out.exr", CAMERA, scan.HELD_OUT)
    rendering = time.perf_counter() - started
    scan.strip()
    bpy.ops.wm.save_as_mainfile(filepath=str((options.out / "head.blend").resolve()), compress=True)
    one = _read(options.out, {"refs/one.exr": (CAMERA, ONE_LAMP)})
    pixels = _pixels(one, truth, fit, relit)
    few = [_one_image(options, one, pixels, "paper"), _one_image(options, one, pixels, "refined")]
    scene = _read(options.out, many)
    results = [_many(options, scene, truth, pixels, SolveSettings(size=options.size, model="two-lobe")),
               _many(options, scene, truth, pixels, SolveSettings(
                   size=options.size // 2, model="two-lobe", method="paper", iterations=options.many_passes))]
    auto: Solution = thread.run(lambda: pipeline.solve(scene, SolveSettings(size=options.size)))
    judge: Judge = thread.run(lambda: make_judge(scene, None, None, read_reference, options.size))
    near = judge.where & (judge.tan_h < GLOSS * results[0].true_lobes[..., 0] ** 2)
    return Record(options, pixels, few, results, auto, near, rendering, len(many))


def _render_views(options: Options) -> dict[str, tuple[str, str]]:
    """References of every camera under every lamp: image -> (camera, lamp)."""
    views = {}
    for camera in scan.cameras():
        for lamp in scan.lamps():
            name = f"refs/view_{len(views):03d}.exr"
            scan.render(options.out / name, camera, lamp)
            views[name] = (camera, lamp)
    return views


def _read(out: Path, views: dict[str, tuple[str, str]]) -> SceneData:
    scan.write_captures(out / "captures.json", views)
    return read_scene(None, scan.NAME, out / "captures.json")


# ---- the paper's setting: one image, the grid is the camera's pixels


def _one_image(options: Options, scene: SceneData, pixels: Pixels, method: str) -> Result:
    settings = SolveSettings(size=options.size, model="two-lobe", method=method, iterations=options.one_passes)
    base, lobes, seen, seconds = thread.run(lambda: _solve_pixels(scene, settings))
    scan.wear(scan.bare_maps(base, lobes), in_pixels=True)
    return Result(
        method, base, lobes, pixels.base, pixels.lobes, seen, seconds, base, lobes, seen,
        *(scan.render(options.out / f"one_{method}_{lamp}.exr", CAMERA, lamp) for lamp in (ONE_LAMP, scan.HELD_OUT)))


def _solve_pixels(
    scene: SceneData, settings: SolveSettings
) -> Generator[Progress, None, tuple[F32, F32, Bool, float]]:
    """Base colour and lobes of each pixel of the scene's first camera, which pixels are solved, and the seconds."""
    device = thread.device()
    mesh = MeshBuffer(device, scene.mesh)
    observations = yield from observe(device, scene, mesh, read_reference)
    grid = observations.cameras[0].maps
    slots = np.where(device.read(grid.position)[..., 3] > 0.5, 0, -1).astype(np.int32)
    started = time.perf_counter()
    ladder = Ladder(device, CameraSource(device, grid, observations), settings,
                    Materials(slots, scene.mesh.slot_names))
    found = yield from ladder.solve()
    assert found.lobes is not None
    seen = found.texels.solved[..., None].astype(np.float32)
    lobes = device.texture(*grid.position.size, data=np.concatenate([found.lobes, seen], -1))
    if found.base is None:
        base = yield from ladder.solver.albedo(lobes, lobes=2)
    else:
        base = device.texture(*grid.position.size, data=np.concatenate([found.base, seen], -1))
    device.ctx.finish()
    seconds = time.perf_counter() - started
    filled = [fill(device, texture) for texture in (base, lobes)]
    result = [device.read(texture)[..., :3].copy() for texture in filled]
    for thing in (base, lobes, *filled, ladder, observations, mesh):
        thing.release()
    return result[0], result[1], seen[..., 0] > 0.5, seconds


def _pixels(scene: SceneData, truth: scan.Truth, fit: F32, relit: F32) -> Pixels:
    uv, shown = thread.run(lambda: _uv(scene))
    return Pixels(uv, shown, sample(truth.base, uv), sample(truth.lobes, uv), fit, relit)


def _uv(scene: SceneData) -> Generator[Progress, None, tuple[F32, Bool]]:
    device = thread.device()
    mesh = MeshBuffer(device, scene.mesh)
    observations = yield from observe(device, scene, mesh, read_reference)
    maps = observations.cameras[0].maps
    assert maps.uv is not None
    result = device.read(maps.uv).copy(), device.read(maps.position)[..., 3] > 0.5
    observations.release()
    mesh.release()
    return result


def sample(image: F32, uv: F32) -> F32:
    """An image (n, n, c), row 0 at the bottom, at places (h, w, 2) of the UV square, bilinear."""
    return bilinear(image, uv.reshape(-1, 2)).reshape(*uv.shape[:2], -1).astype(np.float32)


# ---- many lights, the product's own way


def _many(options: Options, scene: SceneData, truth: scan.Truth, pixels: Pixels, settings: SolveSettings) -> Result:
    solution: Solution = thread.run(lambda: pipeline.solve(scene, settings))
    maps: Maps = solution.maps
    assert maps.lobes is not None
    scan.wear(maps, in_pixels=False)
    seen, size, method = maps.coverage & ~maps.filled, settings.size, settings.method
    nearest = np.clip((pixels.uv * size).astype(int), 0, size - 1)
    return Result(
        method, maps.base_color, maps.lobes, at_size(truth.base, size), at_size(truth.lobes, size), seen,
        solution.seconds["solve"], sample(maps.base_color, pixels.uv), sample(maps.lobes, pixels.uv),
        pixels.shown & seen[nearest[..., 1], nearest[..., 0]],
        *(scan.render(options.out / f"many_{method}_{lamp}.exr", CAMERA, lamp) for lamp in (ONE_LAMP, scan.HELD_OUT)),
        solution=solution)


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="HEAD_FOLDER")
    parser.add_argument("--size", type=int, default=512, help="texels of the maps (default 512)")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "head")
    arguments = parser.parse_args()
    try:
        record = run(Options(arguments.folder, arguments.out, arguments.size))
    except BadInput as error:
        print(error, file=sys.stderr)
        return 3
    page.write(record)  # first: it says of which commit, and a new picture makes the checkout dirty
    page.draw(record, page.IMAGES)
    return 0


if __name__ == "__main__":
    sys.exit(main())
