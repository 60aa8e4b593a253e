"""The demo's scene: the vase of core/samples/vase.py under cameras and lights, rendered by Cycles.

Cycles draws the references, not our own shaders: a solve that recovers the maps from them has recovered
what Blender shows.
"""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ...core.data import F32
from ...core.job import Progress
from ...core.samples import vase
from ...core.storage.atomic_io import replacing, write_whole

NAME = "Vase"
PIXELS, SAMPLES, TEXELS = 288, 4, 512
HELD_OUT = "held out"  # a camera and a light that no view uses: the picture's last row
DISTANCE, LIGHT_DISTANCE = 4.2, 3.2  # metres
SAME_SIDE = math.radians(100)  # a view's light is at most so far from its camera, seen from the vase


@dataclass(frozen=True)
class Plan:
    """How finely the vase is painted, how many cameras and lights stand around it, and how it is rendered."""

    texels: int = TEXELS
    cameras: int = 4
    lights: int = 14
    pixels: int = PIXELS
    samples: int = SAMPLES


@dataclass(frozen=True)
class Reference:
    """One picture, rendered."""

    image: str  # path from the scene's folder
    camera: bpy.types.Object
    light: bpy.types.Object


@dataclass(frozen=True)
class Demo:
    """What `make` left in its folder, and the truth that no file holds."""

    scene: Path
    captures: Path
    relit: Path  # the truth under the held-out light
    base_color: F32  # (texels, texels, 3) linear, row 0 bottom
    roughness: F32  # (texels, texels)


def make(out: Path, plan: Plan = Plan()) -> Iterator[Progress | Demo]:
    """Build, render, save into ``out``; yields Progress and, last, the Demo."""
    base, rough = vase.truth(plan.texels)
    references = yield from painted(out, plan, base, rough)
    _add_held_out()
    relit = out / "truth_relit.exr"
    render_held_out(relit)
    unpaint()
    views = [{"image": it.image, "camera": it.camera.name, "lights": [it.light.name]} for it in references]
    write_whole(out / "captures.json", (json.dumps({"views": views}, indent=1) + "\n").encode())
    save(out / "scene.blend")
    yield Demo(out / "scene.blend", out / "captures.json", relit, base, rough)


