"""A bottle, or a knot, before cameras all around, lit by environments alone, rendered by Cycles: the truth is known."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO
from mathutils import Vector

from irpso_addon.core.data import F32, F64
from studies.environment.hdris import world
from studies.intervals.assets import Asset, make_knot, sheet, truth, waves

NAME = "Subject"
CAMERAS = ((8, 0.15), (4, 0.75))  # how many in a ring, radians above the horizon
DISTANCE = 4.2  # metres


@dataclass(frozen=True)
class Rig:
    """What shines, view by view."""

    name: str
    words: str
    hdris: tuple[str, ...]  # of KINDS
    turns: tuple[float, ...] = (0.0,)  # degrees; each view once under each
    samples: int = 512  # of Cycles, a pixel
    lamps: tuple[tuple[float, float, float], ...] = ()  # point lamps in place of HDRIs; each view once under each
    knot: bool = False  # in place of the bottle, which was looked at while the product was made

    @property
    def asset(self) -> Asset:
        """What is rendered."""
        return make_knot(0) if self.knot else BOTTLE


LAMPS = ((2.5, -2.0, 2.5), (-2.8, 1.5, 1.8))  # metres
TURNS = (0.0, 60.0, 120.0, 180.0, 240.0, 300.0)
RIGS = (
    Rig("one", "one HDRI (sky, window, small sun)", ("day",)),
    Rig("two", "two HDRIs (the same; a dark room with two lamps)", ("day", "room"), samples=256),
    Rig("turns", "one HDRI, six turns", ("day",), TURNS, 256),
    Rig("lamps", "two lamps, one at a time", (), samples=64, lamps=LAMPS),
    Rig("knot", "two HDRIs, the knot", ("day", "room"), samples=256, knot=True),
    Rig("knot turns", "one HDRI, six turns, the knot", ("day",), TURNS, 256, knot=True),
    Rig("knot lamps", "two lamps, one at a time, the knot", (), samples=64, lamps=LAMPS, knot=True),
)


def point(u: F64, v: F64) -> F64:
    """A bottle: body, shoulder, neck and lip."""
    v = np.asarray(v)
    radius = np.interp(v, [0, 0.03, 0.06, 0.55, 0.62, 0.70, 0.78, 0.92, 0.94, 0.97, 1.0],
                       [0.02, 0.36, 0.40, 0.40, 0.38, 0.28, 0.15, 0.13, 0.17, 0.17, 0.10])
    around = 2 * math.pi * u
    return np.stack([radius * np.cos(around), radius * np.sin(around), 1.7 * v - 0.85], -1)


def paint(u: F64, v: F64) -> tuple[F64, F64]:
    """A label, a band and a glaze that varies."""
    tone = np.stack([0.42 + 0.25 * waves(u, v, seed, 6) for seed in (1, 2, 3)], -1)
    label = (np.abs(u - 0.35) < 0.16) & (np.abs(v - 0.33) < 0.13)
    band = np.abs(v - 0.58) < 0.03
    base = np.where(label[..., None], [0.75, 0.68, 0.5], np.where(band[..., None], [0.1, 0.16, 0.3], tone))
    rough = 0.42 + 0.16 * waves(u, v, 4, 4)
    rough = np.where(label, 0.62, np.where(band, 0.24, rough))
    return np.clip(base, 0.04, 0.85), np.clip(rough, 0.2, 0.75)


BOTTLE = Asset("bottle", "a bottle with a label", (sheet(point, (96, 120), (0.02, 0.98, 0.02, 0.98)),), paint,
               pixels=144, noise=0.0)


def make(folder: Path, rig: Rig, bounces: int = 0) -> None:
    """``folder``: scene.blend without a trace of the truth, captures.json, pictures and HDRIs."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    (folder / "refs").mkdir(parents=True, exist_ok=True)
    asset = rig.asset
    _set_up(asset, rig.samples, bounces)
    subject = _mesh(asset)
    blank, painted = _material(NAME), painted_with(*truth(asset))
    subject.data.materials.append(painted)
    cameras = [camera(f"Camera {ring + 1}.{n + 1:02d}", 2 * math.pi * (n + 0.5 * ring) / count, up)
               for ring, (count, up) in enumerate(CAMERAS) for n in range(count)]
    shoot = _Shoot(folder, asset, cameras, np.random.default_rng(1))
    views = [view for kind in rig.hdris for view in shoot.under_world(world(kind, folder), rig.turns)]
    lamps = [lamp(f"Lamp {n + 1}", place) for n, place in enumerate(rig.lamps)]
    views += [view for each in lamps for view in shoot.under_lamp(each, lamps)]
    subject.material_slots[0].material = blank
    bpy.data.materials.remove(painted)
    for image in [i for i in bpy.data.images if i.name.startswith("truth ")]:
        bpy.data.images.remove(image)
    bpy.context.scene.world = bpy.data.worlds[rig.hdris[0]] if rig.hdris else None
    for made in bpy.data.worlds:
        made.use_fake_user = True
    (folder / "captures.json").write_text(json.dumps({"views": views}, indent=1), encoding="utf-8")
    bpy.ops.wm.save_as_mainfile(filepath=str((folder / "scene.blend").resolve()), compress=True)


