"""Bring a photogrammetry project into the scene: cameras, mesh, flash and views."""

import time
from pathlib import Path
from typing import Any

import bpy

from ..irpso_addon.blender.panel_common import clear_status, clear_status_soon
from ..irpso_addon.blender.properties import shoot_settings
from ..irpso_addon.blender.shoot.import_shoot import Imported, ReadShoot, Shoot, add_shoot, import_shoot, read_shoot
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.job import Progress, Steps, run_to_end
from ..irpso_addon.core.params import ShootSettings
from ..irpso_addon.core.phrases import counted
from .helpers.modal_job import BUSY_SECONDS, REDRAW_PERIOD, TIMER_PERIOD
from .helpers.paths import absolute, stored


class IRPSO_OT_import_shoot(bpy.types.Operator):
    """Import the project's cameras, lenses and mesh, add its pictures as views, and put the flash on the camera"""

    bl_idname = "irpso.import_shoot"
    bl_label = "Import Shoot"
    bl_options = {"REGISTER", "UNDO"}

    _reading = False  # whether a click's import reads its files: then there is no second one
    _steps: Steps[ReadShoot]
    _settings: ShootSettings
    _timer: bpy.types.Timer | None = None
    _drawn = 0.0

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Project and pictures are named."""
        shoot = context.scene.irpso.shoot
        if IRPSO_OT_import_shoot._reading:
            cls.poll_message_set("An import is running: wait, or press Esc in the viewport to stop it")
            return False
        if not shoot.project or not shoot.images:
            cls.poll_message_set("Choose the project and the folder of the pictures first")
            return False
        return context.mode == "OBJECT"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """One undo takes everything back."""
        given = context.scene.irpso.shoot
        try:
            steps = import_shoot(_shoot(given), shoot_settings(given), stored)
            return self._finished(run_to_end(steps, lambda _: None))
        except BadInput as error:
            return self._refused(error)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Reads the files while the user goes on; hundreds of RAW files take a while."""
        if bpy.app.background:
            return self.execute(context)
        given, manager = context.scene.irpso.shoot, context.window_manager
        try:
            self._settings = shoot_settings(given)
            self._steps = read_shoot(_shoot(given), self._settings)
        except BadInput as error:
            return self._refused(error)
        self._timer = manager.event_timer_add(TIMER_PERIOD, window=context.window)
        manager.modal_handler_add(self)
        IRPSO_OT_import_shoot._reading = True
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """One event while the files are read: everything but Esc and our timer stays with the user."""
        if event.type == "ESC" and event.value == "PRESS":
            self._leave(context)
            self.report({"INFO"}, "Import Shoot: stopped; nothing was added")
            return {"CANCELLED"}
        if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
            return {"PASS_THROUGH"}
        began = time.monotonic()
        try:
            while time.monotonic() - began < BUSY_SECONDS:
                step = next(self._steps)
        except StopIteration as end:
            self._leave(context)
            return self._added(context, end.value)
        except BadInput as error:
            self._leave(context)
            return self._refused(error)
        except BaseException:
            self._leave(context)
            raise
        self._show(context, step)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender takes the operator away: a file is loaded or the window closed, which must not be touched then."""
        self._end(context)
        clear_status_soon()

    def _leave(self, context: bpy.types.Context) -> None:
        """The reading is over, at its end or before it."""
        self._end(context)
        clear_status()

    def _end(self, context: bpy.types.Context) -> None:
        IRPSO_OT_import_shoot._reading = False
        self._steps.close()
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None

    # ---- inner parts

    def _added(self, context: bpy.types.Context, read: ReadShoot) -> set[str]:
        if context.mode != "OBJECT":
            return self._refused(BadInput(f"scene '{context.scene.name}': is not in Object Mode any more; leave the "
                                          "mode and import again"))
        try:
            finished = self._finished(run_to_end(add_shoot(read, self._settings, stored), lambda step: None))
            _frame(context)
            return finished
        except BadInput as error:
            return self._refused(error)

    def _show(self, context: bpy.types.Context, step: Progress) -> None:
        """Status bar."""
        now = time.monotonic()
        if now - self._drawn < REDRAW_PERIOD:
            return
        self._drawn = now
        if context.workspace is not None:
            context.workspace.status_text_set(f"IRPSO Import Shoot: {step.stage}  {step.message}  Esc: stop")

    def _finished(self, imported: Imported) -> set[str]:
        for message in imported.messages:
            self.report({"WARNING"}, message)
        self.report({"INFO"}, f"Imported {counted(imported.views, 'view')} of '{imported.mesh.name}'; next: "
                    "Check, then Solve")
        return {"FINISHED"}

    def _refused(self, error: BadInput) -> set[str]:
        self.report({"ERROR"}, str(error))
        return {"CANCELLED"}


def _frame(context: bpy.types.Context) -> None:
    """The viewport of the button shows what was imported."""
    if context.area is None or context.area.type != "VIEW_3D":
        return
    region = next(region for region in context.area.regions if region.type == "WINDOW")
    with context.temp_override(region=region):
        bpy.ops.view3d.view_selected()


def _shoot(given: Any) -> Shoot:
    mesh = Path(absolute(given.mesh)) if given.mesh else None
    return Shoot(Path(absolute(given.project)), Path(absolute(given.images)), mesh)
