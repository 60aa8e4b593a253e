"""A new user: the sample scene and its maps in three clicks."""

from __future__ import annotations

import time

import bpy
import jobs
import robot
from robot import Steps


def open_by_clicks() -> Steps:
    """N, a click on the tab, a click on Sample Scene; until it is laid out."""
    yield 1
    yield from robot.key("N")
    yield 0.5
    sidebar = robot.region("UI")
    tabs = sidebar.x + sidebar.width - 12
    for y in range(sidebar.y + sidebar.height - 30, sidebar.y, -25):  # where is it?  A person sees that
        if sidebar.active_panel_category == "IRPSO":
            break
        yield from robot.click(tabs, y)
    assert sidebar.active_panel_category == "IRPSO"
    yield from robot.look("empty")
    spot = yield from robot.find("irpso.sample_scene(")
    yield from robot.click(*spot)
    yield 1
    robot.shot("making")
    yield from robot.until(laid_out)


def laid_out() -> bool:
    """The scene is open, its object active, our tab in sight, an Image Editor beside."""
    kinds = {area.type for area in robot.window().screen.areas}
    return (bpy.data.filepath != "" and jobs.subject() is not None and {"VIEW_3D", "IMAGE_EDITOR"} <= kinds
            and robot.region("UI").active_panel_category == "IRPSO")


def three_clicks() -> Steps:
    """From a new file to maps."""
    yield from open_by_clicks()
    yield from robot.look("opened")
    spot = yield from robot.find("irpso.solve(")
    yield from robot.click(*spot)
    yield from robot.until(jobs.running, 5)
    yield 2
    robot.shot("running")
    yield from jobs.ended(120)
    yield from jobs.delivered()
    yield from robot.look("solved", 2)
    solution = jobs.solution()
    robot.tell(texels=dict(solution.texels), warnings=list(solution.warnings), views=len(solution.views_used))


def timed() -> Steps:
    """The same without the clicks; tells the seconds."""
    yield 1
    yield from robot.open_tab()
    began = time.monotonic()
    robot.invoke("irpso.sample_scene")
    yield from robot.until(laid_out)
    opened = time.monotonic()
    robot.invoke("irpso.solve")
    yield from jobs.ended(120)
    yield from jobs.delivered()
    robot.tell(opening=opened - began, solving=time.monotonic() - opened)
    yield from robot.look("timed", 2)
