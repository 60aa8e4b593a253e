"""The scene as a solve has put it right.

Its lamps, worlds and cameras, and the exposures and turns of its list of views.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.calibration.rig import with_factors
from ...core.change_records import Calibration
from ...core.data import Solution
from ...core.errors import BadInput
from ...core.phrases import counted, some
from .change_camera import change_cameras, changeable
from .change_world import multiply_strength, strengthened, turn_views
from .move_light import (
    axes_of,
    check_place,
    check_power,
    check_size,
    moved_matrix,
    multiply_power,
    object_named,
    place,
    resize,
)


def apply_calibration(scene: Any, solution: Solution) -> str:
    """Changes the scene, and says what of it.  Raises BadInput, and changes nothing, where something cannot be."""
    cameras = changeable(scene, solution.cameras)
    alone = [change.image.name for change in solution.cameras if change.image is not None]
    if alone and not cameras and solution.calibration is None:
        raise BadInput(f"{some(alone)}: departs from the other views of its camera; give it a camera of its own, then "
                       "solve again")
    calibration = solution.calibration
    moves = _moves(scene, calibration, {change.camera: change.roll for _, change in cameras}) if calibration else {}
    changed = change_cameras(scene, cameras) if cameras else ""
    lit = _light(scene, calibration, moves) if calibration is not None else ""
    kept = f"{counted(len(alone), 'view')} left with the scene's camera" if alone else ""
    return ", ".join(filter(None, [changed, lit, kept]))


def _moves(scene: Any, calibration: Calibration, rolls: Mapping[str, float]) -> dict[Any, Any]:
    """Where lamps are to stand, object to world.  The solve moved flashes along the axes of cameras that it had turned.

    Raises BadInput where a light or world cannot be changed.
    """
    groups = [[object_named(scene, name) for name in lamp.lights] for lamp in calibration.lamps]
    for lights in groups:
        for light in lights:
            check_place(light)
            check_power(light)
    for light in _resized(scene, calibration):
        check_size(light)
    strengthened(calibration.worlds)
    places = {}
    for lamp, lights in zip(calibration.lamps, groups, strict=True):
        axes = [axes_of(scene, camera) @ _turn(rolls.get(camera, 0.0)) for camera in lamp.cameras] or [np.eye(3)]
        for light, turned in zip(lights, axes, strict=True):
            places[light] = moved_matrix(light, turned @ lamp.offset)
    return places


def _turn(roll: float) -> np.ndarray:
    """Of a camera's axes, where its pictures turn counter-clockwise."""
    cos, sin = np.cos(roll), np.sin(roll)
    return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _light(scene: Any, calibration: Calibration, places: Mapping[Any, Any]) -> str:
    """Lamps, worlds and exposures; cameras have been changed, and turned what is parented to them."""
    strengths = strengthened(calibration.worlds)
    bpy.context.view_layer.update()
    for light in sorted(places, key=_depth):
        if light.parent in places:  # which has just been moved
            bpy.context.view_layer.update()
        place(light, places[light])
    for lamp in calibration.lamps:
        multiply_power([object_named(scene, name) for name in lamp.lights], lamp.power, lamp.tint)
    if calibration.size is not None:
        resize(_resized(scene, calibration), calibration.size.extent, calibration.size.given)
    for world, factor in strengths.items():
        multiply_strength(world, factor)
    if calibration.worlds:
        brighter = f"strength of {counted(len(strengths), 'world')} changed" if strengths else ""
        return ", ".join(filter(None, [brighter, turn_views(scene, calibration.worlds)]))
    return f"{counted(len({*places, *_resized(scene, calibration)}), 'lamp')} changed{_expose(scene, calibration)}"


def _resized(scene: Any, calibration: Calibration) -> list[Any]:
    """Lights whose size is changed."""
    return [] if calibration.size is None else [object_named(scene, name) for name in calibration.size.lights]


def _expose(scene: Any, calibration: Calibration) -> str:
    """Changes what the scene's list of views has of it; says what became of that."""
    names = [name for name, found in (
        ("exposures", any(view.stops for view in calibration.exposures)), ("white balance", _tints(calibration)),
        ("vignetting", calibration.vignetting),
        ("ambient light", calibration.ambient),
        ("response", calibration.response), ("black level", calibration.black_level)) if found]
    if not names:
        return ""
    what = " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
    if scene.irpso.captures:
        return f"; the views of {bpy.path.basename(scene.irpso.captures)} keep their {what}"
    if not scene.irpso.views:
        return f"; background images have no {what} to be changed"
    return _changed(scene.irpso.views, calibration, names)


def _changed(views: Any, calibration: Calibration, names: list[str]) -> str:
    vignetting, ambient, response = calibration.vignetting, calibration.ambient, calibration.response
    black = calibration.black_level
    stops = {(view.image, view.camera): view.stops for view in calibration.exposures if view.stops}
    tints, exposed, balanced = _tints(calibration), 0, 0
    for view in views:
        key = Path(bpy.path.abspath(view.image)), view.camera.name if view.camera is not None else ""
        if key in stops:
            view.exposure += stops[key]
            exposed += 1
        if key in tints:
            view.tint = with_factors(view.tint, tints[key])
            balanced += 1
        if vignetting is not None:
            view.vignetting += vignetting.power
        if ambient is not None and not view.ambient:
            view.ambient_radiance = tuple(map(sum, zip(view.ambient_radiance, ambient.radiance, strict=True)))
        if response is not None:
            view.response *= response.exponent
            view.shoulder *= response.shoulder
        if black is not None and not view.ambient:
            view.black_level = tuple(map(sum, zip(view.black_level, black.level, strict=True)))
    changed = f", {counted(exposed, 'exposure')} changed" if stops else ""
    changed += f", white balance of {counted(balanced, 'view')} changed" if tints else ""
    shared = " and ".join(name for name in names if name not in ("exposures", "white balance"))
    return changed + (f", {shared} of {counted(len(views), 'view')} changed" if shared else "")


def _tints(calibration: Calibration) -> dict[tuple[Path, str], tuple[float, float, float]]:
    """Of the views whose white balance is to be changed, by picture and camera."""
    return {(view.image, view.camera): view.tint for view in calibration.exposures if view.tint != (1.0, 1.0, 1.0)}


def _depth(obj: Any) -> int:
    """How many parents are above it."""
    return 0 if obj.parent is None else 1 + _depth(obj.parent)
