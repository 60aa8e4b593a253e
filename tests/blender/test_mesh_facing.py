"""Meshes that are inside out are turned round by what cameras see of them; others are left as they are."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest

from irpso_addon.blender.shoot.mesh_facing import face_cameras
from irpso_addon.core.lens import Lens
from irpso_addon.core.shoot.picture_lens import PictureCamera

LENS = Lens(600, 400, 800.0, 800.0, 300.0, 200.0)
SCALE = 0.25  # metres per unit of the project


def cameras(above: bool = False) -> list[PictureCamera]:
    """Twelve around the origin, 4 units away, all at one height."""
    found = []
    for n in range(12):
        pose = np.eye(4)
        pose[:3, 3] = (4 * math.cos(n * math.pi / 6), 4 * math.sin(n * math.pi / 6), 4.0 if above else 0.5)
        found.append(PictureCamera(f"{n}", LENS, pose, np.eye(2)))
    return found


def ball(inside_out: bool, custom: int = 0, mirrored: bool = False) -> bpy.types.Object:
    """Of radius 1 unit; ``custom``: normals of the file, 1 outwards, -1 inwards, 0 none."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12, radius=1)
    obj = bpy.context.object
    obj.scale = (-SCALE if mirrored else SCALE, SCALE, SCALE)
    obj.data.shade_smooth()
    if inside_out:
        obj.data.flip_normals()
    if custom:
        out = [custom * obj.data.vertices[loop.vertex_index].co.normalized() for loop in obj.data.loops]
        obj.data.normals_split_custom_set([tuple(normal) for normal in out])
    return obj


def outwards(obj: bpy.types.Object) -> tuple[float, float]:
    """Share of the faces by their corners' order, and of the corners' normals, that look away from the origin."""
    mesh = obj.data
    places = [mesh.vertices[loop.vertex_index].co for loop in mesh.loops]
    return (float(np.mean([face.normal.dot(face.center) > 0 for face in mesh.polygons])),
            float(np.mean([normal.vector.dot(place) > 0
                           for normal, place in zip(mesh.corner_normals, places, strict=True)])))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("custom", [0, 1, -1])
def test_a_ball_that_is_inside_out(custom: int, mirrored: bool) -> None:
    """Whichever way the normals of the file look; a mirrored object is seen as Blender shows it."""
    obj = ball(True, custom, mirrored)
    (line,) = face_cameras(obj, cameras(), SCALE)
    assert "its faces look inwards (100 %" in line and "turned round" in line
    assert outwards(obj) == (1.0, 1.0)
    assert face_cameras(obj, cameras(), SCALE) == []


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_right_ball_is_left(mirrored: bool) -> None:
    obj = ball(False, 1, mirrored)
    assert face_cameras(obj, cameras(), SCALE) == [] and outwards(obj) == (1.0, 1.0)


@pytest.mark.parametrize("turned", [False, True])
def test_a_flat_sample_under_cameras(turned: bool) -> None:
    """It has no inside: what counts is that the cameras see its front."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=9, y_subdivisions=9, size=2 * SCALE)
    obj = bpy.context.object
    if turned:
        obj.data.flip_normals()
    assert len(face_cameras(obj, cameras(above=True), SCALE)) == turned
    assert all(face.normal.z > 0.99 for face in obj.data.polygons)


def test_cameras_that_see_nothing() -> None:
    """No camera, and cameras elsewhere that still meet the ball: no camera tells nothing."""
    obj = ball(True)
    assert face_cameras(obj, [], SCALE) == []
