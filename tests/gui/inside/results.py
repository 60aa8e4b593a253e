"""What a user sees of results: the next day, from A to B and back, and of where they come from."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
import jobs
import robot
from robot import Steps

LONG = 240.0  # seconds that a solve may take beside others


def solved(model: str) -> Steps:
    """Press Solve and wait for the result on the material; returns the fractions and seconds left that were told."""
    bpy.context.scene.irpso.model = model
    count = len(jobs.session().results_of(jobs.subject()))
    yield from jobs.started(10)
    told = []
    began = time.monotonic()
    while jobs.running() is not None:
        assert time.monotonic() - began < LONG, "too long"
        told.append((jobs.running().time.fraction, jobs.running().time.left))
        yield 0.1
    yield from robot.until(lambda: len(jobs.session().results_of(jobs.subject())) > count, 10)
    yield 0.5
    return told


def label() -> str:
    """Of the last result."""
    return jobs.session().results_of(jobs.subject())[-1].label


def texels_of(name: str) -> list[float]:
    """Some pixels of an image."""
    return list(bpy.data.images[name].pixels[0:4000:7])


def tomorrow(scene: str, size: int) -> Steps:
    """Solve, save, open: the panel has the report; then another solve, and back by a click; a camera is selected."""
    yield from jobs.opened(scene, size)
    first = yield from solved("lambert")
    before = texels_of("Ball_basecolor")
    yield from robot.look("today")
    path = str(Path(robot.FOLDER) / "tomorrow.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)
    here = label()
    bpy.ops.wm.open_mainfile(filepath=path, load_ui=False)
    yield 1.0
    settings = bpy.context.scene.irpso
    settings.captures = str(Path(scene) / "captures.json")
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    yield from robot.open_tab()
    assert label() == here
    yield from robot.look("tomorrow")
    again = yield from solved("one-lobe")
    robot.tell(changed=texels_of("Ball_basecolor") != before)
    bpy.context.view_layer.objects.active = bpy.data.objects["Camera 1"]
    yield from robot.look("camera")
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    robot.area().regions[0].tag_redraw()
    yield 0.5
    with robot.within():
        bpy.ops.irpso.restore_result("INVOKE_DEFAULT", index=0)
    yield 0.5
    robot.tell(back=texels_of("Ball_basecolor") == before, label=label(), told=[first, again])
    yield from robot.look("back")


def shadings(scene: str, size: int, shading: str, color: str) -> Steps:
    """During a solve the viewport goes on as the Image Editor does: pictures of it, half way and at the end.

    The solve rests for the first picture: on a slow machine it would else be nearly over before that is taken.  And it
    takes long, so that the preview comes before its own base colors where other programs run.
    """
    yield from jobs.opened(scene, size)
    view = robot.area().spaces.active
    view.shading.type, view.shading.color_type = shading, color
    bpy.context.scene.irpso.model, bpy.context.scene.irpso.method = "one-lobe", "swarm"
    yield 1.0
    yield from robot.look("before")
    yield from jobs.started(10)
    yield from robot.until(lambda: jobs.running() is None or jobs.linked(jobs.subject()), LONG)
    assert jobs.running(), "it was over before maps were on show"
    robot.invoke("irpso.pause")
    yield from robot.look("first", 1.0)
    robot.invoke("irpso.pause")
    yield from robot.until(lambda: jobs.running() is None or jobs.running().progress.stage == "maps", LONG)
    yield from robot.look("late", 0.5)
    yield from jobs.ended(LONG)
    yield from jobs.delivered()
    yield from robot.look("end", 1.5)


def memory(scene: str, size: int, solves: int, shading: str = "SOLID") -> Steps:
    """Several solves one after another; what Blender holds after each, in GB."""
    yield from jobs.opened(scene, size, shading)
    settings = bpy.context.scene.irpso
    settings.model, settings.method = "one-lobe", "draft"
    held = []
    for number in range(solves):
        robot.invoke("irpso.solve")
        yield from robot.until(jobs.running, 10)
        yield from jobs.ended(LONG)
        yield 1.5
        held.append(_resident())
        robot.say(number, held[-1], len(bpy.data.images), len(jobs.session().results_of(jobs.subject())))
    robot.tell(held=held)


def _resident() -> float:
    """GB of this process."""
    with open("/proc/self/status", encoding="ascii") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmRSS")) / 1e6


def copying(scene: str) -> Steps:
    """Saving the copy for a second Blender, beside saving one by hand; seconds, in Material Preview."""
    yield from jobs.opened(scene, 64, "MATERIAL")
    yield 8.0  # shaders are made ready
    bpy.context.preferences.filepaths.file_preview_type = "AUTO"
    began = time.monotonic()
    made = robot.addon("irpso_addon.blender.jobs.indirect").IndirectRenderer.of_copy()
    seconds = time.monotonic() - began
    made.copy.cleanup()
    robot.tell(seconds=seconds, preview=bpy.context.preferences.filepaths.file_preview_type)


def estimates(scene: str, size: int, solves: int) -> Steps:
    """What a solve is said to take, and what it takes, again and again."""
    yield from jobs.opened(scene, size)
    yield 2.0
    told = []
    for _ in range(solves):
        expected = robot.addon("irpso_addon.blender.jobs.solve_speed").of(bpy.context).seconds
        began = time.monotonic()
        robot.invoke("irpso.solve")
        yield from robot.until(jobs.running, 10)
        yield from jobs.ended(LONG)
        told.append((expected, time.monotonic() - began))
        robot.say(told[-1], {k: round(v, 2) for k, v in jobs.solution().seconds.items()})
        yield 1.0
    robot.tell(estimates=told)
