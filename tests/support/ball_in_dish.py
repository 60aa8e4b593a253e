"""A ball in a dish under six lamps, from two cameras, rendered by Cycles with light from a room."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np

from irpso_addon.blender.sample import demo
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.data import SceneData

ROUGH, PIXELS = 0.4, 96


def rendered(folder: Path, tones: Sequence[Sequence[float]], room: Sequence[float]) -> SceneData:
    """``tones``: base colours, in squares; ``room``: radiance of the world, which the solve is not given."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    made = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.8)
    ball = bpy.context.object
    bpy.ops.object.shade_smooth()
    ball.data.materials.append(demo._material("Paint"))
    _paint(ball.data.materials[0].node_tree, tones)
    bpy.ops.mesh.primitive_cylinder_add(vertices=64, radius=1.2, depth=0.5, end_fill_type="NOTHING",
                                        location=(0, 0, -0.7))  # it hides a part of the world
    cameras = [demo._add(f"Camera {i}", bpy.data.cameras.new("Camera"), demo.Vector((x, -4.0, 1.6)))
               for i, x in enumerate((-1.2, 1.2))]
    lamps = []
    for i, place in enumerate(((-2.8, -1.6, 1.5), (0.5, -2.5, 2.5), (2.8, -1.4, 1.0), (-1.0, -2.8, 0.4),
                               (1.4, -2.6, 1.6), (-0.4, -1.5, 3.2))):
        data = bpy.data.lights.new("Lamp", "POINT")
        data.energy, data.shadow_soft_size = 200.0, 0.0
        lamps.append(demo._add(f"Lamp {i}", data, demo.Vector(place)))
    demo._set_up_render(made)
    made.world = bpy.data.worlds.new("Room")
    if bpy.app.version < (5, 0, 0):
        made.world.use_nodes = True
    made.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*room, 1)
    made.render.resolution_x = made.render.resolution_y = PIXELS
    made.cycles.samples, made.cycles.max_bounces = 32, 0
    views = []
    for camera in cameras:
        camera.data.lens = 75
        for lamp in lamps:
            image = f"{camera.name}, {lamp.name}.exr"
            demo._render(folder / image, camera, lamp)
            views.append({"image": image, "camera": camera.name, "lights": [lamp.name]})
    (folder / "captures.json").write_text(json.dumps({"views": views}))
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "room.blend"))
    return read_scene(None, ball.name, folder / "captures.json")


def base_colors(tones: Sequence[Sequence[float]], size: int) -> np.ndarray:
    """(size, size, 3) of the ball's texels: eight squares across the UV square."""
    square = np.arange(size) * 8 // size
    return np.array(tones)[(square[:, None] + square[None]) % len(tones)]


def _paint(tree: bpy.types.NodeTree, tones: Sequence[Sequence[float]]) -> None:
    inputs = tree.nodes["Principled BSDF"].inputs
    inputs["Roughness"].default_value = ROUGH
    if len(tones) == 1:
        inputs["Base Color"].default_value = (*tones[0], 1)
        return
    size = 256
    picture = bpy.data.images.new("Tones", size, size, float_buffer=True, is_data=True)
    pixels = np.ones((size, size, 4), np.float32)
    pixels[..., :3] = base_colors(tones, size)
    picture.pixels.foreach_set(pixels.ravel())
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = picture
    tree.links.new(node.outputs["Color"], inputs["Base Color"])
