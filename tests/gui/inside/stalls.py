"""How long the window stands still, and how often it shows something new, while a large solve runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise

import bpy
import jobs
import robot
from robot import Steps

TICK = 0.002  # seconds between two looks at the clock
PHASE = 5.0  # seconds of each baseline
UPDATES = 8  # a second, of the baseline that redraws


def watched(over: Callable[[], bool], each: Callable[[], None] = lambda: None) -> Steps:
    """Look at the clock until it is over; returns the gaps between two looks, in ms."""
    gaps, last = [], time.perf_counter()
    while not over():
        yield TICK
        now = time.perf_counter()
        gaps.append(1000 * (now - last - TICK))
        each()
        last = time.perf_counter()
    return sorted(gaps)


def for_a_while(each: Callable[[], None] = lambda: None) -> Steps:
    """`watched`, for PHASE seconds."""
    until = time.monotonic() + PHASE
    return watched(lambda: time.monotonic() > until, each)


def figures(gaps: list[float]) -> dict[str, float]:
    """The longest gap and the 95th of 100, in ms."""
    return {"longest": gaps[-1], "p95": gaps[int(0.95 * len(gaps))], "looks": len(gaps)}


class Redraw:
    """Writes an image that the viewport shows, as often as a solve would: what showing anything new costs."""

    def __init__(self, size: int) -> None:
        import numpy as np

        self._image = bpy.data.images.new("Baseline", size, size, float_buffer=True)
        self._pixels = np.random.default_rng(0).random(size * size * 4, np.float32)
        self._next = 0.0
        material = jobs.subject().active_material
        node = material.node_tree.nodes.new("ShaderNodeTexImage")
        node.image = self._image
        material.node_tree.links.new(node.outputs[0], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
        material.node_tree.nodes.active = node

    def __call__(self) -> None:
        """Show the next picture if it is time."""
        if time.monotonic() > self._next:
            self._pixels[::7] *= -1
            self._image.pixels.foreach_set(self._pixels)
            self._image.update()
            self._next = time.monotonic() + 1 / UPDATES


def timed(step: Callable[..., object], spent: list[float]) -> Callable[..., object]:
    """The same method; the milliseconds that it takes are put into ``spent``."""
    def method(self: object, context: bpy.types.Context, event: bpy.types.Event) -> object:
        before = time.perf_counter()
        try:
            return step(self, context, event)
        finally:
            spent.append(1000 * (time.perf_counter() - before))
    return method


def own_work() -> list[float]:
    """Milliseconds of each call of the operator's `modal`: what the add-on itself does on the main thread."""
    spent: list[float] = []
    operator = robot.addon("operators.solve").IRPSO_OT_solve
    for name in ("invoke", "modal"):
        setattr(operator, name, timed(getattr(operator, name), spent))
    return spent


def measure(scene: str, size: int, shading: str) -> Steps:
    """Idle, then redrawing, then solving; tells milliseconds, and when the maps were seen to change."""
    yield from jobs.opened(scene, size, shading)
    yield 3  # shaders of the viewport are compiled
    robot.tell(idle=figures((yield from for_a_while())))
    redraw = Redraw(min(size, 1024))
    yield from for_a_while(redraw)
    robot.tell(redraw=figures((yield from for_a_while(redraw))))
    bpy.ops.ed.undo()
    spent, seen = own_work(), []
    latest = [None]
    spot = yield from robot.find("irpso.solve(")
    yield from robot.click(*spot)
    pressed = time.monotonic() - robot.HOVER

    def look() -> None:
        live = jobs.running() and jobs.running().live
        if live is not None and live is not latest[0]:
            latest[0] = live
            seen.append(time.monotonic() - pressed)
            if len(seen) == 3:
                robot.shot("live")

    yield from robot.until(jobs.running, 5)
    gaps = yield from watched(lambda: jobs.running() is None or time.monotonic() - pressed > robot.PATIENCE, look)
    assert seen, "nothing was shown while it ran"
    took = time.monotonic() - pressed
    between = [b - a for a, b in pairwise(seen)] or [took]
    robot.tell(solve=figures(gaps), seconds=took, first=seen[0], updates=len(seen),
               rate=len(seen) / max(seen[-1], 1e-3), longest_between=max(between),
               own_longest=max(spent), own_p95=sorted(spent)[int(0.95 * len(spent))])
    yield from robot.look("end")
