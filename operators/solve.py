"""Recover the selected objects' materials from the views."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import bpy

from ..irpso_addon.blender import properties
from ..irpso_addon.blender.jobs import jobs, live_display, solve_object, solve_region, solve_speed
from ..irpso_addon.blender.jobs.jobs import Task
from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.material import material_preflight
from ..irpso_addon.blender.scene import readiness
from ..irpso_addon.blender.scene.readiness import solve_objects
from ..irpso_addon.blender.viewer import editors
from ..irpso_addon.core.data import Solution
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.tiled import uv_blocks
from ..irpso_addon.core.tiled.work_folder import WorkFolder
from .helpers.modal_job import ModalJob
from .helpers.paths import captures_path, out_folder


class IRPSO_OT_solve(ModalJob, bpy.types.Operator):
    """Find base colour and roughness of the selected mesh objects from the pictures, one object after another"""

    bl_idname = "irpso.solve"
    bl_label = "Solve"
    bl_options = {"UNDO"}  # not REGISTER: to repeat it would hold up the window

    write: bpy.props.BoolProperty(
        name="Write Maps", description="Connect the maps to the object's materials at the end", default=True,
        options={"HIDDEN", "SKIP_SAVE"})

    _live: live_display.LiveMaps | None = None
    _held = False  # was paused: its stages' times say nothing
    _expected: float | None = None  # seconds that one solve will take
    _order: solve_object.Order | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh that maps can go onto, with views."""
        if not super().poll(context):
            return False
        why = None
        if not bpy.app.background:
            why = material_preflight.why_not(context.active_object) or readiness.why_not(context)
        if why is not None:
            cls.poll_message_set(why)
        return why is None

    def objects(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """The active mesh, and the other selected ones."""
        return solve_objects(context)

    def look_over(self, context: bpy.types.Context, objects: list[bpy.types.Object]) -> None:
        """Their materials, if they are to take maps."""
        if self.write and len(objects) > 1:
            solve_object.check_objects(context, objects)

    def task(self, context: bpy.types.Context, obj: bpy.types.Object) -> Task:
        """Reads the scene and the panel's settings."""
        panel = context.scene.irpso
        order = solve_object.read(context, obj, captures_path(context.scene), properties.settings(panel),
                                  solve_region.of_panel(context), self.write)
        if order.large:
            order = replace(order, folder=out_folder(panel.out), kind=panel.format)
        solve_object.check(order)
        estimate = solve_speed.of(context)
        solve_object.check_room(order, estimate)
        self._expected = estimate.seconds if estimate is not None and estimate.learnt else None
        self._order = order
        return solve_object.task(order)

    def start(self, task: Task, obj: bpy.types.Object) -> None:
        """The solve in one process, first looks at it in another."""
        order = self._order
        session.secure(obj)
        settings = replace(order.settings, size=order.shown_size)
        maps = self._live = live_display.LiveMaps(order.data, settings, order.share)
        running = session.start(task.start(maps.take), self.bl_label, obj.session_uid, self._expected)
        running.curve, maps.time = maps.curve, running.time
        if order.udims != (uv_blocks.FIRST_UDIM,):
            return  # it looks at the 0-1 square
        with suppress(BadInput):  # looks are welcome, not needed
            running.preview = jobs.preview((replace(order.data, start=None), settings), maps.take_preview)
            maps.feed = running.preview.feed

    def tick(self, obj: bpy.types.Object) -> bool:
        """What is new of the maps onto the object."""
        running, maps = session.running, self._live
        assert running is not None and maps is not None
        self._held |= running.paused
        fresh, running.live = running.live is not maps.latest, maps.latest
        fresh = maps.show(obj) if self.write and not self._order.large else fresh
        if fresh:
            editors.refresh()
        return fresh

    def stopped(self) -> Solution | None:
        """What was on show; of large maps nothing, they go on from what is finished."""
        work = self._order.work
        if work is not None and WorkFolder.has_plan(work):
            self.report({"INFO"}, f"Finished blocks are kept in {work}; Solve continues from them")
        return None if self._live is None or work is not None else self._live.solution()

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> Iterator[None]:
        """Keeps the solution, wires the maps, says what happened."""
        solution: Solution = value
        name, live = obj.name, self._live
        result = solve_object.remember(obj, self._order, solution)
        if not (cancelled or self._held or live is None):
            solve_object.learn(self._order, solution, live.seconds)
        messages: tuple[str, ...] = ()
        if self.write:
            messages = yield from solve_object.place(
                obj, self._order, result, dict if live is None else live.images)
        for warning in (*solution.warnings, *messages):
            self.report({"WARNING"}, warning)
        texels = solution.texels
        outcome = "stopped; kept" if cancelled else "solved"
        further = "Solve again" if cancelled else "Export Maps under Result"
        counts = f"{texels['solved']:,} of {texels['covered']:,} texels"
        self.report({"INFO"}, f"{name}: {outcome} {counts}; next: {further}")

    def settled(self) -> None:
        """The views show the result instead of the running job."""
        if self._live is not None:
            self._live.drop()
        self._live = self._order = None  # their arrays: Blender keeps operators that have run, for its redo panel
        editors.refresh()
