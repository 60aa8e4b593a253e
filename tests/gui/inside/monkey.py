"""Presses what nobody would press, at moments that a seed chooses, while jobs run."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import bpy
import jobs
import robot
from robot import Steps

LONGEST = 2.5  # seconds between two actions
STOPPED = 10.0  # seconds in which a job that was told to stop must be gone


def play(scene: str, size: int, seed: int, runs: int) -> Steps:
    """``runs`` times: start a solve, do one to three things to it, see that nothing is lost; then quit, or meanwhile.

    Tells how often each thing was done.
    """
    chance, counts = random.Random(seed), {}
    file = Path(f"{scene}/scene.blend")
    before = file.read_bytes()
    yield from jobs.opened(scene, size)
    for run in range(runs):
        if "Ball" not in bpy.context.scene.objects:
            yield from jobs.opened(scene, size)
        bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
        bpy.context.scene.irpso.captures, bpy.context.scene.irpso.indirect = "//captures.json", "off"
        bpy.context.scene.irpso.size = chance.choice([32, size // 2, size])
        start()
        for _ in range(chance.randint(1, 3)):
            yield chance.uniform(0, LONGEST)
            action = chance.choice(ACTIONS)
            counts[action.__name__] = counts.get(action.__name__, 0) + 1
            robot.say("run", run, action.__name__, jobs.running() and jobs.running().progress)
            yield from action(scene, size) or ()
        if run == runs - 1 and chance.random() < 0.5:
            counts["quit"] = 1
            break
        jobs.session().cancel_running()
        yield from jobs.ended(STOPPED)
        assert file.read_bytes() == before, "the file on the disk was written"
        ball = bpy.data.objects.get("Ball")
        assert ball is None or len(ball.data.vertices) == 1106, "the mesh was changed"
    robot.tell(counts=counts)


def start(*_: object) -> None:
    """As a click on Solve does; refused while another job runs."""
    with robot.within():
        if bpy.ops.irpso.solve.poll():
            try:
                bpy.ops.irpso.solve("INVOKE_DEFAULT")
            except RuntimeError as told:  # an error that a user would read in the status bar
                robot.say(told)


def escape(*_: object) -> Steps:
    """The key."""
    yield from robot.key("ESC")


def stop(*_: object) -> None:
    """The panel's button."""
    with robot.within():
        if bpy.ops.irpso.stop.poll():
            bpy.ops.irpso.stop("INVOKE_DEFAULT")


def undo(*_: object) -> Steps:
    """Once or twice."""
    yield from robot.key("Z", ctrl=True)
    yield from robot.key("Z", ctrl=True)


def redo(*_: object) -> Steps:
    """Once."""
    yield from robot.key("Z", ctrl=True, shift=True)


def reload(scene: str, size: int) -> Steps:
    """The file from the disk, with its window or without."""
    bpy.ops.wm.open_mainfile(filepath=f"{scene}/scene.blend", load_ui=False)
    yield 0.1
    bpy.context.scene.irpso.captures, bpy.context.scene.irpso.size = "//captures.json", size


def new(*_: object) -> None:
    """Another file altogether."""
    bpy.ops.wm.read_homefile(load_ui=False)


def delete(*_: object) -> Steps:
    """The active object."""
    yield from robot.key("DEL")


def edit(*_: object) -> Steps:
    """Into Edit Mode and out."""
    yield from robot.key("TAB")
    yield 0.2
    yield from robot.key("TAB")


def material_view(*_: object) -> None:
    """Another way of drawing the viewport, there and back."""
    shading = robot.area().spaces.active.shading
    shading.type = "SOLID" if shading.type == "MATERIAL" else "MATERIAL"


def drop_images(*_: object) -> None:
    """Every image of the file, the solve's own too."""
    for image in list(bpy.data.images):
        bpy.data.images.remove(image)


def drop_material(*_: object) -> None:
    """The object's material."""
    for material in list(bpy.data.materials):
        bpy.data.materials.remove(material)


ACTIONS: list[Callable[..., Steps | None]] = [
    start, escape, stop, stop, undo, undo, redo, reload, reload, new, delete, edit, material_view, drop_images,
    drop_material]
