"""Cycles' pictures of a material with a Diffuse Roughness: a solve finds it, and sets it on the material."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.blender.material import material
from irpso_addon.blender.sample import demo
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline

BASE, ROUGH, LAMPS, PIXELS = (0.6, 0.4, 0.2), 0.4, 12, 96
RIGHT = SolveSettings(size=32, lamps="given", exposures="given", registration="given", normals="mesh")


def take_pictures(folder: Path, diffuse: float) -> None:
    """A ball of one material, from one side under lamps around the camera; then the ball unpainted."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.8)
    ball = bpy.context.object
    ball.name = "Ball"
    bpy.ops.object.shade_smooth()
    ball.data.materials.append(demo._material("Paint"))
    inputs = ball.data.materials[0].node_tree.nodes["Principled BSDF"].inputs
    plain = {"Base Color": tuple(inputs["Base Color"].default_value), "Roughness": inputs["Roughness"].default_value,
             "Diffuse Roughness": 0.0}
    for name, value in {"Base Color": (*BASE, 1), "Roughness": ROUGH, "Diffuse Roughness": diffuse}.items():
        inputs[name].default_value = value
    camera = demo._add("Camera", bpy.data.cameras.new("Camera"), demo.Vector((0, -4.0, 0)))
    camera.data.lens = 75
    for i in range(LAMPS):
        light = bpy.data.lights.new(f"Lamp {i}", "POINT")
        light.energy, light.shadow_soft_size = 200.0, 0.0
        turn, wide = 2.4 * i, 0.4 + 1.0 * i / LAMPS
        demo._add(light.name, light, demo.Vector(
            (3 * np.sin(wide) * np.cos(turn), -3 * np.cos(wide), 3 * np.sin(wide) * np.sin(turn))))
    demo._set_up_render(scene)
    scene.render.resolution_x = scene.render.resolution_y = PIXELS
    scene.cycles.samples, scene.cycles.max_bounces = 16, 0
    views = []
    for i in range(LAMPS):
        demo._render(folder / f"{i}.exr", camera, bpy.data.objects[f"Lamp {i}"])
        views.append({"image": f"{i}.exr", "camera": "Camera", "lights": [f"Lamp {i}"]})
    (folder / "captures.json").write_text(json.dumps({"views": views}))
    for name, value in plain.items():
        inputs[name].default_value = value
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))


@pytest.mark.parametrize("diffuse", [pytest.param(0.25, marks=pytest.mark.one_python), 0.7])
def test_it_comes_back(tmp_path: Path, diffuse: float) -> None:
    take_pictures(tmp_path, diffuse)
    scene = read_scene(None, "Ball", tmp_path / "captures.json")
    solution = thread.run(lambda: pipeline.solve(scene, RIGHT))
    assert solution.diffuse_roughness == {"Paint": pytest.approx(diffuse, abs=0.02)}
    assert (solution.metallic, solution.coats) == ({}, {})
    solved = solution.maps.coverage & ~solution.maps.filled
    assert np.median(np.abs(solution.maps.roughness[solved] - ROUGH)) < 0.01
    assert np.median(np.abs(solution.maps.base_color[solved] / BASE - 1), axis=0).max() < 0.01
    material.write_maps(bpy.data.objects["Ball"], solution)
    socket = bpy.data.materials["Paint"].node_tree.nodes["Principled BSDF"].inputs["Diffuse Roughness"]
    assert socket.default_value == pytest.approx(solution.diffuse_roughness["Paint"])
    assert read_scene(None, "Ball", tmp_path / "captures.json").warnings == ()  # of what a solve has set
