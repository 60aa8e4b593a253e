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
SLOW = 20.0  # ms: what takes the add-on longer is named in the log
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
        self._tree = jobs.subject().active_material.node_tree
        self._node = self._tree.nodes.new("ShaderNodeTexImage")
        self._node.image = self._image
        self._tree.links.new(self._node.outputs[0], self._tree.nodes["Principled BSDF"].inputs["Base Color"])
        self._tree.nodes.active = self._node

    def __call__(self) -> None:
        """Show the next picture if it is time."""
        if time.monotonic() > self._next:
            self._pixels[::7] = 1 - self._pixels[::7]
            self._image.pixels.foreach_set(self._pixels)
            self._image.update()
            self._next = time.monotonic() + 1 / UPDATES

    def remove(self) -> None:
        """Take it all away again."""
        self._tree.nodes.remove(self._node)
        bpy.data.images.remove(self._image)


def timed(step: Callable[..., object], spent: list[float]) -> Callable[..., object]:
    """The same method; the milliseconds that it takes are put into ``spent``."""
    def method(self: object, context: bpy.types.Context, event: bpy.types.Event) -> object:
        before = time.perf_counter()
        try:
            return step(self, context, event)
        finally:
            spent.append(1000 * (time.perf_counter() - before))
            if spent[-1] > SLOW:
                doing = jobs.running() and jobs.running().progress
                robot.say(f"{step.__name__} took {spent[-1]:.0f} ms", doing and (doing.stage, doing.message))
    return method


def own_work() -> dict[str, list[float]]:
    """Milliseconds of each call of the operator's methods: what the add-on itself does on the main thread."""
    spent: dict[str, list[float]] = {"invoke": [], "modal": []}
    operator = robot.addon("operators.solve").IRPSO_OT_solve
    for name, times in spent.items():
        setattr(operator, name, timed(getattr(operator, name), times))
    return spent


def measure(scene: str, size: int, shading: str) -> Steps:
    """Idle, then redrawing, then solving; tells milliseconds, and when the maps were seen to change."""
    yield from jobs.opened(scene, size, shading)
    yield 3  # shaders of the viewport are compiled
    robot.tell(idle=figures((yield from for_a_while())))
    redraw = Redraw(min(size, 1024))
    yield from for_a_while(redraw)
    robot.tell(redraw=figures((yield from for_a_while(redraw))))
    redraw.remove()
    spent, seen = own_work(), []
    latest = [None]
    pressed = time.monotonic()
    robot.invoke("irpso.solve")

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
               invoke=max(spent["invoke"]), modal=figures(sorted(spent["modal"])))
    yield from robot.look("end")
