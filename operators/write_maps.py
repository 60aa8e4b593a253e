"""Put the last solution's maps on the active object's materials."""

import bpy

from ..irpso_addon.blender.jobs import solve_object
from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.core.errors import BadInput
from .helpers.needs_solution import NeedsSolution
from .helpers.paths import out_folder


class IRPSO_OT_write_maps(NeedsSolution, bpy.types.Operator):
    """Connect the last solution's maps to Base Color and Roughness of the object's materials"""

    bl_idname = "irpso.write_maps"
    bl_label = "Write to Material"
    bl_options = {"REGISTER", "UNDO"}

    packed: bpy.props.BoolProperty(
        name="Pack", description="Pack the images into the .blend. Off: save them as EXR in the export folder",
        default=True)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Writes images and nodes; what the user should know goes to the Info editor."""
        obj = self.subject(context)
        try:
            self.solution(obj)
            result = session.results_of(obj)[-1]
            folder = None if self.packed or result.files else out_folder(context.scene.irpso.out)
            messages = solve_object.put(obj, result, self.packed, folder)
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for message in messages:
            self.report({"WARNING"}, message)
        self.report({"INFO"}, f"{obj.name}: maps are on its materials")
        return {"FINISHED"}
