"""Mix-in of operators whose work is a long job.

``execute`` (scripts, background) waits for it, on the GL thread.  ``invoke`` (a click) has it done by a worker process,
polls that from a timer, shows how far it is, and lets Esc stop it.  Both end in the same `finish`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import bpy

from ...irpso_addon.blender.jobs.jobs import Task
from ...irpso_addon.blender.jobs.session import Running, object_by_uid, session
from ...irpso_addon.blender.panel_common import clear_status, clear_status_soon, closing, redraw_sidebars
from ...irpso_addon.core import log
from ...irpso_addon.core.errors import BadInput, Cancelled
from ...irpso_addon.core.job import Progress

TIMER_PERIOD = 0.05  # seconds
BUSY_SECONDS = 0.02  # that the window may wait
REDRAW_PERIOD = 0.5  # seconds between two drawings of the progress where nothing else is drawn anew


class ModalJob:
    """Give `task` and `finish`, and what else is wanted; the operator class itself sets bl_idname and the like.

    Between two ticks the user may undo, delete or load: only objects' session_uids are kept.
    """

    _flow: Iterator[None] | None = None
    _running: Running | None = None
    _timer: bpy.types.Timer | None = None
    _drawn = 0.0
    _fresh = False  # the window is drawn anew: the progress goes along
    _kept = False  # whether something was changed, so that there is something to undo

    def objects(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """What is worked on, one after another."""
        return [context.active_object]

    def look_over(self, context: bpy.types.Context, objects: list[bpy.types.Object]) -> None:
        """Raises BadInput for what is known to stop one of several, before the first is worked on."""

    def task(self, context: bpy.types.Context, obj: bpy.types.Object) -> Task:
        """Reads everything the job needs.  Raises BadInput."""
        raise NotImplementedError

    def start(self, task: Task, obj: bpy.types.Object) -> None:
        """Begins it in another process."""
        session.start(task.start(), self.bl_label, obj.session_uid)

    def tick(self, obj: bpy.types.Object) -> bool:
        """Shows what is new of the running job, in a few milliseconds; whether there was something."""
        return False

    def stopped(self) -> Any:
        """What there is of a job in another process that was stopped; None: nothing."""
        return None

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> Iterator[None]:
        """Keeps, writes and reports the result, in steps of some milliseconds, after which ``obj`` is looked up again.

        Raises BadInput before anything is changed.
        """
        raise NotImplementedError

    def settled(self) -> None:
        """Once the job is over, and its result is in its place."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh, out of Edit Mode, and no other job."""
        obj = context.active_object
        if session.running is not None:
            cls.poll_message_set("Another job is running: wait, or press Esc in the viewport to stop it")
        elif obj is None or obj.type != "MESH":
            cls.poll_message_set("Make a mesh object active")
        elif obj.mode == "EDIT":
            cls.poll_message_set("Leave Edit Mode first")
        else:
            return True
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Does the whole job before it returns."""
        try:
            objects = self.objects(context)
            self.look_over(context, objects)
            for obj in objects:
                value, cancelled = _outcome(self.task(context, obj).run)
                for _ in self._finished(obj.session_uid, value, cancelled):
                    pass
        except BadInput as error:
            self._refuse(error)
        return {"FINISHED"} if self._kept else {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Starts the job and returns to the user."""
        if bpy.app.background:
            return self.execute(context)
        objects = self.objects(context)
        self._flow = self._through([obj.session_uid for obj in objects])
        try:
            self.look_over(context, objects)
            next(self._flow)
        except (BadInput, StopIteration) as error:
            self._leave(context)
            if isinstance(error, BadInput):
                self._refuse(error)
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(TIMER_PERIOD, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """One event while the job runs: everything but Esc and our timer stays with the user."""
        escape = event.type == "ESC" and event.value == "PRESS"
        if escape:
            session.cancel_running()  # the next tick delivers
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if bpy.app.is_job_running("RENDER"):  # a render reads what we would write
            return {"PASS_THROUGH"}
        assert self._flow is not None
        try:
            began = time.monotonic()
            next(self._flow)
            while self._running is not None and self._running.job.done and time.monotonic() - began < BUSY_SECONDS:
                next(self._flow)  # nothing to wait for
        except BadInput as error:
            self._refuse(error)
        except StopIteration:
            pass
        except BaseException:
            self._leave(context)
            raise
        else:
            self._show(context)
            return {"PASS_THROUGH"}
        self._leave(context)
        return {"FINISHED"} if self._kept else {"CANCELLED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender takes the operator away: a file is loaded or the window closed, which must not be touched then."""
        session.cancel_running()
        with closing():
            self._end(context)
        clear_status_soon()

    # ---- inner parts

    def _through(self, uids: list[int]) -> Iterator[None]:
        """The whole job; a step for each tick."""
        for uid in uids:
            obj = object_by_uid(uid)
            if obj is None:
                continue
            task = self.task(bpy.context, obj)
            try:
                self.start(task, obj)
                self._running = running = session.running
                assert running is not None
                running.leave = lambda: self._leave(bpy.context)
                yield
                while not running.job.done:
                    obj = object_by_uid(uid)
                    if obj is None:
                        running.job.cancel()
                        self.report({"WARNING"}, f"{self.bl_label}: the object was deleted; its result is dropped")
                        break
                    running.reached(running.job.poll() or running.progress)
                    self._fresh = self.tick(obj)
                    yield
                value, cancelled, error = self._delivered(running)
                running.progress = Progress(1.0, "write")
                if value is not None or error is None:
                    yield from self._finished(uid, value, cancelled)
                if error is not None:
                    self._refuse(error)  # last: the window shows no report but the last one
                if uid != uids[-1]:
                    bpy.ops.ed.undo_push(message=self.bl_label)  # the last one is the operator's own
            finally:
                session.end(session.running)
                task.afterwards()
                self.settled()
            if running.stopping:
                return

    def _delivered(self, running: Running) -> tuple[Any, bool, Exception | None]:
        """The job's value, or what there is of it, whether it was stopped, and the error that has ended it."""
        failure: Exception | None = None
        try:
            value, cancelled = _outcome(running.job.result)
        except (BadInput, RuntimeError) as error:  # RuntimeError: the worker has a bug, or died
            value, cancelled, failure = None, True, error
        return (self.stopped(), True, failure) if value is None else (value, cancelled, failure)

    def _refuse(self, error: Exception) -> None:
        log.failure(self.bl_idname, error)
        session.fail(error)
        self.report({"ERROR"}, str(error))

    def _finished(self, uid: int, value: Any, cancelled: bool) -> Iterator[None]:
        obj = object_by_uid(uid)
        if obj is None:
            return
        if value is None:
            self.report({"WARNING"}, f"{self.bl_label}: stopped before there was a result")
            return
        self._kept = True
        yield from self.finish(obj, value, cancelled)

    def _show(self, context: bpy.types.Context) -> None:
        """Status bar and the sidebar's bar."""
        running, now = session.running, time.monotonic()
        if running is None or (now - self._drawn < REDRAW_PERIOD and not self._fresh):
            return
        self._drawn = now
        progress = running.progress
        if context.workspace is not None:
            context.workspace.status_text_set(
                f"IRPSO {self.bl_label}: {running.words()}  {progress.message}  Esc: stop")
        redraw_sidebars()

    def _leave(self, context: bpy.types.Context) -> None:
        self._end(context)
        clear_status()

    def _end(self, context: bpy.types.Context) -> None:
        if self._flow is not None:
            self._flow.close()
            self._flow = None
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        session.end(self._running)
        self._running = None


def _outcome(result: Any) -> tuple[Any, bool]:
    """A job's value and whether it was stopped.  Raises what else it raised."""
    try:
        return result(), False
    except Cancelled as stop:
        return stop.partial, True
