"""What a user is told of each camera that a solve put right."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..change_records import CameraChange
from ..check_records import LEAST_SHIFT
from ..phrases import percent, some


def sure_cameras(cameras: Sequence[CameraChange]) -> list[CameraChange]:
    """Cameras that are off beyond doubt, those whose pictures moved the farthest first."""
    return sorted((camera for camera in cameras if camera.sure), key=lambda camera: -camera.pixels)


def corrected_cameras(cameras: Sequence[CameraChange]) -> tuple[str, ...]:
    """A line for each way in which cameras were off beyond doubt."""
    off = sure_cameras(cameras)
    shifted = [camera for camera in off if camera.pixels > LEAST_SHIFT]
    lines = [f"{_names(shifted)}: {shifted[0].pixels:.2f} pixels off (in '{_name(shifted[0])}')"] if shifted else []
    if zoomed := [camera for camera in off if camera.focal != 1]:
        worst = max(zoomed, key=lambda camera: abs(math.log(camera.focal)))
        lines.append(f"{_names(zoomed)}: focal length off (by {percent(worst.focal - 1, 2, sign=True)} in "
                     f"'{_name(worst)}')")
    if turned := [camera for camera in off if camera.roll]:
        worst = max(turned, key=lambda camera: abs(camera.roll))
        lines.append(f"{_names(turned)}: turned about the viewing axis (by {math.degrees(worst.roll):+.2f} degrees in "
                     f"'{_name(worst)}')")
    if bent := [camera for camera in off if camera.k1]:
        worst = max(bent, key=lambda camera: abs(camera.k1))
        lines.append(f"{_names(bent)}: lens distortion missing (radial term k1 {worst.k1:+.3f})")
    return tuple(f"{line}; corrected" for line in lines)


def _name(camera: CameraChange) -> str:
    """The camera's, or that of its one view that departs."""
    return camera.camera if camera.image is None else camera.image.name


def _names(cameras: Sequence[CameraChange]) -> str:
    return some(sorted({_name(camera) for camera in cameras}))


def camera_rows(camera: CameraChange) -> list[tuple[str, str]]:
    """Name and figures: by how much its pictures moved, and what else of it changed."""
    name = camera.camera if camera.image is None else f"{camera.camera}: {camera.image.name}"
    rows = [(name, f"{camera.pixels:.2f} ± {camera.error:.2f} px")]
    if camera.focal != 1:
        rows.append(("Focal Length", f"{percent(camera.focal - 1, 2, sign=True)} ± {percent(camera.focal_error, 2)}"))
    if camera.roll:
        rows.append(("Roll", f"{math.degrees(camera.roll):+.2f} ± {math.degrees(camera.roll_error):.2f}°"))
    if camera.k1:
        rows.append(("Lens k1", f"{camera.k1:+.3f} ± {camera.k1_error:.3f}"))
    return rows
