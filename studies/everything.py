"""``python -m studies.everything``: fills docs/calibration.md, a shoot of which everything is a little off at once.

As `studies.calibration`, with light from a room in the pictures, a lens whose k1 is wrong, and a mesh that is wrong in
detail too.  Needs Blender as a module.  Pictures are kept in build/everything.  --assets: these alone, and no page.
--mesh: these files in place of the assets, and no page.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.checks.mended_cameras import bent
from irpso_addon.core.data import F64, Camera, Maps, MeshArrays, RadianceImage, SceneData, View
from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.reference_image import read_reference
from irpso_addon.core.phrases import percent
from irpso_addon.core.shading.lights import light_irradiance
from irpso_addon.solve.kept_images import ReadImage
from studies import pages
from studies.calibration import NAMES, PAGE, Case, judged, solved, wrong
from studies.intervals.assets import ASSETS, Asset, truth
from studies.intervals.measure import scene_of
from studies.intervals.page import made_on
from studies.mesh_asset import asset_of

PICTURES = pages.ROOT / "build" / "everything"
LAMPS, CAMERAS, LENS, MESH, LIGHT = "lamps", "cameras", "lens", "mesh", "room"  # exposures with lamps
ALL = (LAMPS, CAMERAS, LENS, MESH, LIGHT)
ROOM = 0.01  # of the lamps' typical irradiance
K1 = 0.05  # of the scene's lenses; those of the pictures have none
HEIGHT, WAVE = 0.001, 0.15  # of a scan's errors, metres: greatest height of one wave, and its length
WAVES = 12
STEP = 1e-4  # metres: for slopes
HEAD = """\
| asset | wrong | lamps, exposures | base color, dB | apart from a factor, dB | roughness | off | lamps | solve, s | \
processor, s |
|---|---|---|---|---|---|---|---|---|---|"""


def off(scene: SceneData, asset: Asset, errors: tuple[str, ...]) -> SceneData:
    """The scene, wrong about some of ALL; of the room's light it knows, unless it is wrong about that."""
    given = wrong(scene, Case("", lamps=LAMPS in errors, cameras=CAMERAS in errors), pixels=asset.pixels)
    if LENS in errors:
        size = asset.pixels, asset.pixels
        lenses: dict[str, Camera] = {view.camera.name: bent(view.camera, K1, size) for view in given.views}
        given = replace(given, views=tuple(replace(view, camera=lenses[view.camera.name]) for view in given.views))
    if MESH in errors:
        given = replace(given, mesh=scanned(given.mesh))
    if LIGHT not in errors:
        around = (room_of(scene),) * 3
        given = replace(given, views=tuple(replace(view, ambient_radiance=around) for view in given.views))
    return given


def scanned(mesh: MeshArrays) -> MeshArrays:
    """The mesh as a scan has it, with waves of some millimetres that are not there."""
    place, normal = mesh.positions.astype(np.float64), mesh.normals.astype(np.float64)
    slope = np.stack([(_height(place + by) - _height(place - by)) / (2 * STEP) for by in np.eye(3) * STEP], -1)
    across = slope - (slope * normal).sum(-1, keepdims=True) * normal
    turned = normal - across
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    return replace(mesh, positions=(place + _height(place)[..., None] * normal).astype(np.float32),
                   normals=turned.astype(np.float32))


def _height(place: F64) -> F64:
    """Metres, at (..., 3) places."""
    rng = np.random.default_rng(8)
    total = np.zeros(place.shape[:-1])
    for _ in range(WAVES):
        way = rng.standard_normal(3)
        total += np.cos(place @ (2 * np.pi / WAVE * way / np.linalg.norm(way)) + rng.uniform(0, 2 * np.pi))
    return np.asarray(HEIGHT * total / np.sqrt(WAVES))


def room_of(scene: SceneData) -> float:
    """Radiance of the room."""
    place, normal = (np.asarray(part.mean(1), np.float64) for part in (scene.mesh.positions, scene.mesh.normals))
    lit = np.array([light_irradiance(view.lights[0], place, normal) * view.lights[0].power.mean()
                    for view in scene.views])
    return ROOM * float(np.median(lit[lit > 0])) / np.pi


