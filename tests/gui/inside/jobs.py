"""Solving by the panel's buttons, and stopping it."""

from __future__ import annotations

import time

import bpy
import robot
from robot import Steps


def opened(scene: str, size: int) -> Steps:
    """A scene with its object in sight and active, and the tab open."""
    bpy.ops.wm.open_mainfile(filepath=f"{scene}/scene.blend", load_ui=False)
    yield 0.5
    settings = bpy.context.scene.irpso
    settings.captures, settings.size = "//captures.json", size
    obj = next(o for o in bpy.context.scene.objects if o.type == "MESH")
    bpy.context.view_layer.objects.active = obj
    with robot.within():
        bpy.ops.object.select_all(action="DESELECT")
        obj.select_set(True)
        bpy.ops.view3d.view_selected()
    yield from robot.open_tab()


def running() -> object:
    """The session's running job."""
    return robot.addon("irpso_addon.blender.session").running


def started() -> Steps:
    """Press Solve."""
    yield from robot.press("irpso.solve(")
    yield from robot.until(running, 5)


def ended() -> Steps:
    """Wait for the end; returns the seconds it took from here."""
    began = time.monotonic()
    yield from robot.until(lambda: running() is None)
    return time.monotonic() - began


def solution() -> object:
    """The last one of the active object."""
    return robot.addon("irpso_addon.blender.session").solution_of(bpy.context.view_layer.objects.active)


def whole(scene: str, size: int) -> Steps:
    """From the panel to maps on the material and files."""
    yield from opened(scene, size)
    yield from robot.look("panel")
    yield from started()
    robot.tell(seconds=(yield from ended()))
    yield from robot.look("solved", 3)
    assert solution() is not None
    robot.tell(maps={role: value for role, value in solution().texels.items()})
