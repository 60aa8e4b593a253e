"""Draws over the 3D viewport where a solve has found lamps, beside where the scene has them, and marks cameras.

Only while the scene waits for Apply to Scene.  Moves are often millimetres: rings mark them, and letters name them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Vector

from ...core.change_records import LampChange
from ...core.checks.calibration_lines import place_change, power_change, sure_lamps, tint_change
from ...core.checks.camera_lines import camera_rows, sure_cameras
from ...core.data import Solution
from ..jobs.session import session
from ..scene.move_light import sun_turned
from ..scene.scene_objects import world_matrix
from . import plot
from .plot import Color, Theme

GIVEN: Color = (0.75, 0.75, 0.75, 1.0)
FOUND: Color = (1.0, 0.85, 0.2, 1.0)
DARK: Color = (0.0, 0.0, 0.0, 0.6)  # around lines: they show on any background
RING, DOT = 9.0, 3.0  # points
MOST = 50  # marks: more hide each other, and take the window's time
SUN = 0.15  # length of a sun's direction, of the viewport's distance

_handler: object = None


def draw() -> None:
    """The draw handler."""
    context = bpy.context
    obj, shown = session.subject(context), context.window_manager.irpso_views
    if obj is None or not shown.places or not context.space_data.overlay.show_overlays:
        return
    solution = session.facts_of(obj)
    if solution is None or session.calibration_state(context.scene, obj) != "open":
        return
    theme = Theme.of(context)
    for given, found, text in marks(context.scene, solution, SUN * context.region_data.view_distance):
        ends = [location_3d_to_region_2d(context.region, context.region_data, Vector(end)) for end in (given, found)]
        if all(end is not None for end in ends):
            _mark(ends, text, theme)


def marks(scene: Any, solution: Solution, sun: float) -> list[tuple[np.ndarray, np.ndarray, str]]:
    """Place as given, place as found (world, metres), and letters, of lamps and cameras that are off beyond doubt.

    At most MOST, those that were moved the farthest.  Of a sun the places are ends of its direction, ``sun`` metres
    from where it is drawn.  A camera keeps its place.
    """
    found, depsgraph = [], bpy.context.evaluated_depsgraph_get()
    for lamp in sure_lamps(solution.calibration) if solution.calibration is not None else ():
        text = ", ".join([place_change(lamp)] * lamp.sure_place + [power_change(lamp)] * lamp.sure_power
                         + [tint_change(lamp)] * lamp.sure_tint)
        found += [(*places, text) for places in _places(scene, lamp, sun, depsgraph)]
    for camera in sure_cameras(solution.cameras):
        obj = scene.objects.get(camera.camera)
        if obj is not None:
            place = world_matrix(obj, depsgraph)[:3, 3]
            found.append((place, place, camera_rows(camera)[0][1]))
    return found[:MOST]


def _places(scene: Any, lamp: LampChange, sun: float, depsgraph: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each light of a lamp that is still in the scene."""
    places = []
    for n, name in enumerate(lamp.lights):
        light, axes = scene.objects.get(name), np.eye(3)
        if lamp.cameras:
            camera = scene.objects.get(lamp.cameras[n])
            if camera is None:
                continue
            axes = world_matrix(camera, depsgraph)[:3, :3]
            axes /= np.linalg.norm(axes, axis=0)
        if light is None:
            continue
        world = world_matrix(light, depsgraph)  # hidden ones, as flashes are, have no matrix_world
        place, offset = world[:3, 3], axes @ np.array(lamp.offset)
        if lamp.sun:
            before = Vector(world[:3, 2]).normalized()
            places.append((place + sun * np.array(before), place + sun * np.array(sun_turned(before, offset))))
        else:
            places.append((place, place + offset))
    return places


def _mark(ends: Sequence[Any], text: str, theme: Theme) -> None:
    given, found = ((end.x, end.y) for end in ends)
    plot.line([given, found], DARK, 4 * theme.scale)
    plot.line([given, found], FOUND, 2 * theme.scale)
    plot.disc(given, DOT * theme.scale, GIVEN)
    around = np.linspace(0, 2 * np.pi, 33)
    ring = [(found[0] + RING * theme.scale * np.cos(a), found[1] + RING * theme.scale * np.sin(a)) for a in around]
    plot.line(ring, DARK, 3 * theme.scale)
    plot.line(ring, FOUND, 1.5 * theme.scale)
    at = found[0] + 1.5 * RING * theme.scale, found[1] + RING * theme.scale
    plot.write(text, (at[0] + 1, at[1] - 1), theme, DARK)
    plot.write(text, at, theme, FOUND)


def register() -> None:
    """Adds the handler."""
    global _handler
    _handler = bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    """Takes it back."""
    bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
