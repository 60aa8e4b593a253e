"""The forward model under environments against Cycles' pixels: a sphere, and a ring that shadows itself."""

from __future__ import annotations

import tempfile
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO

from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.data import F64, RadianceImage, SceneData, View
from irpso_addon.core.job import Progress
from irpso_addon.core.shading import brdf, environment
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer
from irpso_addon.gpu.observe.environment_light import node_places
from irpso_addon.gpu.observe.observations import ObserveOptions, observe
from studies.environment import shoot
from studies.environment.hdris import world

BASE = 0.5
SHAPES = ("sphere", "ring")


@dataclass(frozen=True)
class Pixels:
    """What the device makes of an environment, at P pixels of a camera, for any roughness."""

    where: np.ndarray  # (h, w) bool: good pixels
    irradiance: F64  # (P, 3)
    nodes: F64  # (P, 3, NODES) 1/sr
    cos_v: F64  # (P,)

    def radiance(self, roughness: float) -> F64:
        """(P, 3) of a dielectric of base colour BASE."""
        gain, taken = np.moveaxis(brdf.principled_energy(roughness, self.cos_v), -1, 0)[..., None]
        lobe = environment.at_roughness(self.nodes, np.array(roughness))
        return np.asarray(self.irradiance * (BASE * (1 - taken) / np.pi + gain * lobe))


def stage(shape: str, kind: str, folder: Path, pixels: int) -> None:
    """The open file: the shape under the environment before a camera, without filter or bounces; saved."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    if shape == "sphere":
        bpy.ops.mesh.primitive_uv_sphere_add(segments=192, ring_count=96, radius=0.8)
    else:
        bpy.ops.mesh.primitive_torus_add(major_segments=160, minor_segments=80, major_radius=0.6, minor_radius=0.25)
    bpy.ops.object.shade_smooth()
    subject = bpy.context.object
    subject.name = shoot.NAME
    if not subject.data.uv_layers:
        subject.data.uv_layers.new(name="UVMap")
    subject.data.materials.append(shoot._material("Paint"))
    data = bpy.data.cameras.new("Camera")
    camera = bpy.data.objects.new("Camera", data)
    camera.location, camera.rotation_euler = (0.0, -2.6, 1.9), (np.radians(54), 0, 0)
    data.angle = np.radians(36)
    scene.collection.objects.link(camera)
    scene.camera, scene.world = camera, world(kind, folder)
    shoot._set_up(shoot.BOTTLE, 1, 0)
    scene.render.resolution_x = scene.render.resolution_y = pixels
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "stage.blend"))


def rendered(folder: Path, roughness: float, samples: int) -> F64:
    """(h, w, 3) by Cycles, row 0 at the bottom."""
    scene = bpy.context.scene
    node = next(n for n in bpy.data.materials["Paint"].node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    node.inputs["Base Color"].default_value, node.inputs["Roughness"].default_value = (BASE,) * 3 + (1,), roughness
    scene.cycles.samples, scene.render.filepath = samples, str(folder / "out.exr")
    bpy.ops.render.render(write_still=True)
    pixels = OpenImageIO.ImageBuf(scene.render.filepath).get_pixels(OpenImageIO.FLOAT)
    return np.asarray(pixels[::-1, :, :3], np.float64)


def seen(folder: Path, count: int) -> Pixels:
    """Of the open file's environment, as so many directions."""
    (folder / "captures.json").write_text(
        '{"views": [{"image": "out.exr", "camera": "Camera", "lights": []}]}', encoding="utf-8")
    scene = read_scene(None, shoot.NAME, folder / "captures.json")
    size = bpy.context.scene.render.resolution_x

    def white(view: View) -> RadianceImage:
        return RadianceImage(np.ones((size, size, 3), np.float32), np.ones((size, size), np.float32),
                             np.ones((size, size), bool))

    found: Pixels = thread.run(lambda: _seen(scene, white, size, count))
    return found


def _seen(scene: SceneData, white: object, size: int, count: int) -> Generator[Progress, None, Pixels]:
    device = thread.device()
    with device.scope():
        observed = yield from observe(device, scene, MeshBuffer(device, scene.mesh), white,  # type: ignore[arg-type]
                                      ObserveOptions(directions=count))
        (camera,) = observed.cameras
        (view,) = camera.views
        colour, position = device.read(view.colour), device.read(camera.maps.position)
        normal = device.read(camera.maps.normal)[..., :3].astype(np.float64)
        toward = camera.camera.position - position[..., :3]
        toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
        cos_v = (normal * toward).sum(-1)
        where = (position[..., 3] > 0.5) & (colour[..., 3] > 0.01 * cos_v**2) & (cos_v > 0.2)
        assert view.nodes is not None
        nodes = np.stack([device.read(view.nodes, place)[where][:, :3] for place in node_places(size, size)], -1)
        return Pixels(where, 1 / colour[where][:, :3].astype(np.float64), nodes.astype(np.float64), cos_v[where])


@dataclass(frozen=True)
class Error:
    """Relative errors of radiance, its mean of channels, over the good pixels."""

    shape: str
    kind: str
    roughness: float
    noise: float  # of Cycles, relative, by two renders
    middle: float
    ninety: float  # at 90 % of the pixels
    mean: float  # signed

    @property
    def rest(self) -> float:
        """``ninety`` without Cycles' noise."""
        return float(np.sqrt(max(self.ninety**2 - (1.645 * self.noise)**2, 0.0)))


def errors(shape: str, kind: str, roughness: tuple[float, ...], pixels: int, samples: int, count: int) -> list[Error]:
    """Of each roughness."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stage(shape, kind, folder, pixels)
        found, result = seen(folder, count), []
        for r in roughness:
            pair = []
            for seed in (0, 1):
                bpy.context.scene.cycles.seed = seed
                pair.append(rendered(folder, r, samples // 2)[found.where].mean(-1))
            truth = (pair[0] + pair[1]) / 2
            off = found.radiance(r).mean(-1) / truth - 1
            noise = float(np.sqrt(np.mean((pair[0] / pair[1] - 1) ** 2)) / 2)
            result.append(Error(shape, kind, r, noise, float(np.median(np.abs(off))),
                                float(np.quantile(np.abs(off), 0.9)), float(off.mean())))
    return result
