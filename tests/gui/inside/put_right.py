"""Lamps that a solve has put right, given to the scene by the panel's button."""

from __future__ import annotations

import bpy
import jobs
import numpy as np
import robot
from robot import Steps


def lamps() -> dict[str, list[float]]:
    """Place and power of each, by name: undo leaves no reference to an object that holds."""
    return {obj.name: [*obj.location, obj.data.energy] for obj in bpy.context.scene.objects if obj.type == "LIGHT"}


def state() -> str:
    """Whether the scene has what the solve put right."""
    return jobs.session().calibration_state(bpy.context.scene, jobs.subject())


def keep_result() -> None:
    """A result of the ball that has moved all lamps and changed two exposures."""
    data = robot.addon("irpso_addon.core.data")
    grey, none = np.full((4, 4), 0.5, np.float32), np.zeros((4, 4), bool)
    maps = data.Maps(np.full((4, 4, 3), 0.5, np.float32), grey, grey, grey, none, ~none, grey, grey)
    changes = tuple(
        data.LampChange((name,), (0.01 * n + 0.02, 0.0, 0.03), 0.002, 0.01 + 0.001 * n, 0.9 + 0.03 * n, 0.003)
        for n, name in enumerate(lamps()))
    folder = robot.FOLDER  # of no picture: the views are those of captures.json
    views = tuple(data.ExposureChange(folder / f"Camera {n}, Light 0.exr", f"Camera {n}", 0.03 * n - 0.02, 0.005)
                  for n in range(2))
    texels = {"covered": 16, "observed": 16, "solved": 16, "filled": 0}
    solution = data.Solution(
        maps, {"Paint": "one-lobe"}, {}, texels, {}, 0.0, (), (), (), {}, calibration=data.Calibration(
            changes, views, data.PredictionError(0.043, 2.0), data.PredictionError(0.038, 1.8)))
    jobs.session().keep(jobs.subject(), solution)


def applied(scene: str, size: int) -> Steps:
    """Keep a lamp and undo it; apply, undo, apply again."""
    yield from jobs.opened(scene, size)
    keep_result()
    given = lamps()
    assert state() == "open"
    for of in ("irpso.load_captures(", "irpso.solve("):  # panels above are closed, to make room
        x, y = yield from robot.find(of)
        yield from robot.key("A", x, y)
        yield 0.5
    spot = yield from robot.find("irpso.apply_calibration(")
    yield from robot.look("offered")
    kept = yield from robot.find("irpso_keep")  # of the lamp that was moved the farthest
    yield from robot.click(*kept)
    yield from robot.until(lambda: bpy.data.objects["Light 4"].irpso_keep, 5)
    yield from robot.key("Z", ctrl=True)
    yield from robot.until(lambda: not bpy.data.objects["Light 4"].irpso_keep, 5)
    yield from robot.click(*spot)
    yield from robot.until(lambda: state() == "applied", 5)
    after = lamps()
    assert all(after[name] != given[name] for name in given)
    yield from robot.look("applied")
    yield from robot.key("Z", ctrl=True)
    yield from robot.until(lambda: state() == "open", 5)
    assert lamps() == given
    yield from robot.press("irpso.apply_calibration(")
    yield from robot.until(lambda: state() == "applied", 5)
    assert lamps() == after
