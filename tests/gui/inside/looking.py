"""The Image Editor's tab: what a solve shows of itself, the wipe, and what Undo and saving leave of it."""

from __future__ import annotations

import bpy
import jobs
import robot
from robot import Steps

EDITOR = "IMAGE_EDITOR"


def chosen() -> bpy.types.PropertyGroup:
    """What the tab shows."""
    return bpy.context.window_manager.irpso_views


def ours() -> bool:
    """Whether the editor shows ours."""
    return robot.addon("irpso_addon.blender.viewer.editors").is_ours(robot.area(EDITOR).spaces.active.image)


def place() -> tuple[int, int, int, int]:
    """Left, bottom, right, top of the picture, in pixels of the window."""
    at = robot.region("WINDOW", EDITOR)
    left, bottom = at.view2d.view_to_region(0, 0, clip=False)
    right, top = at.view2d.view_to_region(1, 1, clip=False)
    return at.x + left, at.y + bottom, at.x + right, at.y + top


def editor() -> Steps:
    """An Image Editor in the right half of the viewport, shown ours by its own button."""
    with robot.within():
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.45)
    max((area for area in robot.window().screen.areas if area.type == "VIEW_3D"), key=lambda area: area.x).type = EDITOR
    yield 0.3
    yield from robot.open_tab(of=EDITOR)
    yield from robot.press("irpso.show_views(", of=EDITOR)
    yield from robot.until(ours, 5)
    yield from robot.open_tab()  # the viewport that was split off has forgotten it


def shown(scene: str, size: int) -> Steps:
    """Live, then wiped by hand, undone, saved."""
    yield from jobs.opened(scene, size)
    yield from editor()
    yield from jobs.started()
    yield from robot.until(lambda: jobs.running() is None or jobs.running().live is not None)
    yield from robot.look("live", 0.2)
    yield from jobs.ended()
    left, bottom, right, top = place()
    robot.tell(middle=((left + right) // 2, (bottom + top) // 2), height=robot.window().height)
    yield from robot.look("base")
    chosen().show = "VIEWS"
    yield 0.5
    yield from dragged()
    yield from robot.look("wiped")
    with robot.within():
        bpy.ops.ed.undo()
    yield 0.5
    assert ours(), "Undo took the editor's picture away"
    saved = str(robot.FOLDER / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=saved, copy=True)
    with bpy.data.libraries.load(saved) as (source, _):
        robot.tell(images=list(source.images), unsaved=[i.name for i in bpy.data.images if i.is_dirty])
    yield from robot.look("undone")


def dragged() -> Steps:
    """The line, from the middle a quarter of the picture to the left."""
    left, bottom, right, top = place()
    x, y, step = (left + right) // 2, (bottom + top) // 2, (right - left) / 40
    for _ in range(2):  # the handle must have been drawn under the mouse
        robot.move(x, y)
        yield 0.2
    robot.window().event_simulate(type="LEFTMOUSE", value="PRESS", x=x, y=y)
    for i in range(11):
        yield 0.1
        robot.move(x - i * step, y)
    yield 0.1
    robot.window().event_simulate(type="LEFTMOUSE", value="RELEASE", x=int(x - 10 * step), y=y)
    yield 0.2
    robot.tell(wipe=chosen().wipe)
