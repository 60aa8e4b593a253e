"""Lamps in a room that is not quite dark, rendered by Cycles: the light from everywhere is found and subtracted."""

from __future__ import annotations

import json
from dataclasses import replace

import bpy
import numpy as np
import pytest

from irpso_addon.blender.sample import demo
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.data import SceneData, Solution
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline

BASE, ROUGH, PIXELS = (0.6, 0.3, 0.12), 0.4, 96
RADIANCE = 0.05, 0.06, 0.08  # W/(m^2 sr): 5 % of the lamps' irradiance
SETTINGS = SolveSettings(size=64, model="one-lobe", registration="given", indirect="off", normals="mesh")


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> SceneData:
    """A ball in a dish, two cameras, six lamps, and a world that the solve is not given."""
    folder = tmp_path_factory.mktemp("ambient")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    made = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.8)
    ball = bpy.context.object
    bpy.ops.object.shade_smooth()
    ball.data.materials.append(demo._material("Paint"))
    inputs = ball.data.materials[0].node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value, inputs["Roughness"].default_value = (*BASE, 1), ROUGH
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
    made.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*RADIANCE, 1)
    made.render.resolution_x = made.render.resolution_y = PIXELS
    made.cycles.samples, made.cycles.max_bounces = 64, 0
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


def solve(scene: SceneData, **more: str) -> Solution:
    return thread.run(lambda: pipeline.solve(scene, replace(SETTINGS, **more)))


def errors(solution: Solution) -> tuple[float, float]:
    """Mean errors of roughness and of base colour."""
    maps = solution.maps
    where = maps.coverage & ~maps.filled
    return float(np.abs(maps.roughness - ROUGH)[where].mean()), float(np.abs(maps.base_color - BASE)[where].mean())


def test_the_room_is_found(scene: SceneData) -> None:
    """All of what it costs is mended; the dish hides a part of it."""
    given, found = solve(scene, lamps="given", exposures="given"), solve(scene)
    told = replace(scene, views=tuple(replace(view, ambient_radiance=RADIANCE) for view in scene.views))
    known = solve(told, lamps="given", exposures="given")
    assert found.calibration is not None and found.calibration.ambient is not None
    np.testing.assert_allclose(found.calibration.ambient.radiance, RADIANCE, rtol=0.04)  # 2.5 % of blue here
    before, after, right = (errors(solution) for solution in (given, found, known))
    assert after[1] < 0.1 * before[1] and right[1] < 0.1 * before[1]  # 0.0046 and 0.0055 of 0.0752 here
    assert after[0] < 0.6 * before[0] and right[0] < 0.6 * before[0]  # 0.038 and 0.046 of 0.089
