"""Small .blend scenes with references rendered by Cycles, for the tests of whole commands.

    python tests/support/make_scenes.py OUT

Run as a program, so that no test inherits its Blender.  OUT/good has scene.blend, captures.json and refs; the
other folders are the same scene with one thing wrong in it.  Base colour and roughness are constant: BASE, ROUGH.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import bpy

BASE, ROUGH, PIXELS = (0.6, 0.3, 0.1), 0.45, 96


def main(out: Path) -> None:
    build()
    render(out / "good")
    save(out / "good")
    for name, spoil in SPOILED.items():
        bpy.ops.wm.open_mainfile(filepath=str(out / "good" / "scene.blend"))
        spoil()
        save(out / name)


def build() -> None:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=1)
    ball = bpy.context.object
    ball.name = "Ball"
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("Paint")
    if material.node_tree is None:  # Blender 5 makes the nodes at once
        material.use_nodes = True
    ball.data.materials.append(material)
    for i in range(2):
        camera = bpy.data.objects.new(f"Camera {i}", bpy.data.cameras.new(f"Camera {i}"))
        camera.location = (1.2 * (2 * i - 1), -4.6, 0.6)
        camera.data.lens = 60
        place(camera)
    for i in range(5):
        light = bpy.data.objects.new(f"Light {i}", bpy.data.lights.new(f"Light {i}", "POINT"))
        light.data.energy, light.data.shadow_soft_size = 200.0, 0.0
        turn = math.radians(-70 + 35 * i)
        light.location = (3 * math.sin(turn), -3 * math.cos(turn), 2.0 - 1.5 * (i % 2))
        place(light)
    render, cycles = scene.render, scene.cycles
    scene.world = None
    render.engine, render.film_transparent = "CYCLES", True
    render.resolution_x = render.resolution_y = PIXELS
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.color_mode = "RGBA"
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising, cycles.max_bounces = 4, False, False, 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = cycles.blur_glossy = 0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0


def place(obj: bpy.types.Object) -> None:
    obj.rotation_euler = (-obj.location).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(obj)


def render(folder: Path) -> None:
    paint(BASE, ROUGH)
    views = []
    lights = [obj for obj in bpy.data.objects if obj.type == "LIGHT"]
    for camera in [obj for obj in bpy.data.objects if obj.type == "CAMERA"]:
        for light in lights:
            for other in lights:
                other.hide_render = other is not light
            image = f"refs/{camera.name}, {light.name}.exr"
            bpy.context.scene.camera, bpy.context.scene.render.filepath = camera, str(folder / image)
            bpy.ops.render.render(write_still=True)
            views.append({"image": image, "camera": camera.name, "lights": [light.name]})
    for light in lights:
        light.hide_render = False
    (folder / "captures.json").write_text(json.dumps({"views": views}))
    paint((0.8, 0.8, 0.8), 0.5)


def paint(base: tuple[float, float, float], rough: float) -> None:
    principled = bpy.data.materials["Paint"].node_tree.nodes["Principled BSDF"]
    principled.inputs["Base Color"].default_value = (*base, 1)
    principled.inputs["Roughness"].default_value = rough


def save(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))


def no_uvs() -> None:
    layers = bpy.data.meshes[bpy.data.objects["Ball"].data.name].uv_layers
    layers.remove(layers[0])


def remove(kind: str) -> None:
    for obj in [obj for obj in bpy.data.objects if obj.type == kind]:
        bpy.data.objects.remove(obj)


def two_meshes() -> None:
    ball = bpy.data.objects["Ball"]
    other = bpy.data.objects.new("Second", ball.data.copy())
    other.location.x = 9
    bpy.context.scene.collection.objects.link(other)
    bpy.context.view_layer.objects.active = None


def no_light() -> None:
    remove("LIGHT")
    for camera in [obj for obj in bpy.data.objects if obj.type == "CAMERA"]:
        image = bpy.data.images.load(str(next((Path(bpy.data.filepath).parent / "refs").glob(f"{camera.name}*.exr"))))
        camera.data.background_images.new().image = image


def udims() -> None:
    """No fault: the left half of the UV map fills the square 1001, the right half 1002."""
    for corner in bpy.data.objects["Ball"].data.uv_layers.active.data:
        corner.uv.x *= 2


SPOILED = {
    "no_uvs": no_uvs, "no_light": no_light, "no_views": lambda: None, "no_camera": lambda: remove("CAMERA"),
    "no_mesh": lambda: remove("MESH"), "two_meshes": two_meshes, "udims": udims,
}

if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
