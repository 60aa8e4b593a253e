"""Rigs: everything is in the picture and lit, and images called as the rig says find their views again."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from pathlib import Path, PurePath

import bpy
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from irpso_addon.core.capture.matching import match

COUNTS = {"FLASH": (20, 20, 20), "TURNTABLE": (12, 36, 36)}  # cameras, lamps, views


@pytest.fixture
def subject(extension, stage) -> bpy.types.Object:
    """A long box off the origin, turned, without the stage's own camera and light."""
    for obj in (stage.camera, stage.key):
        bpy.data.objects.remove(obj)
    bpy.data.objects.remove(stage.subject)
    bpy.ops.mesh.primitive_cube_add(size=2, location=(3, -1, 0.5), rotation=(0.2, 0.1, 0.7))
    bpy.context.object.scale = (0.01, 0.02, 0.03)
    bpy.context.view_layer.update()
    return bpy.context.object


def made() -> tuple[list[bpy.types.Object], list[bpy.types.Object]]:
    bpy.context.view_layer.update()
    objects = bpy.context.scene.objects
    return [o for o in objects if o.type == "CAMERA"], [o for o in objects if o.type == "LIGHT"]


def corners(obj: bpy.types.Object) -> list[Vector]:
    return [obj.matrix_world @ Vector(corner) for corner in obj.bound_box]


@pytest.mark.parametrize("kind", ["FLASH", "DOME", "TURNTABLE"])
def test_the_object_fills_every_picture_and_is_lit(subject, kind) -> None:
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 300, 500  # upright
    assert bpy.ops.irpso.add_rig(kind=kind) == {"FINISHED"}
    cameras, lamps = made()
    assert kind not in COUNTS or COUNTS[kind] == (len(cameras), len(lamps), len(scene.irpso.views))
    size = max((a - b).length for a in corners(subject) for b in corners(subject))
    centre = sum(corners(subject), Vector()) / 8
    for camera in cameras:
        seen = [world_to_camera_view(scene, camera, corner) for corner in corners(subject)]
        assert all(0 < p.x < 1 and 0 < p.y < 1 and camera.data.clip_start < p.z < camera.data.clip_end for p in seen)
        # The ball around it takes the shorter side, but for a tenth.
        across = world_to_camera_view(scene, camera, centre + camera.matrix_world.to_3x3().col[0] * size / 2).x - 0.5
        assert 0.43 < across < 0.5
    for view in scene.irpso.views:
        lamp, camera = view.lights[0].light, view.camera
        towards = [(o.matrix_world.translation - centre).normalized() for o in (lamp, camera)]
        assert towards[0].angle(towards[1]) < math.radians(100)
        # Power and distance: as bright as the demo's 260 W at 3.2 m.
        distance = (lamp.matrix_world.translation - centre).length
        assert lamp.data.energy / distance**2 == pytest.approx(260 / 3.2**2, rel=0.1)
    assert len({lamp.data for lamp in lamps}) == 1 and len({camera.data for camera in cameras}) == 1


def test_flashes_sit_beside_their_cameras(subject) -> None:
    bpy.ops.irpso.add_rig(kind="FLASH", cameras=9, low=0.1, high=0.9, offset=math.radians(15))
    cameras, _ = made()
    centre = sum(corners(subject), Vector()) / 8
    for view in bpy.context.scene.irpso.views:
        flash, camera = view.lights[0].light, view.camera
        assert flash.parent == camera
        from_object = [o.matrix_world.translation - centre for o in (flash, camera)]
        assert from_object[0].angle(from_object[1]) == pytest.approx(math.radians(15), abs=1e-4)
    elevations = [math.asin((c.location - centre).normalized().z) for c in cameras]
    assert min(elevations) >= 0.1 - 1e-4 and max(elevations) <= 0.9 + 1e-4
    # Evenly: in the middle of nine equal zones.
    steps = sorted(math.sin(e) for e in elevations)
    assert max(b - a for a, b in pairwise(steps)) == pytest.approx(
        (math.sin(0.9) - math.sin(0.1)) / 9, rel=1e-3)


