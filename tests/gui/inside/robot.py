"""A person at Blender's window: moves the mouse, presses, waits, looks.

A scenario is a generator: it yields the seconds until it goes on.  What waits or presses here is one too, so that
a scenario says ``yield from robot.press("irpso.solve")``.
"""

from __future__ import annotations

import json
import sys
import time
import traceback
from collections.abc import Callable, Generator, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import bpy

Steps = Generator[float, None, Any]
FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
PACKAGE = "bl_ext.user_default.irpso"
HOVER = 0.05  # seconds until Blender has drawn what the mouse is over
REST = 0.004  # seconds of each of Blender's rounds; by itself it rests 0.005 where no event waits
PATIENCE = 60.0  # seconds that anything may take unless a scenario says otherwise
_told: dict[str, Any] = {}
_met: list[tuple[str, float, float]] = []  # buttons that were found, and where
_began = time.monotonic()


def tell(**values: Any) -> None:
    """Report something to the test."""
    _told.update(values)
    say("told", values)


def say(*words: object) -> None:
    """A line in the log, with the seconds since Blender started."""
    print(f"[{time.monotonic() - _began:6.2f} s]", *words, flush=True)


def play(scenario: Callable[[], Steps], plain: bool) -> None:
    """Run a scenario from a timer that outlives loading files; then quit, with status 0 if nothing was raised.

    ``plain``: viewports are drawn without what no test looks at, because every redraw takes the processor long.
    """
    bpy.context.preferences.view.show_splash = False
    if plain:
        bpy.context.preferences.system.viewport_aa = "OFF"
        bpy.context.preferences.system.use_overlay_smooth_wire = False
        _draw_plainly()
        bpy.app.handlers.load_post.append(_draw_plainly)
    steps: list[Steps] = []

    def tick() -> float | None:
        try:
            if not steps:
                steps.append(scenario())
            return next(steps[0])
        except StopIteration:
            _end(0)
        except BaseException:
            traceback.print_exc()
            shot("failed")
            _end(1)
        return None

    bpy.app.timers.register(tick, first_interval=0.5, persistent=True)
    if bpy.app.use_event_simulate:
        bpy.app.timers.register(_rest, persistent=True)


@bpy.app.handlers.persistent
def _draw_plainly(*_: object) -> None:
    """No grid and no outline in any viewport; EEVEE draws one sample of every eighth pixel of a row and a column."""
    for screen in bpy.data.screens:
        for view in (space for area in screen.areas for space in area.spaces if space.type == "VIEW_3D"):
            view.overlay.show_floor = view.overlay.show_axis_x = view.overlay.show_axis_y = False
            view.overlay.show_outline_selected = False
    for scene in bpy.data.scenes:
        scene.eevee.taa_samples, scene.render.preview_pixel_size = 1, "8"


def _rest() -> float:
    """Once in each round: a Blender that lets events be simulated never rests by itself, and takes a core."""
    time.sleep(REST)
    return 0.0


def _end(status: int) -> None:
    until = time.monotonic() + 5
    while any((FOLDER / "wanted").iterdir()) and time.monotonic() < until:
        time.sleep(0.02)
    write(status == 0)
    with bpy.context.temp_override(window=window()):
        bpy.ops.wm.quit_blender()


def write(finished: bool) -> None:
    """Leave what was told for the test, with whether the scenario came to its end."""
    (FOLDER / "told.json").write_text(json.dumps({**_told, "finished": finished}))
    sys.stdout.flush()


def shot(name: str) -> None:
    """Ask for the screenshot NAME.png."""
    say("screenshot", name)
    (FOLDER / "wanted" / name).touch()


def look(name: str, settle: float = 0.5) -> Steps:
    """Let Blender draw, then wait until the screenshot is taken."""
    yield settle
    shot(name)
    yield from until(lambda: not (FOLDER / "wanted" / name).exists(), 10)


def addon(module: str) -> Any:
    """A module of the installed add-on: ``addon("irpso_addon.blender.jobs.session")``."""
    return sys.modules[f"{PACKAGE}.{module}"]


# ---- where things are


def window() -> bpy.types.Window:
    """The first window."""
    return bpy.context.window_manager.windows[0]


def area(kind: str = "VIEW_3D") -> bpy.types.Area:
    """The first area of a kind."""
    return next(a for a in window().screen.areas if a.type == kind)


