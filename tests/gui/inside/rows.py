"""What the panel says: the list's rows, reasons, buttons that are there or not."""

from __future__ import annotations

import bpy
import jobs
import robot
from robot import Steps


def panel(scene: str) -> Steps:
    """The list in a narrow sidebar; Edit Mode's reason; through a view and back; the Image Editor in UV editing."""
    yield from jobs.opened(scene, 96)
    settings = bpy.context.scene.irpso
    with robot.within():
        bpy.ops.irpso.load_captures()
    settings.active_view = 2
    yield from robot.look("list", 1.0)
    with robot.within():
        bpy.ops.object.mode_set(mode="EDIT")
    yield from robot.look("edit", 1.0)
    with robot.within():
        bpy.ops.object.mode_set(mode="OBJECT")
        bpy.ops.irpso.look_through_view("INVOKE_DEFAULT")
    yield from robot.look("through", 1.5)
    robot.tell(perspective=robot.area().spaces.active.region_3d.view_perspective)
    with robot.within():
        bpy.ops.irpso.look_back("INVOKE_DEFAULT")
    robot.tell(back=robot.area().spaces.active.region_3d.view_perspective)
    bpy.context.preferences.view.show_developer_ui = False
    bpy.context.window.workspace = bpy.data.workspaces["UV Editing"]
    yield 1.0
    windows = len(bpy.context.window_manager.windows)
    with robot.within():
        bpy.ops.irpso.show_views("INVOKE_DEFAULT")
    yield 1.0
    robot.tell(windows=len(bpy.context.window_manager.windows) - windows)
    yield from robot.look("uv", 1.0)


def browsers(scene: str) -> Steps:
    """Choosing a capture file begins beside the .blend; exporting in the panel's folder, which is made."""
    import os

    yield from jobs.opened(scene, 64)
    settings = bpy.context.scene.irpso
    settings.captures = ""
    with robot.within():
        bpy.ops.irpso.choose_captures("INVOKE_DEFAULT")
    yield 1.5
    robot.tell(captures=_browser(), home=scene)
    robot.shot("captures")
    yield 0.5
    yield from _escaped()
    settings.captures, settings.out = "//captures.json", f"{robot.FOLDER}/maps"
    settings.model, settings.method = "lambert", "draft"
    robot.invoke("irpso.solve")
    yield from robot.until(jobs.running, 10)
    yield from jobs.ended(240)
    yield from jobs.delivered()
    with robot.within():
        bpy.ops.irpso.export_maps("INVOKE_DEFAULT")
    yield 1.5
    robot.tell(export=_browser(), made=os.path.isdir(settings.out))
    yield from _escaped()
    robot.tell(left=os.path.isdir(settings.out))


def _escaped() -> Steps:
    """The file browser's window goes without a choice."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "FILE_BROWSER":
                with bpy.context.temp_override(window=window, area=area):
                    bpy.ops.file.cancel()
    yield 1.0


def _browser() -> list[str]:
    """Folder and filter of the open file browser."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "FILE_BROWSER" and area.spaces.active.params is not None:
                params = area.spaces.active.params
                return [os_path(params.directory), params.filter_glob]
    return []


def os_path(text: bytes | str) -> str:
    """A folder as text, without the last slash."""
    return (text.decode() if isinstance(text, bytes) else text).rstrip("/")


def closed(scene: str) -> Steps:
    """Its window is closed while a solve runs, which ends; another window goes on."""
    yield from jobs.opened(scene, 256)
    with robot.within():
        bpy.ops.wm.window_new()
    yield 1.0
    _first, second = bpy.context.window_manager.windows[:2]
    area = second.screen.areas[0]
    with bpy.context.temp_override(window=second, area=area, region=area.regions[-1]):
        bpy.ops.irpso.solve("INVOKE_DEFAULT")
    yield from robot.until(jobs.running, 10)
    yield 2.0
    with bpy.context.temp_override(window=second):
        bpy.ops.wm.window_close()
    yield 2.0
    robot.tell(windows=len(bpy.context.window_manager.windows), running=jobs.running() is not None)
    yield from robot.look("closed")
    with robot.within():
        robot.tell(again=bpy.ops.irpso.solve.poll())