@pytest.mark.parametrize("kind", ["FLASH", "DOME", "TURNTABLE"])
def test_images_by_these_names_find_their_views(subject, kind) -> None:
    """As "Add Folder of Images" would match them."""
    bpy.ops.irpso.add_rig(kind=kind)
    cameras, lamps = made()
    views = list(bpy.context.scene.irpso.views)
    files = [PurePath(view.image.removeprefix("//")) for view in views]
    assert len({file.name for file in files}) == len(files) and len({file.parent for file in files}) == 1
    flashes = {lamp.parent.name: [lamp.name] for lamp in lamps if lamp.parent}
    found = {m.file: m for m in match([PurePath(f.name) for f in files], [c.name for c in cameras],
                                      [lamp.name for lamp in lamps], flashes)}
    for view, file in zip(views, files, strict=True):
        entry = found[PurePath(file.name)]
        assert (entry.camera, entry.lights) == (view.camera.name, (view.lights[0].light.name,)), file
        assert not entry.camera_by_order and not entry.lights_by_order


@pytest.mark.parametrize("kind", ["FLASH", "DOME", "TURNTABLE"])
def test_a_folder_of_pictures_fills_the_views_that_wait(subject, kind, tmp_path) -> None:
    """Whatever the pictures' file type; what no view waits for is added."""
    bpy.ops.irpso.add_rig(kind=kind)
    views = bpy.context.scene.irpso.views
    waiting = [(view.image, view.camera.name, view.lights[0].light.name) for view in views]
    (tmp_path / "shots").mkdir()
    for image, _, _ in waiting[:-1]:
        (tmp_path / "shots" / Path(image).name).with_suffix(".tif").write_bytes(b"")
    (tmp_path / "shots" / "something else.tif").write_bytes(b"")
    assert bpy.ops.irpso.add_folder(directory="//shots") == {"FINISHED"}
    kept = [(view.camera.name, view.lights[0].light.name) for view in views[:len(waiting)]]
    assert kept == [was[1:] for was in waiting]
    for view, (image, _, _) in zip(views, waiting[:-1], strict=False):
        assert view.image == f"//shots/{Path(image).stem}.tif"
    assert views[len(waiting) - 1].image == waiting[-1][0]
    assert views[len(waiting)].image == "//shots/something else.tif" and views[len(waiting)].camera is None
    assert len(views) == len(waiting) + 1


def test_undo_takes_all_of_it_back(subject) -> None:
    bpy.ops.ed.undo_push(message="before")
    name, data = subject.name, (len(bpy.data.cameras), len(bpy.data.lights))
    assert bpy.ops.irpso.add_rig("EXEC_DEFAULT", True, kind="DOME") == {"FINISHED"}
    assert "Light Dome" in bpy.data.collections and bpy.context.view_layer.objects.active.name == name
    bpy.ops.ed.undo()
    assert len(bpy.data.collections) == 0 and len(bpy.context.scene.irpso.views) == 0
    assert (len(bpy.data.cameras), len(bpy.data.lights)) == data and made() == ([], [])
    # Twice: names and folders of the second do not meet those of the first.
    for _ in range(2):
        bpy.ops.irpso.add_rig(kind="DOME", lamps=3)
    views = bpy.context.scene.irpso.views
    assert len({view.image for view in views}) == len(views)


def test_what_cannot_be_says_why(subject) -> None:
    subject.scale = (0, 0, 0)
    with pytest.raises(RuntimeError, match=re.escape("Cube: has no size; a rig cannot be fitted to it")):
        bpy.ops.irpso.add_rig()
    assert not bpy.data.collections and not bpy.context.scene.irpso.views
    bpy.context.scene.irpso.captures = str(Path("captures.json"))
    assert not bpy.ops.irpso.add_rig.poll()
