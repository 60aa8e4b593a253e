"""Recover the selected objects' materials from the views."""

from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from ..irpso_addon.blender import indirect, jobs, material, properties, scene, session, views
from ..irpso_addon.blender.jobs import Task
from ..irpso_addon.blender.live import LiveMaps
from ..irpso_addon.core.data import Solution
from .modal_job import ModalJob
from .paths import captures_path


class IRPSO_OT_solve(ModalJob, bpy.types.Operator):
    """Recover base colour and roughness of the selected mesh objects from the reference images, one after another"""

    bl_idname = "irpso.solve"
    bl_label = "Solve"
    bl_options = {"REGISTER", "UNDO"}

    # Hidden: in the redo panel a change of it would solve everything again.
    write: bpy.props.BoolProperty(
        name="Write Maps", description="Put the maps on the object's materials when done", default=True,
        options={"HIDDEN", "SKIP_SAVE"})

    _live: LiveMaps | None = None
    _label = ""

    def objects(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """The active mesh, and the other selected ones."""
        others = [obj for obj in context.selected_objects if obj.type == "MESH" and obj != context.active_object]
        return [context.active_object, *others]

    def task(self, context: bpy.types.Context, obj: bpy.types.Object) -> Task:
        """Reads the scene and the panel's settings."""
        settings = properties.settings(context.scene.irpso)
        data = scene.read_scene(context, obj.name, captures_path(context.scene))
        self._label = f"{settings.method}, {settings.model}, {settings.size}"
        if settings.indirect == "off":
            return Task("pipeline:solve", (data, settings))
        if not bpy.data.is_dirty:
            bounce = indirect.Bouncer.of_open_file(Path(bpy.data.filepath))
            return Task("pipeline:solve", (data, settings, None, bounce))
        bounce = indirect.Bouncer.of_copy()
        assert bounce.copy is not None
        return Task("pipeline:solve", (data, settings, None, replace(bounce, copy=None)), bounce.copy.cleanup)

    def start(self, task: Task, obj: bpy.types.Object) -> None:
        """The solve in one process, first looks at it in another."""
        data, settings = task.arguments[:2]
        self._live = live = LiveMaps(data, settings)
        running = session.start(task.start(live.take), self.bl_label, obj.session_uid)
        running.curve = live.curve
        running.preview = jobs.preview((replace(data, start=None), settings), live.take)
        live.feed = running.preview.feed

    def tick(self, obj: bpy.types.Object) -> None:
        """One map at a time onto the object."""
        running, live = session.running, self._live
        assert running is not None and live is not None
        fresh, running.live = running.live is not live.latest, live.latest
        if self.write:
            live.show(obj)
        if fresh:
            views.refresh()

    def stopped(self) -> Solution | None:
        """What was on show."""
        return None if self._live is None else self._live.solution()

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> Iterator[None]:
        """Keeps the solution, wires the maps, says what happened."""
        solution: Solution = value
        session.keep(obj, solution, self._label)
        messages: tuple[str, ...] = ()
        if self.write:
            messages = yield from self._written(obj.session_uid, solution)
        for warning in (*solution.warnings, *messages):
            self.report({"WARNING"}, warning)
        texels = solution.texels
        outcome = "stopped; kept" if cancelled else "solved"
        self.report({"INFO"}, f"{obj.name}: {outcome} {texels['solved']:,} of {texels['covered']:,} texels")
        views.refresh()

    def _written(self, uid: int, solution: Solution) -> Generator[None, None, tuple[str, ...]]:
        """The maps on the object, an image a step; what the user should know."""
        obj = session.object_by_uid(uid)
        if obj is None:
            return ()
        material.check(obj, solution)
        own = self._live.own if self._live is not None else ()
        layers = material.layers_of(solution.maps)
        for role, array in layers.items():
            material.put_image(obj, role, array, own)
            yield
            obj = session.object_by_uid(uid)
            if obj is None:
                return ()
        images = material.images_of(obj)
        for role in layers.keys() - images.keys():  # Undo has taken it meanwhile
            images[role] = material.put_image(obj, role, layers[role])
        return material.wire_maps(obj, solution, {role: images[role] for role in layers})
