"""``python -m studies.emitters``: fills docs/emitters.md, how exact the light of meshes that glow is.

The device's radiance against Cycles' pixels: a sphere, and a ring that shadows itself, under a square panel, a bulb, a
bent tube, and a lamp that is as large as the panel.  Needs Blender as a module.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from irpso_addon.blender import files
from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.data import F64, RadianceImage, SceneData, View
from irpso_addon.core.job import Progress
from irpso_addon.core.phrases import percent
from irpso_addon.core.shading import brdf, environment
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer
from irpso_addon.gpu.observe.environment_light import node_places
from irpso_addon.gpu.observe.observations import observe
from studies import pages
from studies.environment import radiance, shoot
from tests.blender import cycles_rig as rig
from tests.support import glowing_scene

PLACE, SIZE = (1.2, -1.0, 1.5), 1.2  # of the lights; metres
DIM = 0.02  # of the brightest pixel: below, Cycles' noise counts
ROUGHNESS = (0.1, 0.2, 0.4, 0.7)
PIXELS = 24


@dataclass(frozen=True)
class Kind:
    """A light, and how many samples of Cycles it takes."""

    name: str
    make: Callable[[], Any]
    samples: int


def _lamp() -> Any:
    return rig.lamp("AREA", PLACE, shape="SQUARE", size=SIZE, energy=5 * np.pi * SIZE**2)


KINDS = (
    Kind("panel", lambda: glowing_scene.panel("Panel", PLACE, SIZE, 5.0), 2048),
    Kind("near panel", lambda: glowing_scene.panel("Panel", (0.75, -0.5, 0.75), 1.0, 5.0), 2048),
    Kind("bulb", lambda: glowing_scene.bulb("Bulb", PLACE, 0.25, 20.0), 16384),
    Kind("bent tube", lambda: glowing_scene.tube("Tube", PLACE, 2.0, 0.05, 20.0), 16384),
    Kind("area lamp", _lamp, 2048),
)


@dataclass(frozen=True)
class Seen:
    """What the device makes of the light at P pixels of a camera."""

    where: np.ndarray  # (h, w) bool: good pixels
    irradiance: F64  # (P,)
    nodes: F64 | None  # (P, NODES) 1/sr; None: of a lamp
    lobe: F64 | None  # (P, 4) of a lamp, as shaders/observe/lobe.frag leaves it
    cos_v: F64  # (P,)

    def radiance(self, roughness: float) -> F64:
        """(P,) of a dielectric of base colour BASE."""
        gain, taken = np.moveaxis(brdf.principled_energy(roughness, self.cos_v), -1, 0)
        if self.nodes is not None:
            specular = environment.at_roughness(self.nodes, np.array(roughness))
        else:
            assert self.lobe is not None
            sin2h, spread, cos_l, factor = self.lobe.T
            shape = brdf.lobe_ggx(roughness, sin2h, spread, cos_l, self.cos_v)
            specular = shape * 2 * cos_l * self.cos_v * factor  # the factor has F / (2 cos_l cos_v)
        return np.asarray(self.irradiance * (radiance.BASE * (1 - taken) / np.pi + gain * specular))


@dataclass(frozen=True)
class Error:
    """Relative errors of radiance over the good pixels that are not DIM."""

    shape: str
    kind: str
    roughness: float
    noise: float  # of Cycles at 90 % of the pixels, by two renders
    middle: float
    ninety: float  # at 90 % of the pixels
    mean: float  # signed


def errors(shape: str, kind: Kind, roughness: Sequence[float], pixels: int, samples: int) -> list[Error]:
    """Of each roughness."""
    with tempfile.TemporaryDirectory() as name:
        folder, result = Path(name), []
        radiance.stage(shape, "overcast", folder, pixels)
        bpy.context.scene.world = None
        kind.make()
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "stage.blend"))
        found = seen(folder, kind.name == "area lamp")
        for r in roughness:
            pair = []
            for seed in (0, 1):
                bpy.context.scene.cycles.seed = seed
                pair.append(radiance.rendered(folder, r, samples // 2)[found.where].mean(-1))
            truth = (pair[0] + pair[1]) / 2
            lit = truth > DIM * truth.max()
            off = np.abs(found.radiance(r)[lit] / truth[lit] - 1)
            noise = np.abs(pair[0][lit] / pair[1][lit] - 1) / 2
            result.append(Error(shape, kind.name, r, float(np.quantile(noise, 0.9)), float(np.median(off)),
                                float(np.quantile(off, 0.9)), float(np.mean(found.radiance(r)[lit] / truth[lit] - 1))))
    return result


def seen(folder: Path, lamp: bool) -> Seen:
    """Of the open file's light."""
    lights = '["lamp"]' if lamp else "[]"
    (folder / "captures.json").write_text(
        f'{{"views": [{{"image": "out.exr", "camera": "Camera", "lights": {lights}}}]}}', encoding="utf-8")
    scene = read_scene(None, shoot.NAME, folder / "captures.json")
    size = bpy.context.scene.render.resolution_x
    found: Seen = thread.run(lambda: _seen(scene, size))
    return found


def _seen(scene: SceneData, size: int) -> Generator[Progress, None, Seen]:
    def white(_: View) -> RadianceImage:
        return RadianceImage(np.ones((size, size, 3), np.float32), np.ones((size, size), np.float32),
                             np.ones((size, size), bool))

    device = thread.device()
    with device.scope():
        observed = yield from observe(device, scene, MeshBuffer(device, scene.mesh), white)
        (camera,) = observed.cameras
        (view,) = camera.views
        colour, position = device.read(view.colour), device.read(camera.maps.position)
        normal = device.read(camera.maps.normal)[..., :3].astype(np.float64)
        toward = camera.camera.position - position[..., :3]
        toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
        cos_v = (normal * toward).sum(-1)
        where = (position[..., 3] > 0.5) & (colour[..., 3] > 0.25 * cos_v**2) & (cos_v > 0.2) & (colour[..., 0] > 0)
        nodes = None if view.nodes is None else np.stack(
            [device.read(view.nodes, place)[where][:, 0] for place in node_places(size, size)], -1).astype(np.float64)
        lobe = device.read(view.lobes[0])[where].astype(np.float64) if view.lobes else None
        return Seen(where, 1 / colour[where][:, 0].astype(np.float64), nodes, lobe, cos_v[where])


def row(e: Error) -> list[str]:
    """Of the page's table."""
    return [e.shape, e.kind, f"{e.roughness:g}", percent(e.middle, 2), percent(e.ninety, 2), percent(e.noise, 2),
            percent(e.mean, 2, sign=True)]


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.emitters", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=pages.DOCS / "emitters.md", help="the page")
    options = parser.parse_args()
    ensure_openimageio()
    rows = []
    for shape in radiance.SHAPES:
        for kind in KINDS:
            for error in errors(shape, kind, ROUGHNESS if kind.samples < 10_000 else (0.1, 0.4), PIXELS, kind.samples):
                rows.append(row(error))
                print(" | ".join(rows[-1]), flush=True)
    renderer = thread.run(_renderer)
    pages.fill(pages.DOCS / "emitters.md", {
        "made": pages.measured(renderer, f"Blender {files.blender_version()}"),
        "cycles": pages.table(["shape", "light", "roughness", "median", "90 %", "noise", "mean"], rows)}, options.out)
    return 0


def _renderer() -> Generator[Progress, None, str]:
    yield Progress(1.0, "emitters", "")
    return thread.device().name


if __name__ == "__main__":
    raise SystemExit(main())
