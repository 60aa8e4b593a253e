"""Show what the solver sees of the surface: position, normal and coverage per texel."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import bpy
import numpy as np

from ..irpso_addon.blender.jobs.jobs import Task
from ..irpso_addon.blender.material import material, material_preflight
from ..irpso_addon.blender.scene.scene_material import read_normal_maps
from ..irpso_addon.blender.scene.scene_mesh import read_mesh
from ..irpso_addon.core.data import SceneData
from .helpers.modal_job import ModalJob


class IRPSO_OT_bake_gbuffer(ModalJob, bpy.types.Operator):
    """Draw world position, normal and coverage of each texel into float images named after the object"""

    bl_idname = "irpso.bake_gbuffer"
    bl_label = "Bake G-Buffer"
    bl_options = {"UNDO"}

    def task(self, context: bpy.types.Context, obj: bpy.types.Object) -> Task:
        """Reads the object alone, so that UVs can be looked at before there is any view."""
        material_preflight.require_editable(obj, "object")  # else the file would not keep the images
        size = context.scene.irpso.size
        warn = partial(self.report, {"WARNING"})
        mesh = read_mesh(obj, context.evaluated_depsgraph_get(), read_normal_maps(obj, warn), warn)
        data = SceneData(name=obj.name, mesh=mesh, occluders=np.zeros((0, 3, 3), np.float32), views=())
        return Task("solve.one_round:bake_gbuffer", (data, size))

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> Iterator[None]:
        """Writes the images."""
        coverage = value.coverage.astype("f4")
        layers = {"position": value.position, "world_normal": value.normal, "coverage": coverage}
        material.write_images(obj, layers)  # "normal" is the solved normal map
        if obj.override_library is not None:
            self.report({"WARNING"}, f"{obj.name}: is a library override, which does not keep its images when the file "
                                     "is opened again; save them from an Image Editor, or make it local (Object > "
                                     "Relations)")
        self.report({"INFO"}, f"{obj.name}: {int(coverage.sum()):,} of {coverage.size:,} texels are covered")
        yield from ()