@dataclass(frozen=True)
class _Shoot:
    """Renders the open scene from all cameras, and says what each picture is."""

    folder: Path
    asset: Asset
    cameras: list[bpy.types.Object]
    rng: np.random.Generator  # of the added noise

    def under_world(self, lit_by: bpy.types.World, turns: tuple[float, ...]) -> list[dict[str, object]]:
        """Under each turn of a world."""
        bpy.context.scene.world = lit_by
        mapping = next(node for node in lit_by.node_tree.nodes if node.type == "MAPPING")
        views = []
        for turn in turns:
            mapping.inputs["Rotation"].default_value = (0.0, 0.0, -math.radians(turn))
            views += [{**view, "lights": [], "world": lit_by.name, "turn": turn}
                      for view in self._pictures(f"{lit_by.name}_{turn:03.0f}")]
        mapping.inputs["Rotation"].default_value = (0.0, 0.0, 0.0)
        return views

    def under_lamp(self, lit_by: bpy.types.Object, lamps: list[bpy.types.Object]) -> list[dict[str, object]]:
        """Under one of the scene's lamps."""
        for other in lamps:
            other.hide_render = other is not lit_by
        views = [{**view, "lights": [lit_by.name]} for view in self._pictures(lit_by.name)]
        for other in lamps:
            other.hide_render = False
        return views

    def _pictures(self, name: str) -> list[dict[str, object]]:
        scene, views = bpy.context.scene, []
        for camera in self.cameras:
            scene.camera = camera
            file = f"refs/{name}_{camera.name}.exr"
            scene.render.filepath = str(self.folder / file)
            bpy.ops.render.render(write_still=True)
            if self.asset.noise:
                _add_noise(self.folder / file, self.asset.noise, self.rng)
            views.append({"image": file, "camera": camera.name})
        return views


def _add_noise(path: Path, sigma: float, rng: np.random.Generator) -> None:
    buffer = OpenImageIO.ImageBuf(str(path))
    pixels = np.asarray(buffer.get_pixels(OpenImageIO.FLOAT))
    pixels[..., :3] *= 1 + sigma * rng.standard_normal(pixels[..., :3].shape).astype(np.float32)
    out = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], 4, OpenImageIO.FLOAT))
    out.set_pixels(OpenImageIO.ROI(), np.ascontiguousarray(pixels))
    out.write(str(path))


def _set_up(asset: Asset, samples: int, bounces: int) -> None:
    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine, render.film_transparent, render.use_persistent_data = "CYCLES", True, True
    render.resolution_x = render.resolution_y = asset.pixels
    render.resolution_percentage = 100
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_mode, render.image_settings.color_depth = "RGBA", "32"
    cycles.device, cycles.samples = "CPU", samples
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = cycles.blur_glossy = 0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0


def _mesh(asset: Asset) -> bpy.types.Object:
    starts = np.cumsum([0, *(len(part.vertices) for part in asset.sheets)])
    vertices = np.concatenate([part.vertices for part in asset.sheets])
    quads = np.concatenate([part.quads + start for part, start in zip(asset.sheets, starts[:-1], strict=True)])
    uvs = np.concatenate([part.uvs for part in asset.sheets])
    mesh = bpy.data.meshes.new(NAME)
    mesh.from_pydata(vertices.tolist(), [], quads.tolist())
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uvs.ravel().astype(np.float32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(quads), bool))
    obj = bpy.data.objects.new(NAME, mesh)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.select_all(action="DESELECT")
    obj.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.remove_doubles(threshold=1e-5)  # the seam shades smoothly
    bpy.ops.object.mode_set(mode="OBJECT")
    return obj


def _material(name: str) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    return material


def painted_with(base: F32, roughness: F32) -> bpy.types.Material:
    """A material of these maps."""
    material = _material("truth")
    principled = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for name, socket, values in zip(("base", "roughness"), ("Base Color", "Roughness"), (base, roughness), strict=True):
        node = material.node_tree.nodes.new("ShaderNodeTexImage")
        node.image = _image(name, values)
        material.node_tree.links.new(node.outputs["Color"], principled.inputs[socket])
    return material


def _image(name: str, array: F32) -> bpy.types.Image:
    height, width = array.shape[:2]
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = array if array.ndim == 3 else array[..., None]
    image = bpy.data.images.new(f"truth {name}", width, height, float_buffer=True, is_data=True)
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    return image


def lamp(name: str, place: tuple[float, float, float], watts: float = 400.0) -> bpy.types.Object:
    """A point lamp."""
    data = bpy.data.lights.new(name, "POINT")
    data.energy, data.shadow_soft_size = watts, 0.0
    obj = bpy.data.objects.new(name, data)
    obj.location = place
    bpy.context.scene.collection.objects.link(obj)
    return obj


def camera(name: str, side: float, up: float) -> bpy.types.Object:
    """A camera that looks at the middle; ``side`` and ``up``: radians about the object, and above the horizon."""
    data = bpy.data.cameras.new(name)
    data.lens = 65
    place = DISTANCE * np.array([math.sin(side) * math.cos(up), -math.cos(side) * math.cos(up), math.sin(up)])
    obj = bpy.data.objects.new(data.name, data)
    obj.location, obj.rotation_euler = Vector(place), (-Vector(place)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj
