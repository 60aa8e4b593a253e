"""The scene as a solve has put it right: its lamps, and the exposures of its list of views."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.data import Calibration
from ...core.phrases import counted
from .move_light import axes_of, check_place, check_power, light_named, moved_matrix, multiply_power, place


def apply_calibration(scene: Any, calibration: Calibration) -> str:
    """Changes the scene, and says what of it.  Raises BadInput, and changes nothing, where a lamp cannot be changed."""
    groups = [[light_named(scene, name) for name in lamp.lights] for lamp in calibration.lamps]
    for lights in groups:
        for light in lights:
            check_place(light)
            check_power(light)
    places = {}
    for lamp, lights in zip(calibration.lamps, groups, strict=True):
        axes = [axes_of(scene, camera) for camera in lamp.cameras] or [np.eye(3)]
        for light, turned in zip(lights, axes, strict=True):
            places[light] = moved_matrix(light, turned @ lamp.offset)
    for light in sorted(places, key=_depth):
        if light.parent in places:  # which has just been moved
            bpy.context.view_layer.update()
        place(light, places[light])
    for lamp, lights in zip(calibration.lamps, groups, strict=True):
        multiply_power(lights, lamp.power)
    return f"{counted(len(places), 'lamp')} changed{_expose(scene, calibration)}"


def _expose(scene: Any, calibration: Calibration) -> str:
    """Changes exposures and vignetting of the scene's list of views; says what became of them."""
    vignetting = calibration.vignetting
    if not calibration.exposures and vignetting is None:
        return ""
    what = "exposures" if vignetting is None else "exposures and vignetting" if calibration.exposures else "vignetting"
    if scene.irpso.captures:
        return f"; the views of {bpy.path.basename(scene.irpso.captures)} keep their {what}"
    if not scene.irpso.views:
        return f"; background images have no {what} to be changed"
    stops = {(view.image, view.camera): view.stops for view in calibration.exposures}
    count = 0
    for view in scene.irpso.views:
        key = Path(bpy.path.abspath(view.image)), view.camera.name if view.camera is not None else ""
        if key in stops:
            view.exposure += stops[key]
            count += 1
        if vignetting is not None:
            view.vignetting += vignetting.power
    changed = f", {counted(count, 'exposure')} changed" if calibration.exposures else ""
    return changed + (f", vignetting of {counted(len(scene.irpso.views), 'view')} changed" if vignetting else "")


def _depth(obj: Any) -> int:
    """How many parents are above it."""
    return 0 if obj.parent is None else 1 + _depth(obj.parent)