def in_room(scene: SceneData) -> ReadImage:
    """Reads a view's picture as if a room had lit it too; ``scene``: as it is."""
    radiance = room_of(scene)

    def read(view: View) -> RadianceImage:
        image = read_reference(view)
        name = view.camera.name.split(" (")[0]  # one that was put right for a view has the picture's name too
        room = read_reference(replace(view, image=view.image.with_name(f"room {name}.exr"), gain=1.0, vignetting=0.0,
                                      response=1.0, ambient_radiance=(0.0, 0.0, 0.0)))
        return replace(image, rgb=image.rgb + (radiance / view.gain * room.rgb).astype(np.float32))
    return read


def cases(each: bool) -> Iterator[tuple[str, tuple[str, ...], str]]:
    """(name, what is wrong, whether lamps and exposures are given or put right).  ``each``: all but one, too."""
    yield "nothing", (), "auto"
    yield "everything", ALL, "given"
    yield "everything", ALL, "auto"
    for one in ALL if each else ():
        yield f"all but {one}", tuple(error for error in ALL if error != one), "auto"


def measured(asset: Asset, scene: SceneData, each: bool) -> Iterator[tuple[str, str]]:
    """(line of the table, what made the solve) of each case."""
    read_image = in_room(scene)
    for name, errors, told in cases(each):
        given, start = off(scene, asset, errors), time.process_time()
        found = solved(given, told, read_image, asset.texels)
        spent = time.process_time() - start
        row, solution = judged(asset, Case(name), told, scene, found), found[0].solution
        yield (f"| {row.asset} | {row.case} | {row.told} | {row.base:.1f} | {but_a_factor(asset, solution.maps):.1f} | "
               f"{row.rough:.4f} | {percent(row.fails, 1)} | {percent(row.places, 2)} | "
               f"{row.seconds:.1f} | {spent:.1f} |", made_on(solution))


def but_a_factor(asset: Asset, maps: Maps) -> float:
    """PSNR of base colour, dB, times the factor that suits best: a power that all lamps share shows in no picture."""
    where = maps.coverage & ~maps.filled
    found, true = maps.base_color[where].astype(np.float64), truth(asset)[0][where]
    factor = float((found * true).sum() / (found * found).sum())
    return -10 * float(np.log10(np.mean((factor * found - true) ** 2)))


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.everything", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--assets", nargs="+", choices=NAMES, metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--mesh", nargs="+", type=Path, metavar="FILE", help="meshes with UVs: .obj, .glb, .gltf")
    parser.add_argument("--paint", nargs="+", type=Path, metavar="IMAGE", default=[],
                        help="base colors of the meshes, in their order; without: the image that a mesh has")
    parser.add_argument("--pixels", type=int, default=512, help="pictures and maps of meshes are as wide and high")
    parser.add_argument("--each", action="store_true", help="also with one error less, for each of them")
    parser.add_argument("--pictures", type=Path, default=PICTURES, help="folder that keeps them")
    parser.add_argument("--out", type=Path, default=PAGE, help="the page")
    options = parser.parse_args()
    ensure_openimageio()
    try:
        assets = [asset_of(path, image, options.pixels) for path, image in zip(
            options.mesh or (), [*options.paint, *[None] * len(options.mesh or ())], strict=False)]
    except BadInput as error:
        print(f"studies.everything: {error}", file=sys.stderr)
        return 2
    assets = assets or [asset for asset in ASSETS if asset.name in (options.assets or NAMES)]
    lines: list[tuple[str, str]] = []
    for asset in assets:
        for found in measured(asset, scene_of(asset, options.pictures / asset.name, room=True), options.each):
            lines.append(found)
            print(found[0], flush=True)
    if options.assets is None and options.mesh is None:
        table = "\n".join([HEAD, *(row for row, _ in lines)])
        pages.fill(PAGE, {"everything made": lines[-1][1], "everything": table}, options.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
