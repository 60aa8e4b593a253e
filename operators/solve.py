"""Recover the active object's material from the views."""

from typing import Any

import bpy

from ..irpso_addon import pipeline
from ..irpso_addon.blender import indirect, material, properties, scene, session
from ..irpso_addon.core.data import Solution
from ..irpso_addon.gpu.thread import JobFunction
from .modal_job import ModalJob
from .paths import captures_path


class IRPSO_OT_solve(ModalJob, bpy.types.Operator):
    """Recover base colour and roughness of the active object from the reference images"""

    bl_idname = "irpso.solve"
    bl_label = "Solve"
    bl_options = {"REGISTER", "UNDO"}

    # Hidden: in the redo panel a change of it would solve everything again.
    write: bpy.props.BoolProperty(
        name="Write Maps", description="Put the maps on the object's materials when done", default=True,
        options={"HIDDEN", "SKIP_SAVE"})

    def prepare(self, context: bpy.types.Context, obj: bpy.types.Object) -> JobFunction:
        """Reads the scene and the panel's settings."""
        settings = properties.settings(context.scene.irpso)
        data = scene.read_scene(context, obj.name, captures_path(context.scene))
        if settings.indirect == "off":
            return lambda: pipeline.solve(data, settings)
        bounce = indirect.Bouncer.of_copy()
        return lambda: bounce.around(pipeline.solve(data, settings, bounce=bounce))

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> None:
        """Keeps the solution, wires the maps, says what happened."""
        solution: Solution = value
        session.keep(obj, solution)
        messages = material.write_maps(obj, solution) if self.write else ()
        for warning in (*solution.warnings, *messages):
            self.report({"WARNING"}, warning)
        texels = solution.texels
        outcome = "stopped; kept" if cancelled else "solved"
        self.report({"INFO"}, f"{obj.name}: {outcome} {texels['solved']:,} of {texels['covered']:,} texels")
