"""An asset before 3 cameras and under 12 lamps, one lamp a view, rendered by Cycles: its truth is known."""

from __future__ import annotations

import json
import math
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO
from mathutils import Vector

from irpso_addon.core.data import F32, F64
from studies.intervals.assets import Asset, truth

NAME = "Subject"
CAMERAS = ((0.0, 0.15), (0.8, 0.35), (-0.75, -0.2))  # radians to the side and up, from +Z
LAMPS, CONE = 12, math.radians(70)
DISTANCE, LAMP_DISTANCE = 4.0, 3.0  # metres
ROOM_SAMPLES = 256


def make(asset: Asset, folder: Path, lamps: int = LAMPS, room: bool = False) -> None:
    """``folder``: scene.blend without a trace of the truth, captures.json, refs.

    ``room``: with a picture of each camera under light of radiance 1 from everywhere, "room Camera 1.exr".
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    set_up(asset.pixels, asset.samples, asset.bounces)
    subject = _add_mesh(asset)
    blank = [slot.material for slot in subject.material_slots]
    painted = _painted(asset)
    for slot, material in zip(subject.material_slots, painted, strict=True):
        slot.material = material
    (folder / "refs").mkdir(parents=True, exist_ok=True)
    cameras, lights = [_camera(i) for i in range(len(CAMERAS))], _lamps(asset, lamps)
    views = _render_all(folder, asset, cameras, lights)
    if room:
        _render_room(folder, cameras, lights)
    for slot, material in zip(subject.material_slots, blank, strict=True):
        slot.material = material
    for material in painted:
        bpy.data.materials.remove(material)
    for image in [i for i in bpy.data.images if i.name.startswith("truth ")]:
        bpy.data.images.remove(image)
    (folder / "captures.json").write_text(json.dumps({"views": views}, indent=1), encoding="utf-8")
    bpy.ops.wm.save_as_mainfile(filepath=str((folder / "scene.blend").resolve()), compress=True)


def set_up(pixels: int, samples: int, bounces: int) -> None:
    """Cycles without anything that is not light: square pictures, box filter, no clamping."""
    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    scene.world = None
    render.engine, render.film_transparent, render.use_persistent_data = "CYCLES", True, True
    render.resolution_x = render.resolution_y = pixels
    render.resolution_percentage = 100
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_mode, render.image_settings.color_depth = "RGBA", "32"
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = samples, False, False
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = cycles.blur_glossy = 0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0


def _add_mesh(asset: Asset) -> bpy.types.Object:
    first = np.cumsum([0] + [len(part.vertices) for part in asset.sheets[:-1]])
    vertices = np.concatenate([part.vertices for part in asset.sheets])
    vertices = vertices - (vertices.max(0) + vertices.min(0)) / 2
    vertices /= np.linalg.norm(vertices, axis=1).max()  # within a sphere of 1 m
    quads = np.concatenate([part.quads + start for part, start in zip(asset.sheets, first, strict=True)])
    mesh = bpy.data.meshes.new(NAME)
    mesh.from_pydata(vertices.tolist(), [], quads.tolist())
    mesh.uv_layers.new(name="UVMap").data.foreach_set(
        "uv", np.concatenate([part.uvs.ravel() for part in asset.sheets]).astype(np.float32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(quads), bool))
    mesh.polygons.foreach_set(
        "material_index", np.repeat([part.slot for part in asset.sheets], [len(part.quads) for part in asset.sheets]))
    for slot in range(len(asset.levels)):
        mesh.materials.append(add_material(f"{NAME} {slot + 1}"))
    obj = bpy.data.objects.new(NAME, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def add_material(name: str) -> bpy.types.Material:
    """With Blender's default nodes."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # Blender 5 makes the nodes at once
        material.use_nodes = True
    return material


def _painted(asset: Asset) -> list[bpy.types.Material]:
    images = [truth_image("base", truth(asset)[0]), truth_image("roughness", truth(asset)[1])]
    materials = []
    for level in asset.levels:
        materials.append(add_material("truth"))
        tree = materials[-1].node_tree
        principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
        principled.inputs["Specular IOR Level"].default_value = level
        for socket, image in zip(("Base Color", "Roughness"), images, strict=True):
            node = tree.nodes.new("ShaderNodeTexImage")
            node.image = image
            if asset.finest:
                node.interpolation = "Closest"
            tree.links.new(node.outputs["Color"], principled.inputs[socket])
    return materials


