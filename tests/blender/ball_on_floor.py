"""A ball above a floor, whose light it sees, for tests of indirect light."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np

from irpso_addon.blender.sample import demo
from irpso_addon.core.data import Maps, Solution

BASE, ROUGH, PIXELS = (0.7, 0.35, 0.15), 0.4, 96
RIGHT = {"lamps": "given", "exposures": "given", "registration": "given"}
PLAIN = {**RIGHT, "model": "one-lobe"}


def build(base, rough, level, metallic=0.0, coat=None, diffuse=0.0) -> bpy.types.Scene:
    """Ball, floor, two cameras, three lamps; the ball has the given material."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=0.8)
    ball = bpy.context.object
    ball.name = "Ball"
    bpy.ops.object.shade_smooth()
    bpy.ops.mesh.primitive_plane_add(size=6, location=(0, 0, -0.8))
    floor = bpy.context.object
    floor.name = "Floor"
    paint(ball, "Paint", base, rough, level, metallic)
    inputs = ball.data.materials[0].node_tree.nodes["Principled BSDF"].inputs
    inputs["Diffuse Roughness"].default_value = diffuse
    if coat is not None:
        inputs["Coat Weight"].default_value, inputs["Coat Roughness"].default_value = coat.weight, coat.roughness
    paint(floor, "Floor", (0.6, 0.6, 0.5), 1.0, 0.0)
    for i, x in enumerate((-1.2, 1.2)):
        add(f"Camera {i}", bpy.data.cameras.new("Camera"), (x, -4.0, 0.9)).data.lens = 75
    for i, place in enumerate(((-2.8, -0.6, 1.5), (0.5, -2.5, 2.5), (2.8, -0.4, 1.0))):
        lamp = bpy.data.lights.new("Lamp", "POINT")
        lamp.energy, lamp.shadow_soft_size = 200.0, 0.0
        add(f"Lamp {i}", lamp, place)
    demo._set_up_render(scene)
    scene.render.resolution_x = scene.render.resolution_y = PIXELS
    scene.cycles.samples, scene.cycles.max_bounces = 32, 4
    bpy.context.view_layer.objects.active = ball
    return scene


def add(name, data, place) -> bpy.types.Object:
    return demo._add(name, data, demo.Vector(place))


def paint(obj, name, base, rough, level, metallic=0.0) -> None:
    if not obj.data.materials:
        obj.data.materials.append(demo._material(name))
    inputs = obj.data.materials[0].node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value, inputs["Roughness"].default_value = (*base, 1), rough
    inputs["Specular IOR Level"].default_value, inputs["Metallic"].default_value = level, metallic


def references(folder: Path) -> None:
    """A picture of each camera under each lamp; then the file, its ball unpainted."""
    (folder / "refs").mkdir(parents=True)
    views = []
    for camera in ("Camera 0", "Camera 1"):
        for lamp in ("Lamp 0", "Lamp 1", "Lamp 2"):
            image = f"refs/{camera}, {lamp}.exr"
            demo._render(folder / image, bpy.data.objects[camera], bpy.data.objects[lamp])
            views.append({"image": image, "camera": camera, "lights": [lamp]})
    (folder / "captures.json").write_text(json.dumps({"views": views}))
    paint(bpy.data.objects["Ball"], "Paint", (0.8, 0.8, 0.8), 0.5, 0.5)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))


def solution_of(base, rough, model, metallic=0.0, coat=None, mapped=False, diffuse=0.0) -> Solution:
    """Constant maps; ``mapped``: Metallic is one of them, as beside paint."""
    shape, none = (8, 8), np.zeros((8, 8), np.float32)
    maps = Maps(base_color=np.broadcast_to(np.array(base, np.float32), (*shape, 3)), roughness=none + np.float32(rough),
                confidence=none, error=none, filled=none > 0, coverage=none > 0, roughness_sigma=none, base_sigma=none,
                metallic=none + np.float32(metallic) if mapped else None)
    value = 0.1 if mapped else metallic
    return Solution(maps=maps, model={"Paint": model}, why={}, texels={}, seconds={}, residual=0.0, views_used=(),
                    views_skipped=(), warnings=(), device={}, metallic={"Paint": value} if value else {},
                    coats={"Paint": coat} if coat else {}, paint={"Paint": 0.0} if mapped else {},
                    diffuse_roughness={"Paint": diffuse} if diffuse else {})
