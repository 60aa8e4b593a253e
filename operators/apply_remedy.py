"""Carry out what would put a warning right."""

import bpy

from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.scene.apply_remedy import apply_remedy
from ..irpso_addon.core.errors import BadInput
from .helpers.needs_solution import NeedsSolution


class IRPSO_OT_apply_remedy(NeedsSolution, bpy.types.Operator):
    """Make this change to the scene. Solve again afterwards"""

    bl_idname = "irpso.apply_remedy"
    bl_label = "Apply Remedy"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    index: bpy.props.IntProperty(name="Remedy", min=0, description="Number of the remedy in the last result")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Once for each solution: the scene remembers it, so that undo brings the button back."""
        self.solution(self.subject(context))
        remedy = session.open_remedies(context.scene, self.subject(context)).get(self.index)
        if remedy is None:
            self.report({"ERROR"}, "There is no such remedy left; solve again")
            return {"CANCELLED"}
        try:
            apply_remedy(context.scene, remedy)
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        session.note_remedy(context.scene, self.subject(context), self.index)
        session.drop_checks()
        self.report({"INFO"}, f"{remedy.label}: done; solve again")
        return {"FINISHED"}
