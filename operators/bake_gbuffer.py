"""Show what the solver sees of the surface: position, normal and coverage per texel."""

from typing import Any

import bpy

from ..irpso_addon import pipeline
from ..irpso_addon.blender import material, scene
from ..irpso_addon.gpu.thread import JobFunction
from .modal_job import ModalJob
from .paths import captures_path


class IRPSO_OT_bake_gbuffer(ModalJob, bpy.types.Operator):
    """Draw world position, normal and coverage of each texel into float images named after the object"""

    bl_idname = "irpso.bake_gbuffer"
    bl_label = "Bake G-Buffer"
    bl_options = {"REGISTER", "UNDO"}

    def prepare(self, context: bpy.types.Context, obj: bpy.types.Object) -> JobFunction:
        """Reads the scene; the size is the panel's."""
        size = context.scene.irpso.size
        data = scene.read_scene(context, obj.name, captures_path(context.scene))
        return lambda: pipeline.bake_gbuffer(data, size)

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> None:
        """Writes the images."""
        coverage = value.coverage.astype("f4")
        material.write_images(obj, {"position": value.position, "normal": value.normal, "coverage": coverage})
        self.report({"INFO"}, f"{obj.name}: {int(coverage.sum()):,} of {coverage.size:,} texels are covered")