def region(kind: str = "UI", of: str = "VIEW_3D") -> bpy.types.Region:
    """A region of the first area of a kind."""
    return next(r for r in area(of).regions if r.type == kind)


def within(of: str = "VIEW_3D", kind: str = "WINDOW") -> Any:
    """Context override for operators that ask where the mouse is."""
    return bpy.context.temp_override(window=window(), area=area(of), region=region(kind, of))


def open_tab(name: str = "IRPSO", of: str = "VIEW_3D") -> Steps:
    """The sidebar's tab; it can be chosen once the sidebar was drawn."""
    area(of).spaces.active.show_region_ui = True
    yield 0.3
    region("UI", of).active_panel_category = name
    area(of).tag_redraw()
    yield 0.3


def invoke(operator: str) -> None:
    """What a click on the button of "irpso.solve" does, where no mouse is to be had."""
    group, name = operator.split(".")
    with within():
        getattr(getattr(bpy.ops, group), name)("INVOKE_DEFAULT")


# ---- hands


def move(x: float, y: float) -> None:
    """The mouse, in pixels of the window from its lower left corner."""
    window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=int(x), y=int(y))


def click(x: float, y: float, button: str = "LEFTMOUSE") -> Steps:
    """Press and let go."""
    move(x, y)
    yield HOVER
    for value in ("PRESS", "RELEASE"):
        window().event_simulate(type=button, value=value, x=int(x), y=int(y))
        yield HOVER


def key(name: str, x: float | None = None, y: float | None = None, **modifiers: bool) -> Steps:
    """Press a key with the mouse over a place, by default the middle of the viewport."""
    at = region("WINDOW")
    spot = (at.x + at.width // 2 if x is None else x, at.y + at.height // 2 if y is None else y)
    move(*spot)
    yield HOVER
    for value in ("PRESS", "RELEASE"):
        window().event_simulate(type=name, value=value, x=int(spot[0]), y=int(spot[1]), **modifiers)
        yield HOVER


def hovered(of: str, kind: str) -> str:
    """What the mouse is over: ``bpy.ops.irpso.solve()`` for a button, a data path for a property."""
    manager = bpy.context.window_manager
    with within(of, kind):
        for copy, options in ((bpy.ops.ui.copy_python_command_button, {}),
                              (bpy.ops.ui.copy_data_path_button, {"full_path": True})):
            if copy.poll():
                copy(**options)
                return manager.clipboard
    return ""


def find(what: str, of: str = "VIEW_3D", kind: str = "UI", across: tuple[float, ...] = (0.5, 0.9),
         below: float | None = None) -> Steps:
    """Go down a region with the mouse until it is over ``what`` (part of a command or data path); returns (x, y).

    First it looks where it was met before.  ``across``: at which parts of the region's width to go down; ``below``:
    from which height, by default the top.  Panels may still be sliding open: found is what is there a moment later too.
    Raises AssertionError with what was met instead.
    """
    met: list[str] = []
    at = region(kind, of)
    top = int(below or at.y + at.height - 8)
    before = [(x, y) for (name, x, y) in _met if what in name and at.y < y <= top and at.x < x < at.x + at.width]
    for x, y in chain(before[-1:], *(_down(of, kind, part, below) for part in (*across, *across))):
        move(x, y)
        yield 0.02
        here = hovered(of, kind)
        if what in here:
            yield 0.2
            here = hovered(of, kind)
        if what in here:
            say("found", here, "at", (x, y))
            _met.append((here, x, y))
            return x, y
        if here and here not in met:
            met.append(here)
    shot(f"no-{what.replace('/', '-')}")
    yield 0.5
    raise AssertionError(f"no {what} in {of} {kind}; there are {met}")


def _down(of: str, kind: str, part: float, below: float | None) -> Iterator[tuple[int, int]]:
    """Places of `find`, at one part of the region's width."""
    at = region(kind, of)
    x = at.x + int(at.width * part)
    for y in range(int(below or at.y + at.height - 8), at.y + 4, -11):
        yield x, y


def press(what: str, **where: Any) -> Steps:
    """Find a button or a property and click it."""
    yield from click(*(yield from find(what, **where)))


def until(there: Callable[[], Any], seconds: float = PATIENCE, step: float = 0.02) -> Steps:
    """Wait for something; returns it.  Raises AssertionError when it does not come in time."""
    started = time.monotonic()
    while not (value := there()):
        if time.monotonic() - started > seconds:
            raise AssertionError(f"waited {seconds} s in vain")
        yield step
    return value
