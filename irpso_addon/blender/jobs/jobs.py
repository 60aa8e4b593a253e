"""Long jobs: on the GL thread for whoever waits, in worker processes for the window."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import bpy

from ...core.errors import BadInput
from ...core.live_maps import Live
from ...core.params import DeviceSettings
from ...gpu.device import thread
from ...process import channel
from ...process.remote import Remote, Worker
from .. import logs
from ..preferences import device_settings

_warm: Worker | None = None
_warm_settings: DeviceSettings | None = None
_tried = False  # to get it ready, unasked; a solve starts it again whatever became of it


@dataclass(frozen=True)
class Task:
    """A generator function of this package, "module:function", and what it is called with; everything is pickled."""

    name: str
    arguments: tuple[Any, ...]
    afterwards: Callable[[], None] = lambda: None  # on the main thread, however it ended

    def run(self) -> Any:
        """Its value, waited for.  Raises what it raises."""
        module, _, name = self.name.partition(":")
        logs.begin("job", task=self.name)
        thread.configure(device_settings())
        try:
            return thread.run(lambda: getattr(channel.named(module), name)(*self.arguments))
        finally:
            self.afterwards()

    def start(self, prepare: Callable[[Live], Live] | None = None) -> Remote:
        """It in a process of its own.  Raises BadInput where none can be started."""
        logs.begin("job", task=self.name)
        return Remote(self.name, *self.arguments, settings=device_settings(), prepare=prepare)


def preview(arguments: tuple[Any, ...], prepare: Callable[[Live], Live]) -> Remote:
    """The first looks at a solve, in the worker that is warm.  Raises BadInput where there are none."""
    if device_settings().device == "numpy":
        raise BadInput("device numpy: there are no looks before the end")
    return Remote("solve.preview:preview", *arguments, worker=_worker(), prepare=prepare)


def warm_up() -> None:
    """Get the worker for previews ready, unless it is."""
    global _tried
    _tried = True
    if device_settings().device == "opengl" and (_warm is None or not _warm.alive):
        with suppress(BadInput):  # the solve will say it
            Remote("solve.preview:warm_up", worker=_worker())


def warm_soon() -> None:
    """`warm_up`, but not now, and once: for panels, which are drawn again and again."""
    if not _tried and not bpy.app.timers.is_registered(warm_up):
        bpy.app.timers.register(warm_up, first_interval=0.1)


def cool_down() -> None:
    """End the worker that is warm."""
    global _warm, _tried
    _tried = False
    if bpy.app.timers.is_registered(warm_up):
        bpy.app.timers.unregister(warm_up)
    if _warm is not None:
        _warm.close()
    _warm = None


def _worker() -> Worker:
    global _warm, _warm_settings
    settings = device_settings()
    if _warm is not None and settings != _warm_settings:
        _warm.close()
        _warm = None
    if _warm is None or not _warm.alive:
        _warm, _warm_settings = Worker(settings), settings
    return _warm