def truth_image(name: str, array: F32) -> bpy.types.Image:
    """Of (h, w) or (h, w, 3), row 0 at the bottom; linear."""
    height, width = array.shape[:2]
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = array if array.ndim == 3 else array[..., None]
    image = bpy.data.images.new(f"truth {name}", width, height, float_buffer=True, is_data=True)
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    return image


def _camera(i: int) -> bpy.types.Object:
    side, up = CAMERAS[i]
    data = bpy.data.cameras.new(f"Camera {i + 1}")
    data.lens = 65
    place = np.array([math.sin(side) * math.cos(up), math.sin(up), math.cos(side) * math.cos(up)])
    return _add(data, DISTANCE * place)


def _lamps(asset: Asset, count: int) -> list[bpy.types.Object]:
    """Evenly over a cone about +Z (a Fibonacci spiral)."""
    z = 1 - (1 - math.cos(CONE)) * (np.arange(count) + 0.5) / count
    turn, ring = 2.399963 * np.arange(count) + 0.7, np.sqrt(1 - z * z)
    places = LAMP_DISTANCE * np.stack([ring * np.cos(turn), ring * np.sin(turn), z], -1)
    return [_lamp(asset, i, place) for i, place in enumerate(places)]


def _lamp(asset: Asset, i: int, place: F64) -> bpy.types.Object:
    data = bpy.data.lights.new(f"Lamp {i + 1:02d}", "AREA" if asset.area else "POINT")
    data.energy = 200.0
    if asset.area:
        data.shape, data.size = "DISK", asset.area
    else:
        data.shadow_soft_size = 0.0
    return _add(data, place)


def _add(data: bpy.types.ID, place: F64) -> bpy.types.Object:
    obj = bpy.data.objects.new(data.name, data)
    obj.location = place
    obj.rotation_euler = (-Vector(place)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _render_all(
    folder: Path, asset: Asset, cameras: list[bpy.types.Object], lamps: list[bpy.types.Object],
) -> list[dict[str, object]]:
    rng, views = np.random.default_rng(1), []
    scene = bpy.context.scene
    for camera in cameras:
        for lamp in lamps:
            for other in lamps:
                other.hide_render = other is not lamp
            scene.camera, name = camera, f"refs/{camera.name}, {lamp.name}.exr"
            scene.cycles.seed = len(views)
            scene.render.filepath = str(folder / name)
            bpy.ops.render.render(write_still=True)
            add_noise(folder / name, asset.noise, rng)
            views.append({"image": name, "camera": camera.name, "lights": [lamp.name]})
    for lamp in lamps:
        lamp.hide_render = False
    scene.render.filepath = ""
    return views


def _render_room(folder: Path, cameras: list[bpy.types.Object], lamps: list[bpy.types.Object]) -> None:
    scene = bpy.context.scene
    scene.world = world = bpy.data.worlds.new("room")
    if world.node_tree is None:  # Blender 5 makes the nodes at once
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    for lamp in lamps:
        lamp.hide_render = True
    scene.cycles.samples = ROOM_SAMPLES
    for camera in cameras:
        scene.camera, scene.render.filepath = camera, str(folder / f"refs/room {camera.name}.exr")
        bpy.ops.render.render(write_still=True)
    for lamp in lamps:
        lamp.hide_render = False
    bpy.data.worlds.remove(world)
    scene.render.filepath = ""


def add_noise(path: Path, noise: float, rng: np.random.Generator) -> None:
    """In proportion to each channel of each pixel."""
    read = OpenImageIO.ImageBuf(str(path))
    pixels = read.get_pixels(OpenImageIO.FLOAT)
    pixels[..., :3] *= 1 + noise * rng.standard_normal(pixels[..., :3].shape)
    made = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], 4, "float"))
    made.set_pixels(OpenImageIO.ROI(), np.ascontiguousarray(pixels, np.float32))
    if not made.write(str(path)):
        raise OSError(f"{path}: {made.geterror()}")