def painted(out: Path, plan: Plan, base: F32, rough: F32) -> Generator[Progress, None, list[Reference]]:
    """A new file with the vase, painted; its references lie below ``out`` afterwards."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    obj = _add_vase()
    cameras, lights = _add_cameras(plan.cameras), _add_lights(plan.lights)
    _set_up_render(bpy.context.scene)
    bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = plan.pixels
    bpy.context.scene.cycles.samples = plan.samples
    obj.material_slots[0].material = _truth_material(base, rough)
    jobs = [(camera, light) for camera in cameras for light in lights if _same_side(camera, light)]
    found = []
    (out / "refs").mkdir(parents=True, exist_ok=True)
    for i, (camera, light) in enumerate(jobs):
        yield Progress(i / len(jobs), "render", f"view {i + 1} of {len(jobs)}")
        found.append(Reference(f"refs/{camera.name}, {light.name}.exr", camera, light))
        _render(out / found[-1].image, camera, light)
    return found


def unpaint() -> None:
    """The vase is blank again, and nothing in the file knows how it was painted."""
    bpy.data.objects[NAME].material_slots[0].material = bpy.data.materials[NAME]
    _forget_truth()


def save(path: Path) -> None:
    """Saves what is open."""
    bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), compress=True)


def render_held_out(path: Path) -> None:
    """Render the open scene with the camera and the light that no view used."""
    _render(path, bpy.data.objects[f"Camera {HELD_OUT}"], bpy.data.objects[f"Light {HELD_OUT}"])


def read_render(path: Path) -> F32:
    """A render as (h, w, 4), row 0 at the bottom."""
    image = bpy.data.images.load(str(path.resolve()))
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)


# ---- the scene


def _add_vase() -> bpy.types.Object:
    """The mesh with a blank Principled material."""
    shape = vase.mesh()
    mesh = bpy.data.meshes.new(NAME)
    mesh.from_pydata(shape.vertices.tolist(), [], shape.quads.tolist())
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", shape.uvs.ravel())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(shape.quads), bool))
    mesh.validate()
    mesh.materials.append(_material(NAME))
    obj = bpy.data.objects.new(NAME, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _add_cameras(count: int) -> list[bpy.types.Object]:
    """A ring of cameras, one from above, the next from the middle."""
    cameras = []
    for i in range(count):
        turn = 2 * math.pi * i / count
        cameras.append(_add_camera(f"Camera {i + 1}", turn, 0.42 if i % 2 == 0 else -0.03))
    return cameras


def _add_camera(name: str, turn: float, pitch: float) -> bpy.types.Object:
    data = bpy.data.cameras.new(name)
    data.lens = 76
    place = Vector((math.sin(turn) * math.cos(pitch), -math.cos(turn) * math.cos(pitch), math.sin(pitch)))
    return _add(name, data, place * DISTANCE)


def _add_lights(count: int) -> list[bpy.types.Object]:
    """Point lights spread over the sphere down to 35 degrees below the horizon (a Fibonacci spiral)."""
    lights = []
    for i in range(count):
        z = 0.92 - (0.92 + math.sin(math.radians(35))) * (i + 0.5) / count
        turn = 2.399963 * i  # the golden angle
        ring = math.sqrt(1 - z * z)
        lights.append(_add_light(f"Light {i + 1:02d}", Vector((ring * math.cos(turn), ring * math.sin(turn), z))))
    return lights


def _add_light(name: str, direction: Vector) -> bpy.types.Object:
    data = bpy.data.lights.new(name, "POINT")
    data.energy, data.shadow_soft_size = 260.0, 0.0
    return _add(name, data, direction * LIGHT_DISTANCE)


def _add_held_out() -> None:
    _add_camera(f"Camera {HELD_OUT}", 0.70, 0.25)
    _add_light(f"Light {HELD_OUT}", Vector((0.30, -0.80, 0.85)).normalized())


def _add(name: str, data: bpy.types.ID, place: Vector) -> bpy.types.Object:
    """An object at ``place`` that looks at the origin."""
    obj = bpy.data.objects.new(name, data)
    obj.location = place
    obj.rotation_euler = (-place).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _same_side(camera: bpy.types.Object, light: bpy.types.Object) -> bool:
    return camera.location.angle(light.location) < SAME_SIDE


# ---- materials


def _material(name: str) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # Blender 5 makes the nodes at once
        material.use_nodes = True
    return material


def _truth_material(base: F32, rough: F32) -> bpy.types.Material:
    """The painted vase; removed again before the scene is saved."""
    material = _material("truth")
    tree = material.node_tree
    principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    for socket, array in (("Base Color", base), ("Roughness", rough)):
        rgba = np.ones((*array.shape[:2], 4), np.float32)
        rgba[..., :3] = array if array.ndim == 3 else array[..., None]
        image = bpy.data.images.new(f"truth {socket}", *array.shape[1::-1], float_buffer=True, is_data=True)
        image.pixels.foreach_set(rgba.ravel())
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        tree.links.new(node.outputs["Color"], principled.inputs[socket])
    return material


def _forget_truth() -> None:
    bpy.data.materials.remove(bpy.data.materials["truth"])
    for image in [i for i in bpy.data.images if i.name.startswith("truth ")]:
        bpy.data.images.remove(image)


# ---- rendering


def _set_up_render(scene: bpy.types.Scene) -> None:
    """Linear references as they should be: direct light only, a pixel the mean over its square, nothing clamped."""
    scene.world = None
    render, cycles = scene.render, scene.cycles
    render.engine, render.film_transparent, render.use_persistent_data = "CYCLES", True, True
    render.resolution_x = render.resolution_y = PIXELS
    render.resolution_percentage = 100
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_mode, render.image_settings.color_depth = "RGBA", "32"
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = SAMPLES, False, False
    cycles.max_bounces, cycles.use_light_tree = 0, False  # one lamp needs no choice
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = cycles.blur_glossy = 0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0


@contextmanager
def _interrupted_after() -> Iterator[None]:
    """Holds Ctrl-C back until the block has ended: Blender drops what is raised while it renders."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # in the window
        yield
        return
    pressed: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if pressed:
        raise KeyboardInterrupt


def _render(path: Path, camera: bpy.types.Object, light: bpy.types.Object) -> None:
    """One picture with one light on."""
    scene = bpy.context.scene
    for obj in _lights():
        obj.hide_render = obj is not light
    before, scene.camera = scene.render.filepath, camera
    with replacing(path.resolve()) as part:
        scene.render.filepath = str(part)
        with _interrupted_after():
            bpy.ops.render.render(write_still=True)
    scene.render.filepath = before
    for obj in _lights():
        obj.hide_render = False


def _lights() -> Sequence[bpy.types.Object]:
    return [obj for obj in bpy.context.scene.objects if obj.type == "LIGHT"]
