"""``python -m studies.everything``: fills docs/calibration.md, a shoot of which everything is a little off at once.

As `studies.calibration`, with light from a room in the pictures and a mesh that is wrong in detail too.  Needs Blender
as a module.  Pictures are kept in build/everything.  --assets: these alone, and no page.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.data import F64, MeshArrays, RadianceImage, SceneData, View
from irpso_addon.core.images.reference_image import read_reference
from irpso_addon.core.shading.lights import light_irradiance
from irpso_addon.solve.kept_images import ReadImage
from studies import pages
from studies.calibration import HEAD, NAMES, PAGE, Case, asked, judged, line, solved, wrong
from studies.intervals.assets import ASSETS
from studies.intervals.measure import scene_of
from studies.intervals.page import made_on

PICTURES = pages.ROOT / "build" / "everything"
RIGHT, ALL = Case("nothing"), Case("everything", lamps=True, cameras=True)
ROOM = 0.01  # of the lamps' typical irradiance
HEIGHT, WAVE = 0.001, 0.15  # of a scan's errors, metres: greatest height of one wave, and its length
WAVES = 12
STEP = 1e-4  # metres: for slopes


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


def in_room(scene: SceneData) -> ReadImage:
    """Reads a view's picture as if a room had lit it too; ``scene``: as it is."""
    place, normal = (np.asarray(part.mean(1), np.float64) for part in (scene.mesh.positions, scene.mesh.normals))
    lit = np.array([light_irradiance(view.lights[0], place, normal) * view.lights[0].power.mean()
                    for view in scene.views])
    radiance = ROOM * float(np.median(lit[lit > 0])) / np.pi

    def read(view: View) -> RadianceImage:
        image = read_reference(view)
        name = view.camera.name.split(" (")[0]  # one that was put right for a view has the picture's name too
        room = read_reference(replace(view, image=view.image.with_name(f"room {name}.exr"), gain=1.0, vignetting=0.0,
                                      response=1.0, ambient_radiance=(0.0, 0.0, 0.0)))
        return replace(image, rgb=image.rgb + (radiance / view.gain * room.rgb).astype(np.float32))
    return read


def main() -> int:
    """Command line."""
    options = asked("everything", __doc__, PICTURES)
    ensure_openimageio()
    lines = []
    for asset in ASSETS:
        if asset.name in (options.assets or NAMES):
            scene = scene_of(asset, options.pictures / asset.name, room=True)
            off = replace(wrong(scene, ALL), mesh=scanned(scene.mesh))
            for case, told, given, read in ((RIGHT, "auto", scene, None), (ALL, "given", off, in_room(scene)),
                                            (ALL, "auto", off, in_room(scene))):
                found = solved(given, told, read)
                lines.append(line(judged(asset, case, told, scene, found)))
                print(lines[-1], flush=True)
    if options.assets is None:
        pages.fill(PAGE, {"everything made": made_on(found[0].solution), "everything": "\n".join([HEAD, *lines])},
                   options.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
