"""What this Blender session remembers: solutions and the running job.  What a file holds of them: `stored_result`.

Solutions are kept by the object's ``session_uid``, which survives undo and renaming, where a
reference to the object would dangle.  Loading a file forgets everything.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import bpy
from bpy.app.handlers import persistent

from ...core.checks.remedies import Remedy, remedies
from ...core.checks.shoot_check import ShootCheck
from ...core.data import Maps, Solution
from ...core.errors import BadInput, DeviceError
from ...core.job import Progress, doing
from ...core.live_maps import Live
from ...core.maps.map_set import MapFiles
from ...core.phrases import percent
from ...process.remote import Remote
from ..material.slot_names import Names, names_of, present_names, renamed
from ..panel_common import redraw_sidebars
from ..scene.apply_remedy import is_done
from .running_time import RunningTime

REMEMBERED = 4  # solutions of an object, at most; ...
ROOM = 500_000_000  # ... bytes of the older ones' maps, of all objects together
CALIBRATION = "calibration"  # begins the mark of one that was applied: number of its result, time
CalibrationState = Literal[
    "none", "open", "applied",
    "outdated",  # the lamps were changed as another, later one says
]


@dataclass
class Result:
    """A solution and what it was called when it was asked for."""

    label: str  # "14:32  two-lobe, refined, 1024"
    facts: Solution  # without its maps until `solution` is asked for, where ``load`` reads them
    files: MapFiles | None  # of a large solve: its maps; those of ``facts`` are its plan's, small
    number: int  # that no other solution has, nor one of an earlier session whose marks a file holds
    names: dict[int, str] = field(default_factory=dict)  # session_uids of materials -> their names in ``facts``
    load: Callable[[], Maps] | None = None  # of a result that the file has

    @property
    def solution(self) -> Solution:
        """With maps.  Raises BadInput where they are gone."""
        if self.load is not None:
            self.facts, self.load = replace(self.facts, maps=self.load()), None
        return self.facts

    def presented(self, obj: bpy.types.Object, maps: bool = True) -> Solution:
        """By the names that the object's materials have now.  With ``maps`` it raises BadInput as `solution`."""
        return renamed(self.solution if maps else self.facts, present_names(obj, self.names))

    def is_renamed(self, obj: bpy.types.Object) -> bool:
        """Whether some material has another name by now."""
        return bool(present_names(obj, self.names))

    def settle(self, obj: bpy.types.Object) -> None:
        """From now on by the names that the object's materials have; those that were made for it belong to it too."""
        now = present_names(obj, self.names)
        self.facts = renamed(self.facts, now)
        self.names = {uid: now.get(name, name) for uid, name in self.names.items()}
        self.names = names_of(obj, self.facts.model) | self.names

    @property
    def size(self) -> int:
        """Bytes of the maps and pictures that are in memory."""
        pictures = [array for picture in self.facts.pictures for array in (picture.reference, picture.predicted)]
        arrays = [*vars(self.facts.maps).values(), *pictures]
        return sum(array.nbytes for array in arrays if array is not None)


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
    time: RunningTime = field(default_factory=RunningTime)
    live: Live | None = None  # the latest look at it
    curve: list[tuple[float, float]] = field(default_factory=list)  # seconds, error: how it converges

    def reached(self, progress: Progress) -> None:
        """How far the job says that it is."""
        self.progress = progress
        self.time.update(progress.fraction)

    def words(self) -> str:
        """How far it is: "43 % solving, 12 s left"."""
        state = "paused" if self.paused else "stopping" if self.stopping else doing(self.progress.stage)
        text = f"{percent(self.time.fraction)} {state}"
        if self.time.left is not None and not self.paused:
            text += f", {self.time.left:.0f} s left" if self.time.left >= 1 else ", nearly done"
        return text


