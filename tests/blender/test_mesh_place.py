"""The unit and the place of a mesh among cameras that look at it."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest

from irpso_addon.blender.shoot.mesh_place import place
from irpso_addon.core.lens import Lens
from irpso_addon.core.shoot.picture_lens import PictureCamera

LENS = Lens(6000, 4000, 8000.0, 8000.0, 3000.0, 2000.0)
MIDDLE = np.array([0.02, -0.01, 0.015])  # near the origin, where it tells nothing of the unit
DISTANCE = 4.0


def ring() -> list[PictureCamera]:
    """Eight level cameras around MIDDLE."""
    cameras = []
    for n in range(8):
        away = np.array([math.cos(n * math.pi / 4), math.sin(n * math.pi / 4), 0.0])
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([np.cross(-away, [0, 0, 1]), [0, 0, -1], -away])
        pose[:3, 3] = MIDDLE + DISTANCE * away
        cameras.append(PictureCamera(f"{n}", LENS, pose, np.eye(2)))
    return cameras


def cube(share: float, unit: float) -> bpy.types.Object:
    """About MIDDLE, ``unit`` times too large; its diagonal is ``share`` of the pictures'."""
    side = share * math.hypot(6000, 4000) / 8000 * DISTANCE / math.sqrt(3)
    corners = [(np.array([x, y, z]) * side / 2 + MIDDLE) * unit for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    mesh = bpy.data.meshes.new("cube")
    mesh.from_pydata(corners, [], [])
    obj = bpy.data.objects.new("cube", mesh)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


@pytest.mark.parametrize("share", [0.2, 0.5, 1.2])
@pytest.mark.parametrize("unit", [1.0, 100.0, 1000.0, 0.01, 0.001])
def test_the_unit_is_found(share: float, unit: float) -> None:
    obj = cube(share, unit)
    lines = place(obj, ring(), 0.25)
    np.testing.assert_allclose(np.array(obj.matrix_world), np.diag([0.25 / unit] * 3 + [1.0]), rtol=1e-6, atol=1e-9)
    assert [line for line in lines if f"scaled by {1 / unit:g}" in line] == lines and bool(lines) == (unit != 1)


@pytest.mark.parametrize(("share", "told"), [(0.05, True), (0.1, True), (0.2, False), (2.5, False), (5.0, True),
                                             (15.0, True)])
def test_a_mesh_of_an_unlikely_size_is_told_of_and_left(share: float, told: bool) -> None:
    obj = cube(share, 1.0)
    lines = place(obj, ring(), 0.25)
    np.testing.assert_allclose(np.array(obj.matrix_world), np.diag([0.25] * 3 + [1.0]), rtol=1e-6, atol=1e-9)
    assert [f"its diagonal is {share:.2g} times that of the pictures" in line for line in lines] == [True] * told
