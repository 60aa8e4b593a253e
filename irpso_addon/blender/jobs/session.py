"""What this Blender session remembers and no file holds: solutions and the running job.

Solutions are kept by the object's ``session_uid``, which survives undo and renaming, where a
reference to the object would dangle.  Loading a file forgets everything.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import bpy
from bpy.app.handlers import persistent

from ...core.data import Solution
from ...core.errors import DeviceError
from ...core.job import Progress
from ...core.live_maps import Live
from ...core.maps.map_set import MapFiles
from ...process.remote import Remote
from ..panel_common import redraw_sidebars

REMEMBERED = 4  # solutions of an object
TELLING = 0.05  # progress from which on the time that is left can be told


@dataclass(frozen=True)
class Result:
    """A solution and what it was called when it was asked for."""

    label: str  # "refined, auto, 1024"
    solution: Solution  # of a large solve: its plan's, with small maps
    files: MapFiles | None = None  # of a large solve: its maps


@dataclass
class Running:
    """The one job that a modal operator drives now."""

    job: Remote
    title: str
    progress: Progress = field(default_factory=lambda: Progress(0.0, "start"))
    preview: Remote | None = None  # looks at the same, ahead of it
    stopping: bool = False
    paused: bool = False
    leave: Callable[[], None] = lambda: None  # what its operator does at its end, should it be unregistered before
    object_uid: int = 0  # of the object that is worked on
    started: float = field(default_factory=time.monotonic)
    live: Live | None = None  # the latest look at it
    curve: list[tuple[float, float]] = field(default_factory=list)  # seconds, error: how it converges

    def words(self) -> str:
        """How far it is: "43 % solve, 12 s left"."""
        progress = self.progress
        doing = "paused" if self.paused else "stopping" if self.stopping else progress.stage
        text = f"{progress.fraction:.0%} {doing}"
        if progress.fraction > TELLING and not self.paused:
            seconds = (time.monotonic() - self.started) * (1 / progress.fraction - 1)
            text += f", {seconds:.0f} s left"
        return text


class Session:
    """The running job and the results; there is one, `session`."""

    def __init__(self) -> None:
        self.running: Running | None = None
        self.device_trouble = False  # whether the graphics device could not do the last job
        self._results: dict[int, list[Result]] = {}  # by object, the newest last

    def keep(
        self, obj: bpy.types.Object, solution: Solution, label: str = "solved", files: MapFiles | None = None,
    ) -> None:
        """Remembers ``solution`` as the last one of ``obj``."""
        self._results[obj.session_uid] = [*self.results_of(obj), Result(label, solution, files)][-REMEMBERED:]

    def results_of(self, obj: bpy.types.Object | None) -> list[Result]:
        """What was solved of ``obj`` since the file was opened, the newest last."""
        return [] if obj is None else self._results.get(obj.session_uid, [])

    def solution_of(self, obj: bpy.types.Object | None) -> Solution | None:
        """The last solution of ``obj`` since the file was opened."""
        results = self.results_of(obj)
        return results[-1].solution if results else None

    def files_of(self, obj: bpy.types.Object | None) -> MapFiles | None:
        """Its last solution's maps, where they are files."""
        results = self.results_of(obj)
        return results[-1].files if results else None

    def start(self, job: Remote, title: str, object_uid: int = 0) -> Running:
        """Makes ``job`` the running one."""
        self.device_trouble = False
        self.running = Running(job, title, object_uid=object_uid)
        return self.running

    def fail(self, error: Exception) -> None:
        """Remembers what ``error`` says of the graphics device."""
        self.device_trouble = isinstance(error, DeviceError)

    def end(self, job: Running | None) -> None:
        """Forgets ``job`` if it is the running one; the caller has taken its result or cancelled it."""
        if job is None or job is not self.running:
            return
        if job.preview is not None:
            job.preview.cancel()
        self.running = None
        redraw_sidebars()

    def cancel_running(self) -> None:
        """Stops the running job at once."""
        if self.running is not None:
            self.running.stopping = True
            self.running.job.cancel()

    def pause_running(self) -> None:
        """Holds the running job, or lets it go on."""
        if self.running is not None:
            self.running.paused = not self.running.paused
            for job in (self.running.job, self.running.preview):
                if job is not None:
                    job.pause(self.running.paused)
            redraw_sidebars()

    def forget(self) -> None:
        """Stops the running job and drops every result."""
        self.cancel_running()
        self._results.clear()


session = Session()


def object_by_uid(uid: int) -> bpy.types.Object | None:
    """The object with this ``session_uid``, if it still exists."""
    return next((obj for obj in bpy.data.objects if obj.session_uid == uid), None)


@persistent
def on_load(*_: object) -> None:
    """load_pre handler: the objects of the file that is being closed are gone."""
    session.forget()
