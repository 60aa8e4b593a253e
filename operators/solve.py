"""Recover the selected objects' materials from the views."""

from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from ..irpso_addon.blender import properties
from ..irpso_addon.blender.jobs import indirect, jobs, live_display, session, solve_region, solve_speed
from ..irpso_addon.blender.jobs.jobs import Task
from ..irpso_addon.blender.material import material, material_preflight
from ..irpso_addon.blender.scene import readiness, scene
from ..irpso_addon.blender.scene.readiness import solve_objects
from ..irpso_addon.blender.viewer import views
from ..irpso_addon.core.data import SceneData, Solution
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.params import SolveSettings
from ..irpso_addon.core.reporting.estimates import check_disk, size_of
from ..irpso_addon.core.tiled import uv_blocks
from ..irpso_addon.core.tiled.work_folder import Work
from ..irpso_addon.solve import tiled_solve
from .helpers.modal_job import ModalJob
from .helpers.paths import absolute, captures_path


class IRPSO_OT_solve(ModalJob, bpy.types.Operator):
    """Recover base colour and roughness of the selected mesh objects from the reference images, one after another"""

    bl_idname = "irpso.solve"
    bl_label = "Solve"
    bl_options = {"UNDO"}  # not REGISTER: to repeat it would hold up the window

    write: bpy.props.BoolProperty(
        name="Write Maps", description="Put the maps on the object's materials when done", default=True,
        options={"HIDDEN", "SKIP_SAVE"})

    _live: live_display.LiveMaps | None = None
    _label = ""
    _folder: Path | None = None  # of the files of large maps; None: the maps go into the .blend
    _work = Path()  # of large maps: what is finished of them
    _subject = ""  # the object's name when the solve began: that of its files
    _udims: tuple[int, ...] = ()
    _kind = "exr"
    _held = False  # was paused: its times say nothing
    _asked: tuple[SceneData, SolveSettings]

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

    def task(self, context: bpy.types.Context, obj: bpy.types.Object) -> Task:
        """Reads the scene and the panel's settings."""
        settings = properties.settings(context.scene.irpso)
        data = solve_region.steered(context, obj, scene.read_scene(context, obj.name, captures_path(context.scene)))
        if self.write:
            material_preflight.check(obj, data.mesh)
        self._label = f"{settings.method}, {settings.model}, {settings.size}{', part' if data.region else ''}"
        name, arguments = self._asked_for(context, data, settings)
        if settings.indirect == "off":
            return Task(name, arguments)
        if not bpy.data.is_dirty:
            bounce = indirect.Bouncer.of_open_file(Path(bpy.data.filepath))
            return Task(name, (*arguments, bounce))
        bounce = indirect.Bouncer.of_copy()
        assert bounce.copy is not None
        return Task(name, (*arguments, replace(bounce, copy=None)), bounce.copy.cleanup)

    def _asked_for(
        self, context: bpy.types.Context, data: SceneData, settings: SolveSettings,
    ) -> tuple[str, tuple[Any, ...]]:
        """The task and its arguments but for the last; large maps become files in the panel's folder."""
        udims, scene_settings = uv_blocks.solved_udims(settings.udim, data.mesh.uvs), context.scene.irpso
        self._folder, self._udims = None, ()
        if not uv_blocks.is_large(settings.size, udims):
            return "solve.pipeline:solve", (data, settings, None)
        tiled_solve.check(data, settings)
        self._udims, self._kind = udims, scene_settings.format
        self._folder, self._subject = Path(absolute(scene_settings.out)), data.mesh.name
        self._work = tiled_solve.work_folder(self._folder, self._subject)
        found = solve_speed.of(context)
        if found is not None:
            check_disk(self._folder, found.disk_bytes, size_of(self._work))
        return "solve.tiled_solve:solve_to", (data, settings, self._folder, self._kind)

    def start(self, task: Task, obj: bpy.types.Object) -> None:
        """The solve in one process, first looks at it in another."""
        data, settings = self._asked = task.arguments[:2]
        if self._folder is not None:  # its plan is what is seen
            settings = replace(settings, size=uv_blocks.layout(settings.size, self._udims).size)
        maps = self._live = live_display.LiveMaps(data, settings)
        running = session.start(task.start(maps.take), self.bl_label, obj.session_uid)
        running.curve = maps.curve
        if self._udims not in ((), (uv_blocks.FIRST_UDIM,)):
            return  # it looks at the 0-1 square
        with suppress(BadInput):  # looks are welcome, not needed
            running.preview = jobs.preview((replace(data, start=None), settings), maps.take_preview)
            maps.feed = running.preview.feed

    def tick(self, obj: bpy.types.Object) -> bool:
        """What is new of the maps onto the object."""
        running, maps = session.running, self._live
        assert running is not None and maps is not None
        self._held |= running.paused
        fresh, running.live = running.live is not maps.latest, maps.latest
        fresh = maps.show(obj) if self.write and self._folder is None else fresh
        if fresh:
            views.refresh()
        return fresh

    def stopped(self) -> Solution | None:
        """What was on show; of large maps nothing, they go on from what is finished."""
        if self._folder is not None and Work.has_plan(self._work):
            self.report({"INFO"}, f"Finished blocks are kept in {self._work}; Solve goes on from there")
        return None if self._live is None or self._folder is not None else self._live.solution()

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> Iterator[None]:
        """Keeps the solution, wires the maps, says what happened."""
        solution: Solution = value
        name, uid = obj.name, obj.session_uid
        files = None
        if self._folder is not None:
            files = material.files_of(self._subject, solution.maps, self._folder, self._kind, self._udims)
        session.keep(obj, solution, self._label, files)
        if not (cancelled or self._held or solution.resumed_blocks or self._live is None):
            solve_speed.learn(*self._asked, solution, self._live.seconds, self._udims or (uv_blocks.FIRST_UDIM,))
        messages: tuple[str, ...] = ()
        if self.write and files is not None:
            messages = material.link_files(obj, solution, files)
        elif self.write:
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
