"""What people do while a job runs."""

from __future__ import annotations

import os
import signal

import bpy
import jobs
import robot
from robot import Steps


def load(scene: str, size: int) -> Steps:
    """Open the file anew: the job is gone, the file is as it lies on the disk, and can be solved."""
    yield from jobs.opened(scene, size)
    yield from jobs.started()
    yield from jobs.far_enough()
    bpy.ops.wm.open_mainfile(filepath=f"{scene}/scene.blend")
    yield 0.5
    assert jobs.running() is None and jobs.solution() is None
    assert not jobs.linked(bpy.data.objects["Ball"]), "the old job wrote into the new file"
    yield from jobs.opened(scene, 64)
    yield from jobs.started()
    yield from jobs.ended()
    yield from jobs.delivered()
    yield from robot.look("loaded")


def moved_and_back(scene: str, size: int) -> Steps:
    """Two steps of undo, and a solve that shows maps: after one undo the object is 0.5 m aside."""
    yield from jobs.opened(scene, size)
    obj = jobs.subject()
    obj.location.x += 0.5
    with robot.within():
        bpy.ops.ed.undo_push(message="Moved")
    obj.location.x -= 0.5  # where the pictures say it is
    with robot.within():
        bpy.ops.ed.undo_push(message="Moved back")
    yield from jobs.started()
    yield from jobs.far_enough()


def redo(scene: str, size: int) -> Steps:
    """One Undo takes back what was done last, and the maps; one Redo brings both again, however often."""
    yield from moved_and_back(scene, size)
    told = []
    for presses in (1, 2, 1):
        yield from robot.until(lambda: jobs.linked(jobs.subject()), 5)
        for key in ({}, {"shift": True}):
            for _ in range(presses):
                yield from robot.key("Z", ctrl=True, **key)
                yield 0.5
            told.append((jobs.subject().location.x, len(jobs.linked(jobs.subject()))))
    assert jobs.running() is not None, "it was over too early"
    robot.tell(states=told)
    yield from robot.key("ESC")
    yield from jobs.ended()
    yield from jobs.delivered()


def undo(scene: str, size: int) -> Steps:
    """Move the object, start, undo the move: the job goes on and its maps arrive; undo takes them off again."""
    yield from moved_and_back(scene, size)
    presses = 0
    while jobs.subject().location.x != 0.5:  # maps that are on show are a step of their own
        assert presses < 6, "Ctrl Z does nothing"
        yield from robot.key("Z", ctrl=True)
        yield 0.3
        presses += 1
    assert jobs.running() is not None, "undo ended the job"
    yield 1  # more looks arrive
    yield from robot.look("undone")
    for _ in range(presses):
        yield from robot.key("Z", ctrl=True, shift=True)
        yield 0.3
    yield from jobs.ended()
    yield from robot.look("ended")
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    yield from jobs.delivered()


def delete(scene: str, size: int) -> Steps:
    """Delete the object: the job ends and says so; Ctrl Z brings the object back as it was."""
    yield from jobs.opened(scene, size)
    yield from jobs.started()
    yield from jobs.far_enough()
    yield from robot.key("DEL")
    yield 0.3
    assert "Ball" not in bpy.context.scene.objects
    robot.tell(seconds=(yield from jobs.ended()))
    yield from robot.look("deleted")
    yield from robot.key("Z", ctrl=True)
    yield 0.5
    assert "Ball" in bpy.context.scene.objects


def render(scene: str, size: int) -> Steps:
    """Render an image: both end."""
    yield from jobs.opened(scene, size)
    done: list[object] = []
    bpy.app.handlers.render_complete.append(lambda *_: done.append(1))
    yield from jobs.started()
    yield from jobs.far_enough()
    yield from robot.key("F12")
    yield from robot.until(lambda: done)
    yield from robot.look("rendered")
    yield from jobs.ended()
    yield from jobs.delivered()
    assert not jobs.solution().cancelled


def no_opengl(scene: str, size: int) -> Steps:
    """The worker finds no OpenGL: the panel offers numpy, which then does it."""
    os.environ["__EGL_VENDOR_LIBRARY_FILENAMES"] = os.devnull  # Blender has its own context already
    yield from jobs.opened(scene, min(size, 32))
    robot.addon("irpso_addon.blender.jobs.jobs").cool_down()  # whose worker had been started before
    yield from jobs.started()
    yield from jobs.ended()
    assert jobs.solution() is None and jobs.session().device_trouble
    yield 0.5
    yield from robot.look("offered")
    yield from robot.key("ESC")  # the report lies over the button
    yield 0.5
    robot.addon("irpso_addon.blender.preferences")._chosen().device = "numpy"
    yield from jobs.started()
    yield from jobs.ended()
    yield from jobs.delivered()
    assert jobs.solution().device["renderer"].startswith("numpy")
    yield from robot.look("by_numpy")


def reported(scene: str, size: int) -> Steps:
    """The worker dies in the middle; then no view shows the object.  Tells the lines of the Info editor."""
    yield from jobs.opened(scene, size)
    bpy.context.scene.irpso.model = "one-lobe"
    yield from jobs.started(20)
    yield from jobs.far_enough()
    os.kill(jobs.running().job.worker._process.pid, signal.SIGKILL)
    yield from jobs.ended()
    yield from jobs.delivered()
    yield 1.0
    killed = yield from _lines()
    robot.tell(killed=killed)
    yield from robot.look("killed")
    yield from robot.key("ESC")  # the report lies over the button
    yield 0.5
    jobs.subject().location.x = 50.0
    yield from jobs.started(20)
    yield from jobs.ended(120)
    yield 1.0
    robot.tell(unseen=(yield from _lines())[len(killed):])


def _lines() -> Steps:
    """What the Info editor shows but calls of operators."""
    area = next(area for area in robot.window().screen.areas if area.type in ("DOPESHEET_EDITOR", "INFO"))
    area.type = "INFO"
    yield 0.5
    with robot.within("INFO"):
        bpy.ops.info.select_all(action="SELECT")
        bpy.ops.info.report_copy()
    lines = bpy.context.window_manager.clipboard.splitlines()
    return [line for line in lines if line and not line.startswith("bpy.")]


def close(scene: str, size: int) -> Steps:
    """Quit by the keyboard while it runs.  What ends the scenario is that Blender is gone."""
    yield from jobs.opened(scene, size)
    bpy.context.preferences.view.use_save_prompt = False
    yield from jobs.started()
    yield from jobs.far_enough()
    robot.tell(running=True)
    robot.write(True)
    yield from robot.key("Q", ctrl=True)
    yield 20
    raise AssertionError("Blender is still there")
