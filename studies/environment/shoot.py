"""A bottle before cameras all around it, lit by environments alone, rendered by Cycles: its truth is known."""

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
from studies.intervals.assets import Asset, sheet, truth, waves

NAME = "Subject"
CAMERAS = ((8, 0.15), (4, 0.75))  # how many in a ring, radians above the horizon
DISTANCE = 4.2  # metres
HDRI_HEIGHT = 512
KINDS = ("clear", "day", "studio", "room", "overcast")  # of environments, see `radiance`
SUN = np.array([0.5, -0.6, 0.62]) / np.linalg.norm([0.5, -0.6, 0.62])
WINDOW = np.array([-0.8, 0.5, 0.3]) / np.linalg.norm([-0.8, 0.5, 0.3])
BOXES = ((WINDOW, 0.6, 0.4, 5.0), (np.array([0.9, 0.3, 0.4]), 0.2, 0.7, 3.0),
         (np.array([0.1, 0.2, 1.0]), 0.5, 0.5, 2.0))  # studio: middle, half width and height at distance 1, radiance


@dataclass(frozen=True)
class Rig:
    """What shines, view by view."""

    name: str
    words: str
    hdris: tuple[str, ...]  # keys of HDRIS
    turns: tuple[float, ...] = (0.0,)  # degrees; each view once under each
    samples: int = 512  # of Cycles, a pixel


RIGS = (
    Rig("one", "one HDRI (sky, window, small sun)", ("day",)),
    Rig("two", "two HDRIs (the same; a dark room with two lamps)", ("day", "room"), samples=256),
    Rig("turns", "one HDRI, six turns", ("day",), (0.0, 60.0, 120.0, 180.0, 240.0, 300.0), 96),
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


def _plane(d: F64, toward: F64) -> tuple[F64, F64, F64]:
    """Of directions (..., 3): their part along ``toward``, and where they meet the plane at distance 1 there."""
    axis = toward / np.linalg.norm(toward)
    side = np.cross(axis, (0, 0, 1.0))
    side /= np.linalg.norm(side)
    ahead = d @ axis
    x, y = (d @ other / np.maximum(ahead, 1e-6) for other in (side, np.cross(side, axis)))
    return ahead, x, y


def _box(d: F64, toward: F64, width: float, height: float, strength: float) -> F64:
    """Radiance of a soft box so far from the middle to its sides, at distance 1."""
    ahead, x, y = _plane(d, toward)
    return np.asarray(strength * ((ahead > 0) & (np.abs(x) < width) & (np.abs(y) < height)))


def radiance(d: F64, kind: str) -> F64:
    """(..., 3) of directions (..., 3)."""
    def glow(toward: F64, width: float, strength: float, colour: tuple[float, float, float]) -> F64:
        off = np.arccos(np.clip(d @ (toward / np.linalg.norm(toward)), -1, 1))
        return (strength * np.exp(-0.5 * (off / width) ** 2))[..., None] * np.array(colour)

    up = np.clip(d[..., 2], 0, 1)
    sky = np.where(d[..., 2] > 0, (1 + 2 * up) / 3, 0.15)[..., None] * np.array([0.75, 0.9, 1.1])
    if kind == "overcast":
        return sky
    if kind == "clear":  # a bare sun, as narrow as the picture's pixels allow
        return np.asarray(0.5 * sky + glow(SUN, 0.008, 8000.0, (1.0, 0.95, 0.85)))
    if kind == "studio":
        return np.asarray(sum((_box(d, *box) for box in BOXES), 0.05)[..., None] * np.ones(3))
    if kind == "room":
        return np.asarray(0.08 * np.ones(3) + glow(np.array([0.3, 0.9, 0.5]), 0.12, 40.0, (1.0, 0.85, 0.65))
                          + glow(np.array([-0.9, -0.4, 0.1]), 0.2, 9.0, (0.8, 0.9, 1.0)))
    ahead, x, y = _plane(d, WINDOW)
    pane = (ahead > 0) & (np.abs(x) < 0.45) & (np.abs(y) < 0.6) & (np.abs(x) > 0.03) & (np.abs(y - 0.1) > 0.03)
    return np.asarray(0.5 * sky + 6.0 * pane[..., None] * np.array([0.9, 1.0, 1.1])
                      + glow(SUN, 0.03, 250.0, (1.0, 0.9, 0.75)))


def hdri(kind: str, path: Path) -> None:
    """Write an equirectangular picture, as Blender maps it."""
    v, u = (np.arange(HDRI_HEIGHT) + 0.5) / HDRI_HEIGHT, (np.arange(2 * HDRI_HEIGHT) + 0.5) / (2 * HDRI_HEIGHT)
    latitude, longitude = (math.pi * (v - 0.5))[:, None], (2 * math.pi * (0.5 - u))[None]
    d = np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude),
                  np.sin(latitude) + 0 * longitude], -1)
    buffer = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(2 * HDRI_HEIGHT, HDRI_HEIGHT, 3, OpenImageIO.FLOAT))
    buffer.set_pixels(OpenImageIO.ROI(), np.ascontiguousarray(radiance(d, kind)[::-1], np.float32))
    buffer.write(str(path))


