"""What a solve has changed of cameras, as records, and the same change made again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..change_records import CameraChange
from ..check_records import LEAST_SHIFT, SIGMAS, Misfit
from ..data import F32, F64, Camera, SceneData
from ..projection import lens_for, pixels_of
from .mended_cameras import bent, grown, moved, name_alone, rolled

ROUNDING = 1e-9  # relative: of a focal length that comes from a matrix and from a lens
POINTS = 3000  # of the mesh, that pictures are compared at
COMMON = 2.5  # times the standard errors of checks: pictures err alike too (python -m studies.standard_errors)


def camera_changes(given: SceneData, changed: SceneData, misfits: Sequence[Misfit]) -> tuple[CameraChange, ...]:
    """Each camera of ``changed`` that differs from that of the same view of ``given``; standard errors of ``misfits``.

    Those are of ``changed``.
    """
    found = {(m.image, m.camera): m for m in misfits}
    changes: dict[str, CameraChange] = {}
    for before, after in zip(given.views, changed.views, strict=True):
        misfit = found.get((after.image, after.camera.name))
        if misfit is None or after.camera is before.camera or after.camera.name in changes:
            continue
        change = _change(before.camera, after.camera, misfit, given.mesh.positions)
        changes[after.camera.name] = change if after.camera.name == before.camera.name else replace(
            change, image=before.image)
    return tuple(changes.values())


def with_cameras(scene: SceneData, changes: Sequence[CameraChange]) -> SceneData:
    """The scene after a change that an earlier solve of it has made."""
    found = {(change.camera, change.image): change for change in changes}
    cameras: dict[str, Camera] = {}
    views = []
    for view in scene.views:
        alone = found.get((view.camera.name, view.image))
        change = alone or found.get((view.camera.name, None))
        if change is not None:
            name = view.camera.name if alone is None else name_alone(view)
            if name not in cameras:
                cameras[name] = replace(changed_camera(view.camera, change), name=name)
            view = replace(view, camera=cameras[name])
        views.append(view)
    return replace(scene, views=tuple(views))


def changed_camera(camera: Camera, change: CameraChange) -> Camera:
    """The camera after its change; the name stays."""
    after = rolled(grown(camera, change.focal - 1), change.roll)
    if change.k1:
        after = bent(after, change.k1, change.size)
    left = (_middle(camera) + change.shift - _middle(after)) * change.size
    return moved(after, (float(left[0]), float(left[1])), change.size)


def _change(before: Camera, after: Camera, misfit: Misfit, positions: F32) -> CameraChange:
    """What leads from one to the other."""
    points = positions.reshape(-1, 3).astype(np.float64)
    points = points[:: max(1, len(points) // POINTS)]
    move = pixels_of(after, points, misfit.size) - pixels_of(before, points, misfit.size)
    pixels = float(np.sqrt(np.nanmean((move**2).sum(-1))))
    focal, roll, k1 = _focal(after) / _focal(before), _roll(before, after), _k1(after) - _k1(before)
    focal = 1.0 if abs(focal - 1) < ROUNDING else focal
    shift = _middle(after) - _middle(before)
    sure = focal != 1 or roll != 0 or k1 != 0 or pixels > max(LEAST_SHIFT, SIGMAS * misfit.shift_error)
    return CameraChange(
        before.name, misfit.size, pixels, COMMON * misfit.shift_error, focal, COMMON * misfit.growth_error, roll,
        COMMON * misfit.roll_error, k1, COMMON * misfit.bend_error, (float(shift[0]), float(shift[1])), sure=sure)


def _roll(before: Camera, after: Camera) -> float:
    if np.array_equal(before.world_to_camera, after.world_to_camera):  # else rounding makes it almost 0
        return 0.0
    turn = (after.world_to_camera @ np.linalg.inv(before.world_to_camera))[:2, 0]
    return float(np.arctan2(turn[1], turn[0]))


def _focal(camera: Camera) -> float:
    """Focal length, of the picture's width; of an orthographic camera, how large it shows things."""
    return float(camera.projection[0, 0]) if camera.lens is None else 2 * camera.lens.fx / camera.lens.width


def _k1(camera: Camera) -> float:
    return 0.0 if camera.lens is None else camera.lens.radial[0]


def _middle(camera: Camera) -> F64:
    """The principal point, of the picture's width and height, from its lower left corner."""
    if camera.orthographic:
        return np.asarray((1 + camera.projection[:2, 3]) / 2)
    lens = lens_for(camera, (1, 1))
    return np.array([lens.cx, 1 - lens.cy])