class Session:
    """The running job and the results; there is one, `session`."""

    def __init__(self) -> None:
        self.running: Running | None = None
        self.device_trouble = False  # whether the graphics device could not do the last job
        self._results: dict[int, list[Result]] = {}  # by object, the newest last
        self._checks: dict[int, ShootCheck] = {}  # by object
        self._subject = 0  # session_uid of the mesh that was active last
        self.stored: Callable[[bpy.types.Object], Result | None] | None = None  # what the file has of an object

    def keep(
        self, obj: bpy.types.Object, solution: Solution, label: str = "solved", files: MapFiles | None = None,
        names: Names | None = None,
    ) -> Result:
        """Remembers ``solution`` as the last one of ``obj``.  ``names``: of its materials, by their session_uids."""
        self.secure(obj)
        named = dict(names_of(obj, solution.model) if names is None else names)
        result = Result(label, solution, files, time.time_ns(), named)
        self._results[obj.session_uid] = [*self.results_of(obj), result][-REMEMBERED:]
        self._make_room()
        return result

    def promote(self, obj: bpy.types.Object, result: Result) -> None:
        """Makes a remembered result the last one again."""
        others = [other for other in self.results_of(obj) if other is not result]
        self._results[obj.session_uid] = [*others, result]

    def secure(self, obj: bpy.types.Object) -> None:
        """Reads maps that are in images alone, before those are replaced; a result whose maps are gone is dropped."""
        for result in self.results_of(obj):
            try:
                result.solution  # noqa: B018
            except BadInput:
                self._results[obj.session_uid].remove(result)

    def _make_room(self) -> None:
        """Drops the oldest of the older results while they take more than ROOM."""
        older = sorted(((result, uid) for uid, results in self._results.items() for result in results[:-1]),
                       key=lambda entry: entry[0].number)
        room = sum(result.size for result, _ in older)
        for result, uid in older[:-1]:
            if room <= ROOM:
                break
            self._results[uid].remove(result)
            room -= result.size

    def results_of(self, obj: bpy.types.Object | None) -> list[Result]:
        """What was solved of ``obj``, the newest last: since the file was opened, and what the file has of it."""
        if obj is None:
            return []
        found = self._results.get(obj.session_uid)
        if found is None and self.stored is not None and not self._is_worked_on(obj):
            stored = self.stored(obj)
            if stored is not None:
                found = self._results[obj.session_uid] = [stored]
        return list(found or [])

    def _is_worked_on(self, obj: bpy.types.Object) -> bool:
        """Whether its maps are those of a running solve."""
        return self.running is not None and self.running.object_uid == obj.session_uid

    def subject(self, context: bpy.types.Context) -> bpy.types.Object | None:
        """The active mesh, or, where a camera or lamp is active, the mesh that was active before."""
        active = getattr(context, "active_object", None) or context.view_layer.objects.active
        if active is not None and active.type == "MESH":
            self._subject = active.session_uid
            return active
        last = object_by_uid(self._subject)
        return last if last is not None and last.name in context.view_layer.objects else active

    def facts_of(self, obj: bpy.types.Object | None) -> Solution | None:
        """The last solution of ``obj``, without maps where they have not been read: for panels."""
        results = self.results_of(obj)
        return results[-1].presented(obj, maps=False) if results and obj is not None else None

    def solution_of(self, obj: bpy.types.Object | None) -> Solution | None:
        """The last solution of ``obj``, by the names that its materials have now; None where its maps are gone."""
        results = self.results_of(obj)
        if not results or obj is None:
            return None
        try:
            return results[-1].presented(obj)
        except BadInput:
            return None

    def files_of(self, obj: bpy.types.Object | None) -> MapFiles | None:
        """Its last solution's maps, where they are files."""
        results = self.results_of(obj)
        return results[-1].files if results else None

    def remedied(self, scene: bpy.types.Scene, obj: bpy.types.Object) -> tuple[int, ...]:
        """Which remedies of the last solution of ``obj`` the scene has had, by their places."""
        prefix, marks = self._prefix(obj), scene.irpso.remedied.split(",")
        return tuple(int(mark.removeprefix(prefix)) for mark in marks if mark.startswith(prefix))

    def note_remedy(self, scene: bpy.types.Scene, obj: bpy.types.Object, index: int) -> None:
        """Remembers one in the scene, so that undo forgets it again."""
        marks = [*scene.irpso.remedied.split(","), f"{self._prefix(obj)}{index}"]
        scene.irpso.remedied = ",".join(filter(None, marks))

    def calibration_state(self, scene: bpy.types.Scene, obj: bpy.types.Object) -> CalibrationState:
        """Of what the last solution of ``obj`` has put right of cameras, lamps and exposures."""
        results = self.results_of(obj)
        if not results or not results[-1].facts.put_right:
            return "none"
        found = (re.fullmatch(rf"{CALIBRATION} (\d+ )(\d+)", mark) for mark in scene.irpso.remedied.split(","))
        marks = [mark for mark in found if mark is not None]
        if any(mark[1] == self._prefix(obj) for mark in marks):
            return "applied"
        return "outdated" if any(int(mark[2]) > results[-1].number for mark in marks) else "open"

    def note_calibration(self, scene: bpy.types.Scene, obj: bpy.types.Object) -> None:
        """Remembers in the scene that it has had what the last solution of ``obj`` put right; undo forgets it."""
        marks = [*scene.irpso.remedied.split(","), f"{CALIBRATION} {self._prefix(obj)}{time.time_ns()}"]
        scene.irpso.remedied = ",".join(filter(None, marks))

    def open_remedies(self, scene: bpy.types.Scene, obj: bpy.types.Object) -> dict[int, Remedy]:
        """Those of the last solution of ``obj`` that the scene has not had, by their places.

        Those of lamps count from where the solve has put cameras and lamps: they wait until the scene has them there.
        """
        solution = self.facts_of(obj)
        offered = remedies(solution.checks) if solution is not None and solution.checks is not None else ()
        done = self.remedied(scene, obj)
        waits = (solution is not None and solution.for_scene
                 and self.calibration_state(scene, obj) in ("open", "outdated"))
        return {index: remedy for index, remedy in enumerate(offered) if not (
            index in done or is_done(scene, remedy) or (waits and remedy.kind in ("power", "move")))}

    def _prefix(self, obj: bpy.types.Object) -> str:
        """With which the marks of an object's last solution begin, in any session."""
        results = self.results_of(obj)
        return f"{results[-1].number if results else 0} "

    def keep_check(self, obj: bpy.types.Object, check: ShootCheck) -> None:
        """Remembers what the last check of ``obj`` said."""
        self._checks[obj.session_uid] = check

    def drop_checks(self) -> None:
        """What the checks looked at has changed."""
        self._checks.clear()

    def check_of(self, obj: bpy.types.Object | None) -> ShootCheck | None:
        """The last check of ``obj`` since the file was opened."""
        return None if obj is None else self._checks.get(obj.session_uid)

    def start(self, job: Remote, title: str, object_uid: int = 0, expected: float | None = None) -> Running:
        """Makes ``job`` the running one, which is ``expected`` to take so many seconds."""
        self.device_trouble = False
        self.running = Running(job, title, object_uid=object_uid, time=RunningTime(expected))
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
            self.running.time.pause(self.running.paused)
            for job in (self.running.job, self.running.preview):
                if job is not None:
                    job.pause(self.running.paused)
            redraw_sidebars()

    def forget(self) -> None:
        """Stops the running job and drops every result."""
        self.cancel_running()
        self._results.clear()
        self._checks.clear()


session = Session()


def object_by_uid(uid: int) -> bpy.types.Object | None:
    """The object with this ``session_uid``, if it still exists."""
    return next((obj for obj in bpy.data.objects if obj.session_uid == uid), None)


@persistent
def on_load(*_: object) -> None:
    """load_pre handler: the objects of the file that is being closed are gone."""
    session.forget()
