"""Put the last solution's maps on the active object's materials."""

from pathlib import Path

import bpy

from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.material import material
from ..irpso_addon.core.errors import BadInput
from .helpers.needs_solution import NeedsSolution
from .helpers.paths import absolute


class IRPSO_OT_write_maps(NeedsSolution, bpy.types.Operator):
    """Wire the last solution's maps into Base Color and Roughness of the object's materials"""

    bl_idname = "irpso.write_maps"
    bl_label = "Write to Material"
    bl_options = {"REGISTER", "UNDO"}

    packed: bpy.props.BoolProperty(
        name="Pack", description="Pack the images into the .blend; else save them as EXR in the export folder",
        default=True)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Writes images and nodes; what the user should know goes to the Info editor."""
        obj = context.active_object
        try:
            solution, files = self.solution(obj), session.files_of(obj)
            folder = None if self.packed or files else Path(absolute(context.scene.irpso.out))
            messages = (material.write_maps(obj, solution, packed=self.packed, directory=folder) if files is None
                        else material.link_files(obj, solution, files))
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for message in messages:
            self.report({"WARNING"}, message)
        self.report({"INFO"}, f"{obj.name}: maps are on its materials")
        return {"FINISHED"}
