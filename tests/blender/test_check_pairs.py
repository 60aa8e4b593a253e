"""Epipolar lines in the check of a shoot: a textured ball that Cycles renders through five cameras."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import bpy
import pytest
from mathutils import Vector

from irpso_addon.blender import files
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.checks.mended_cameras import moved
from irpso_addon.core.checks.shoot_check import ShootCheck, findings
from irpso_addon.core.data import SceneData
from irpso_addon.gpu.device import thread
from irpso_addon.solve import check_shoot

SIZE = 400, 300
STEP = 9  # degrees between cameras


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> SceneData:
    folder: Path = tmp_path_factory.mktemp("ball")
    files.new_blend()
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 16, False
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.film_transparent = True
    scene.render.image_settings.file_format = "OPEN_EXR"
    bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=64)
    ball = bpy.context.object
    ball.data.shade_smooth()
    material = bpy.data.materials.new("Paint")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    noise = material.node_tree.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value = 9
    shader = material.node_tree.nodes["Principled BSDF"]
    material.node_tree.links.new(noise.outputs[0], shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = 0.6
    ball.data.materials.append(material)
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.location, lamp.data.energy = (5, 1, 4), 1500
    scene.collection.objects.link(lamp)
    for number in range(5):
        camera = bpy.data.objects.new(f"Cam {number}", bpy.data.cameras.new(f"Cam {number}"))
        turn = math.radians(STEP * number)
        camera.location = (4.5 * math.cos(turn), 4.5 * math.sin(turn), 0.5)
        camera.rotation_euler = (-Vector(camera.location)).to_track_quat("-Z", "Y").to_euler()
        scene.collection.objects.link(camera)
        scene.camera, scene.render.filepath = camera, str(folder / f"{number}.exr")
        bpy.ops.render.render(write_still=True)
        view = scene.irpso.views.add()
        view.image, view.camera = scene.render.filepath, camera
    files.save_copy(folder / "ball.blend")
    files.open_blend(folder / "ball.blend")
    return read_scene(None, None, None)


def checked(data: SceneData, number: int = 2, up: float = 0.0) -> ShootCheck:
    """Where the picture of one camera lies so many pixels too low."""
    views = list(data.views)
    views[number] = replace(views[number], camera=moved(views[number].camera, (0.0, up), SIZE))
    found: ShootCheck = thread.run(lambda: check_shoot.check(replace(data, views=tuple(views))))
    return found


def test_all_is_well(data: SceneData) -> None:
    found = checked(data)
    assert found.findings == () and len(found.pairs) in (3, 4)  # of nearest neighbours; those on both sides are as near
    assert all(pair.measured and pair.pixels < 0.2 and pair.points > 60 for pair in found.pairs)
    assert "epipolar lines 0." in found.summary


@pytest.mark.parametrize("up", [0.3, 2.0])
def test_one_camera_is_off(data: SceneData, up: float) -> None:
    """Its pairs show it to 0.15 pixels, the others nothing; beyond a pixel it is said, once."""
    found = checked(data, up=up)
    for pair in found.pairs:
        assert pair.measured
        assert pair.pixels == pytest.approx(up, abs=0.15) if "2.exr" in (pair.one, pair.other) else pair.pixels < 0.2
    problems = [finding.problem for finding in found.findings]
    assert problems == (["'2.exr': the picture does not line up with the mesh"] if up > 1 else [])
    alone = [finding.problem for finding in findings(replace(found, views=()))]  # where edges tell nothing
    assert len(alone) == (up > 1)
    for problem in alone:  # both neighbours are as near
        names = set(re.findall(r"'(.)\.exr'", problem))
        assert problem.endswith("their cameras contradict each other") and {"2"} < names <= {"1", "2", "3"}