def world(kind: str, folder: Path) -> bpy.types.World:
    """A world of that picture, which Mapping can turn."""
    path = folder / f"{kind}.exr"
    hdri(kind, path)
    made = bpy.data.worlds.new(kind)
    if made.node_tree is None:
        made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    coordinates, mapping, picture, background, output = (tree.nodes.new(f"ShaderNode{name}") for name in (
        "TexCoord", "Mapping", "TexEnvironment", "Background", "OutputWorld"))
    picture.image = bpy.data.images.load(str(path))
    for one, other in ((coordinates.outputs["Generated"], mapping.inputs["Vector"]),
                       (mapping.outputs["Vector"], picture.inputs["Vector"]),
                       (picture.outputs["Color"], background.inputs["Color"]),
                       (background.outputs[0], output.inputs["Surface"])):
        tree.links.new(one, other)
    if hasattr(made.cycles, "sampling_method"):
        made.cycles.sampling_method = "AUTOMATIC"
    return made


def make(folder: Path, rig: Rig, bounces: int = 0) -> None:
    """``folder``: scene.blend without a trace of the truth, captures.json, pictures and HDRIs."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    (folder / "refs").mkdir(parents=True, exist_ok=True)
    asset = BOTTLE
    _set_up(asset, rig.samples, bounces)
    subject = _mesh(asset)
    blank, painted = _material(NAME), _painted(asset)
    subject.data.materials.append(painted)
    cameras = [_camera(n, count, ring, up) for ring, (count, up) in enumerate(CAMERAS) for n in range(count)]
    views = [view for kind in rig.hdris for view in _render_all(folder, asset, cameras, world(kind, folder), rig.turns)]
    subject.material_slots[0].material = blank
    bpy.data.materials.remove(painted)
    for image in [i for i in bpy.data.images if i.name.startswith("truth ")]:
        bpy.data.images.remove(image)
    bpy.context.scene.world = bpy.data.worlds[rig.hdris[0]]
    for made in bpy.data.worlds:
        made.use_fake_user = True
    (folder / "captures.json").write_text(json.dumps({"views": views}, indent=1), encoding="utf-8")
    bpy.ops.wm.save_as_mainfile(filepath=str((folder / "scene.blend").resolve()), compress=True)


def _render_all(
    folder: Path, asset: Asset, cameras: list[bpy.types.Object], lit_by: bpy.types.World, turns: tuple[float, ...],
) -> list[dict[str, object]]:
    scene = bpy.context.scene
    scene.world = lit_by
    mapping = next(node for node in lit_by.node_tree.nodes if node.type == "MAPPING")
    rng, views = np.random.default_rng(1), []
    for turn in turns:
        mapping.inputs["Rotation"].default_value = (0.0, 0.0, -math.radians(turn))
        for camera in cameras:
            scene.camera = camera
            name = f"refs/{lit_by.name}_{turn:03.0f}_{camera.name}.exr"
            scene.render.filepath = str(folder / name)
            bpy.ops.render.render(write_still=True)
            if asset.noise:
                _add_noise(folder / name, asset.noise, rng)
            views.append({"image": name, "camera": camera.name, "lights": [], "world": lit_by.name, "turn": turn})
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, 0.0)
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
    (part,) = asset.sheets
    mesh = bpy.data.meshes.new(NAME)
    mesh.from_pydata(part.vertices.tolist(), [], part.quads.tolist())
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", part.uvs.ravel().astype(np.float32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(part.quads), bool))
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


def _painted(asset: Asset) -> bpy.types.Material:
    material = _material("truth")
    principled = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for name, socket, values in zip(("base", "roughness"), ("Base Color", "Roughness"), truth(asset), strict=True):
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


def _camera(n: int, count: int, ring: int, up: float) -> bpy.types.Object:
    data = bpy.data.cameras.new(f"Camera {ring + 1}.{n + 1:02d}")
    data.lens = 65
    side = 2 * math.pi * (n + 0.5 * ring) / count
    place = DISTANCE * np.array([math.sin(side) * math.cos(up), -math.cos(side) * math.cos(up), math.sin(up)])
    obj = bpy.data.objects.new(data.name, data)
    obj.location, obj.rotation_euler = Vector(place), (-Vector(place)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj
