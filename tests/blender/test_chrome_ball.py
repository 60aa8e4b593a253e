"""A chrome ball that Cycles renders: the direction to a lamp by its highlight."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from irpso_addon.core.lens import Lens  # noqa: E402
from irpso_addon.core.shoot.ball_highlight import find_highlight, reflected_ray  # noqa: E402
from irpso_addon.core.shoot.chrome_ball import find_ball  # noqa: E402
from tests.blender import cycles_rig as rig  # noqa: E402

pytestmark = pytest.mark.one_python

PIXELS, ANGLE, RADIUS = 240, 20.0, 0.1
CENTRE = np.array([0.03, 0.02, 0.01])


def to_camera(points):
    """World to the axes of core/lens.py: Blender's camera looks along -Z, with Y up."""
    matrix = np.array(bpy.context.scene.camera.matrix_world.inverted())
    points = np.asarray(points) @ matrix[:3, :3].T + matrix[:3, 3]
    return points * (1, -1, -1)


@pytest.mark.parametrize("lamp", [(-0.9, -1.0, 1.2), (1.3, 0.3, 0.4), (0.1, -1.3, -0.6)])
def test_direction_in_a_render(lamp):
    """At most 0.2 degrees: 64 samples a pixel, a glowing ball of 4 cm as the lamp, before a wall of squares."""
    scene = rig.scene(PIXELS, samples=64)
    scene.cycles.max_bounces = scene.cycles.glossy_bounces = 2
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 1.5
    rig.camera((0.0, -1.0, 0.3), degrees=ANGLE)
    ball = rig.sphere(RADIUS)
    ball.location = CENTRE
    node = rig.principled(ball, (0.9, 0.9, 0.9), 0.0)
    node.inputs["Metallic"].default_value = 1.0
    glowing = rig.sphere(0.04)
    glowing.location = lamp
    node = rig.principled(glowing, (0, 0, 0), 1.0, 0.0)
    node.inputs["Emission Color"].default_value = (1, 1, 1, 1)
    node.inputs["Emission Strength"].default_value = 100.0
    wall = rig.plane(3.0)
    wall.location, wall.rotation_euler = (0.0, 2.0, 0.0), (np.pi / 2, 0, 0)
    node = rig.principled(wall, (0, 0, 0), 1.0, 0.0)
    node.inputs["Emission Strength"].default_value = 0.4
    squares = node.id_data.nodes.new("ShaderNodeTexChecker")
    squares.inputs["Scale"].default_value = 40.0
    node.id_data.links.new(squares.outputs["Color"], node.inputs["Emission Color"])
    image = rig.render()["rgb"]

    focal = PIXELS / 2 / np.tan(np.radians(ANGLE / 2))
    lens = Lens(PIXELS, PIXELS, focal, focal, PIXELS / 2, PIXELS / 2)
    centre = to_camera(CENTRE)
    found = find_ball(np.clip(image, 0, 1), lens, (*lens.project(centre), 60.0))
    assert np.linalg.norm(found.centre(RADIUS) - centre) < 0.002
    ray = reflected_ray(found, lens, find_highlight(image, lens, found), RADIUS)
    towards = to_camera(lamp) - ray.origin
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(ray.direction, towards)), ray.direction @ towards))
    assert angle < 0.2
