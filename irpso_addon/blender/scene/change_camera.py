"""Cameras of the scene, put right as a solve has found them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
from mathutils import Matrix, Quaternion

from ...core.change_records import CameraChange
from ...core.checks.camera_changes import changed_camera
from ...core.errors import BadInput
from ...core.phrases import counted
from .camera_lens import write_lens
from .move_light import check_place, object_named
from .scene_objects import animated, read_camera

OPTICS = "lens", "shift", "ortho_scale", "sensor", "irpso_lens"  # starts of animated paths


def changeable(scene: Any, changes: Sequence[CameraChange]) -> list[tuple[Any, CameraChange]]:
    """The cameras, and what becomes of each; not of single views, which have no camera of their own.

    Raises BadInput where one cannot be changed.
    """
    found = [(object_named(scene, change.camera, "CAMERA"), change) for change in changes if change.image is None]
    for obj, change in found:
        if change.roll:
            check_place(obj)
        if animated(obj.data, OPTICS):
            raise BadInput(f"camera '{obj.name}': keyframes or a driver set its lens; remove them, then try again")
    return found


def change_cameras(scene: Any, changes: Sequence[tuple[Any, CameraChange]]) -> str:
    """Changes what `changeable` gave; says what of it."""
    lenses = [_lens_after(scene, obj, change) for obj, change in changes]  # before anything that they read is changed
    for (obj, change), lens in zip(changes, lenses, strict=True):
        if obj.data.library is not None or obj.data.users - obj.data.use_fake_user > 1:  # others keep theirs
            obj.data = obj.data.copy()
        if lens is not None:
            write_lens(obj.data, lens)
        else:
            _zoom(obj.data, change.focal)
            _shift(obj.data, change.shift, scene.render)
        if change.roll:
            _roll(obj, change.roll)
    return f"{counted(len(changes), 'camera')} changed"


def _lens_after(scene: Any, obj: Any, change: CameraChange) -> Any:
    """The lens after the change; None: Blender's own settings hold."""
    if not (change.k1 or obj.data.irpso_lens.use):
        return None
    return changed_camera(read_camera(obj, scene, bpy.context.evaluated_depsgraph_get()), change).lens


def _zoom(data: Any, by: float) -> None:
    if data.type == "ORTHO":
        data.ortho_scale /= by
    else:
        data.lens *= by


def _shift(data: Any, by: tuple[float, float], render: Any) -> None:
    """Moves pictures by parts of their width and height; Blender's unit is the side that the sensor is fitted to."""
    width, height = render.resolution_x * render.pixel_aspect_x, render.resolution_y * render.pixel_aspect_y
    across = width >= height if data.sensor_fit == "AUTO" else data.sensor_fit == "HORIZONTAL"
    side = width if across else height
    data.shift_x -= by[0] * width / side
    data.shift_y -= by[1] * height / side


def _roll(obj: Any, angle: float) -> None:
    """Turns pictures counter-clockwise: the camera clockwise about its axis.  A flash that it carries turns with it."""
    location, scale = obj.location.copy(), obj.scale.copy()
    place, rotation, size = obj.matrix_basis.decompose()
    obj.matrix_basis = Matrix.LocRotScale(place, rotation @ Quaternion((0.0, 0.0, 1.0), -angle), size)
    obj.location, obj.scale = location, scale  # to the bit
