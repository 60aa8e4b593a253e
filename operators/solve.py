"""Recover the selected objects' materials from the views."""

from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from ..irpso_addon.blender import (
    estimates,
    indirect,
    jobs,
    live,
    material,
    properties,
    readiness,
    scene,
    session,
    steer,
    views,
    writable,
)
from ..irpso_addon.blender.jobs import Task
from ..irpso_addon.blender.readiness import solve_objects
from ..irpso_addon.core.data import SceneData, Solution
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.params import SolveSettings
from .modal_job import ModalJob
from .paths import captures_path


class IRPSO_OT_solve(ModalJob, bpy.types.Operator):
    """Recover base colour and roughness of the selected mesh objects from the reference images, one after another"""

    bl_idname = "irpso.solve"
    bl_label = "Solve"
    bl_options = {"UNDO"}  # not REGISTER: to repeat it would hold up the window

    write: bpy.props.BoolProperty(
        name="Write Maps", description="Put the maps on the object's materials when done", default=True,
        options={"HIDDEN", "SKIP_SAVE"})

    _live: live.LiveMaps | None = None
    _label = ""
    _held = False  # was paused: its times say nothing
    _asked: tuple[SceneData, SolveSettings]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh that maps can go onto, with views."""
        if not super().poll(context):
            return False
        why = None if bpy.app.background else writable.why_not(context.active_object) or readiness.why_not(context)
        if why is not None:
            cls.poll_message_set(why)
        return why is None

    def objects(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """The active mesh, and the other selected ones."""
        return solve_objects(context)

    def task(self, context: bpy.types.Context, obj: bpy.types.Object) -> Task:
        """Reads the scene and the panel's settings."""
        settings = properties.settings(context.scene.irpso)
        data = steer.steered(context, obj, scene.read_scene(context, obj.name, captures_path(context.scene)))
        if self.write:
            writable.check(obj, data.mesh)
        self._label = f"{settings.method}, {settings.model}, {settings.size}{', part' if data.region else ''}"
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
        self._live, self._asked = live.LiveMaps(data, settings), (data, settings)
        maps = self._live
        running = session.start(task.start(maps.take), self.bl_label, obj.session_uid)
        running.curve = maps.curve
        with suppress(BadInput):  # looks are welcome, not needed
            running.preview = jobs.preview((replace(data, start=None), settings), maps.take_preview)
            maps.feed = running.preview.feed

    def tick(self, obj: bpy.types.Object) -> bool:
        """What is new of the maps onto the object."""
        running, maps = session.running, self._live
        assert running is not None and maps is not None
        self._held |= running.paused
        fresh, running.live = running.live is not maps.latest, maps.latest
        fresh = maps.show(obj) if self.write else fresh
        if fresh:
            views.refresh()
        return fresh

    def stopped(self) -> Solution | None:
        """What was on show."""
        return None if self._live is None else self._live.solution()

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> Iterator[None]:
        """Keeps the solution, wires the maps, says what happened."""
        solution: Solution = value
        name, uid = obj.name, obj.session_uid
        session.keep(obj, solution, self._label)
        if not (cancelled or self._held or self._live is None):
            estimates.learn(*self._asked, solution, self._live.seconds)
        messages: tuple[str, ...] = ()
        if self.write:
            material.check(obj, solution)
            messages = yield from self._written(uid, solution)
        for warning in (*solution.warnings, *messages):
            self.report({"WARNING"}, warning)
        texels = solution.texels
        outcome = "stopped; kept" if cancelled else "solved"
        self.report({"INFO"}, f"{name}: {outcome} {texels['solved']:,} of {texels['covered']:,} texels")

    def settled(self) -> None:
        """The views show the result instead of the running job."""
        if self._live is not None:
            self._live.drop()
        views.refresh()

    def _written(self, uid: int, solution: Solution) -> Generator[None, None, tuple[str, ...]]:
        """The maps on the object; what the user should know.  An image a step; in the last one all that is linked."""
        layers = material.layers_of(solution.maps)
        uids: dict[str, int] = {}
        for role, array in layers.items():
            obj = session.object_by_uid(uid)
            if obj is None:
                return ()
            shown = {} if self._live is None else self._live.images()
            image = shown.get(role)
            if image is None or image.size[0] != array.shape[0]:
                image = material.loose_image(obj, role, array.shape[0])
            uids[role] = image.session_uid
            material.set_pixels(image, array)
            yield
            image = self._image(uids[role])
            if image is not None:
                image.pack()
                yield
        obj = session.object_by_uid(uid)
        if obj is None:
            return ()
        images = {role: self._image(image_uid) for role, image_uid in uids.items()}
        for role, image in images.items():
            if image is None:  # Undo has taken it meanwhile
                images[role] = material.put_image(obj, role, layers[role])
        material.adopt(obj, images)
        return material.wire_maps(obj, solution, images)

    @staticmethod
    def _image(uid: int) -> bpy.types.Image | None:
        return next((image for image in bpy.data.images if image.session_uid == uid), None)
