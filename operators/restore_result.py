"""Put an earlier result back on the active object's materials."""

import bpy

from ..irpso_addon.blender.jobs import solve_object
from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.viewer import editors
from ..irpso_addon.core.errors import BadInput
from .helpers.needs_solution import NeedsSolution


class IRPSO_OT_restore_result(NeedsSolution, bpy.types.Operator):
    """Put this result's maps on the object's materials again; the present one stays in the list"""

    bl_idname = "irpso.restore_result"
    bl_label = "Restore Result"
    bl_options = {"UNDO", "INTERNAL"}

    index: bpy.props.IntProperty(
        name="Result", description="Place in the list of results, the oldest 0", min=0, options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """It becomes the last one, which Export Maps and the panel take."""
        obj = self.subject(context)
        results = session.results_of(obj)
        if self.index >= len(results):
            self.report({"ERROR"}, f"{obj.name}: has no result {self.index + 1}; choose one in the list")
            return {"CANCELLED"}
        result = results[self.index]
        try:
            messages = solve_object.put(obj, result)
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        session.promote(obj, result)
        editors.refresh()
        for message in messages:
            self.report({"WARNING"}, message)
        self.report({"INFO"}, f"{obj.name}: has the result {result.label}")
        return {"FINISHED"}
