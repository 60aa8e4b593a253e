"""Mix-in of operators whose work is a job on the GL thread.

``execute`` (scripts, background) waits for the job; ``invoke`` (a click) polls it from a timer, shows
how far it is, and lets Esc stop it.  Both end in the same `finish`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from ..irpso_addon.blender import session
from ..irpso_addon.core.errors import BadInput, Cancelled
from ..irpso_addon.core.job import Progress
from ..irpso_addon.gpu import thread

TIMER_PERIOD = 0.1  # seconds


class ModalJob:
    """Give `prepare` and `finish`; the operator class itself sets bl_idname and the like.

    Between two ticks the user may undo, delete or load: only the object's session_uid is kept.
    """

    object_uid: int
    _job: thread.Job
    _timer: bpy.types.Timer | None = None

    def prepare(self, context: bpy.types.Context, obj: bpy.types.Object) -> thread.JobFunction:
        """Reads everything the job needs.  Raises BadInput."""
        raise NotImplementedError

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> None:
        """Keeps, writes and reports the result.  Raises BadInput before anything is changed."""
        raise NotImplementedError

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
        return self._guarded(lambda: self._deliver(lambda: thread.run(self._prepare(context))))

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Starts the job and returns to the user."""
        if bpy.app.background:
            return self.execute(context)
        return self._guarded(lambda: self._start(context))

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """One event while the job runs: everything but Esc and our timer stays with the user."""
        if event.type == "ESC" and event.value == "PRESS":
            session.cancel_running()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if not self._job.done:
            self._show(context, self._job.poll())
            return {"PASS_THROUGH"}
        self._leave(context)
        return self._guarded(lambda: self._deliver(self._job.result))

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender takes the operator away: a file is loaded or the window closed."""
        self._job.cancel()
        self._leave(context)

    # ---- inner parts

    def _guarded(self, step: Callable[[], set[str]]) -> set[str]:
        try:
            return step()
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def _prepare(self, context: bpy.types.Context) -> thread.JobFunction:
        obj = context.active_object
        self.object_uid = obj.session_uid
        return self.prepare(context, obj)

    def _start(self, context: bpy.types.Context) -> set[str]:
        self._job = thread.Job(self._prepare(context))
        session.start(self._job, self.bl_label)
        manager = context.window_manager
        self._timer = manager.event_timer_add(TIMER_PERIOD, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _show(self, context: bpy.types.Context, progress: Progress | None) -> None:
        """Status bar, mouse cursor and the sidebar's bar."""
        if progress is None or session.running is None:
            return
        session.running.progress = progress
        doing = "stopping" if session.running.stopping else f"{progress.stage} {progress.message}".strip()
        context.window_manager.progress_update(100 * progress.fraction)
        if context.workspace is not None:
            context.workspace.status_text_set(f"IRPSO {self.bl_label}: {progress.fraction:.0%} {doing}    Esc: stop")
        session.redraw_sidebars()

    def _leave(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        context.window_manager.progress_end()
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        session.end()

    def _deliver(self, result: Callable[[], Any]) -> set[str]:
        cancelled = False
        try:
            value = result()
        except Cancelled as stop:
            if stop.partial is None:
                self.report({"WARNING"}, f"{self.bl_label}: stopped before there was a result")
                return {"CANCELLED"}
            value, cancelled = stop.partial, True
        obj = session.object_by_uid(self.object_uid)
        if obj is None:
            self.report({"WARNING"}, f"{self.bl_label}: the object was deleted meanwhile; its result is dropped")
            return {"CANCELLED"}
        self.finish(obj, value, cancelled)
        return {"FINISHED"}
