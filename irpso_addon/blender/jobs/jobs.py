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


class _WarmWorker:
    """The worker for previews, kept ready."""

    def __init__(self) -> None:
        self.tried = False  # to get it ready, unasked; a solve starts it again whatever became of it
        self._worker: Worker | None = None
        self._settings: DeviceSettings | None = None

    @property
    def alive(self) -> bool:
        return self._worker is not None and self._worker.alive

    def get(self) -> Worker:
        """The one that there is, if it lives and has the settings of now, else a new one.  Raises BadInput."""
        settings = device_settings()
        if settings != self._settings:
            self.end()
        if self._worker is None or not self._worker.alive:
            self._worker, self._settings = Worker(settings), settings
        return self._worker

    def end(self) -> None:
        """None is left."""
        if self._worker is not None:
            self._worker.close()
        self._worker = None


_warm = _WarmWorker()


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
        raise BadInput("device numpy: no maps can be shown before the end")
    return Remote("solve.preview:preview", *arguments, worker=_warm.get(), prepare=prepare)


def warm_up() -> None:
    """Get the worker for previews ready, unless it is."""
    _warm.tried = True
    if device_settings().device == "opengl" and not _warm.alive:
        with suppress(BadInput):  # the solve will say it
            Remote("solve.preview:warm_up", worker=_warm.get())


def warm_soon() -> None:
    """`warm_up`, but not now, and once: for panels, which are drawn again and again."""
    if not _warm.tried and not bpy.app.timers.is_registered(warm_up):
        bpy.app.timers.register(warm_up, first_interval=0.1)


def cool_down() -> None:
    """End the worker that is warm."""
    _warm.tried = False
    if bpy.app.timers.is_registered(warm_up):
        bpy.app.timers.unregister(warm_up)
    _warm.end()
