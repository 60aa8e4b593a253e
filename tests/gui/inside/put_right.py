"""Lamps and a camera that a solve has put right, given to the scene by the panel's button."""

from __future__ import annotations

import bpy
import jobs
import numpy as np
import robot
from robot import Steps


def lamps() -> dict[str, list[float]]:
    """Place, power and color of each, by name: undo leaves no reference to an object that holds."""
    return {obj.name: [*obj.location, obj.data.energy, *obj.data.color]
            for obj in bpy.context.scene.objects if obj.type == "LIGHT"}


def camera() -> list[float]:
    """Turn and lens of the one that was put right."""
    obj = bpy.data.objects["Camera 1"]
    return [*obj.rotation_euler, obj.data.lens, obj.data.shift_x, float(obj.data.irpso_lens.use)]


def state() -> str:
    """Whether the scene has what the solve put right."""
    return jobs.session().calibration_state(bpy.context.scene, jobs.subject())


def keep_result() -> None:
    """A result of the ball that has moved all lamps, given them another color, changed two exposures and a camera."""
    data, changes = robot.addon("irpso_addon.core.data"), robot.addon("irpso_addon.core.change_records")
    grey, none = np.full((4, 4), 0.5, np.float32), np.zeros((4, 4), bool)
    maps = data.Maps(np.full((4, 4, 3), 0.5, np.float32), grey, grey, grey, none, ~none, grey, grey)
    moved = tuple(
        changes.LampChange((name,), (0.01 * n + 0.02, 0.0, 0.03), (0.002,) * 3, 0.01 + 0.001 * n, 0.9 + 0.03 * n, 0.003,
                           tint=(1.104, 1.01, 0.897), tint_error=0.002, sure_tint=True)
        for n, name in enumerate(lamps()))
    folder = robot.FOLDER  # of no picture: the views are those of captures.json
    views = tuple(changes.ExposureChange(folder / f"Camera {n}, Light 0.exr", f"Camera {n}", 0.03 * n - 0.02, 0.005)
                  for n in range(2))
    texels = {"covered": 16, "observed": 16, "solved": 16, "filled": 0}
    solution = data.Solution(
        maps, {"Paint": "one-lobe"}, {}, texels, {}, 0.0, (), (), (), {}, calibration=changes.Calibration(
            moved, views, changes.PredictionError(0.043, 2.0), changes.PredictionError(0.038, 1.8)), cameras=(
                changes.CameraChange("Camera 1", (96, 64), 1.84, 0.05, 1.003, 0.0002, 0.0017, 0.0002, -0.1, 0.003,
                                     (0.01, -0.02)),))
    jobs.session().keep(jobs.subject(), solution)


def applied(scene: str, size: int) -> Steps:
    """Keep a lamp and undo it; apply, undo, apply again."""
    yield from jobs.opened(scene, size)
    keep_result()
    given, seen = lamps(), camera()
    assert state() == "open"
    for of in ("irpso.load_captures(", "irpso.solve("):  # panels above are closed, to make room
        x, y = yield from robot.find(of)
        yield from robot.key("A", x, y)
        yield 0.5
    spot = yield from robot.find("irpso.apply_calibration(")
    yield from robot.look("offered")
    kept = yield from robot.find("irpso_keep")  # of the camera
    yield from robot.click(*kept)
    yield from robot.until(lambda: bpy.data.objects["Camera 1"].irpso_keep, 5)
    yield from robot.key("Z", ctrl=True)
    yield from robot.until(lambda: not bpy.data.objects["Camera 1"].irpso_keep, 5)
    viewport = next(area for area in bpy.context.window.screen.areas if area.type == "VIEW_3D")
    viewport.spaces[0].region_3d.view_distance = 14  # lamps and cameras are in sight
    yield from robot.look("places")
    yield from robot.press("irpso_views.places")
    yield from robot.until(lambda: not bpy.context.window_manager.irpso_views.places, 5)
    yield from robot.look("without_places")
    yield from robot.press("irpso_views.places")
    spot = yield from robot.find("irpso.apply_calibration(")
    yield from robot.click(*spot)
    yield from robot.until(lambda: state() == "applied", 5)
    after = lamps()
    assert all(after[name] != given[name] for name in given)
    assert camera() != seen and camera()[-1] == 1
    yield from robot.look("applied")
    yield from robot.key("Z", ctrl=True)
    yield from robot.until(lambda: state() == "open", 5)
    assert lamps() == given and camera() == seen
    yield from robot.press("irpso.apply_calibration(")
    yield from robot.until(lambda: state() == "applied", 5)
    assert lamps() == after
