"""Give the scene the cameras, lamps and exposures that a solve has found."""

import bpy

from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.scene.apply_calibration import apply_calibration
from ..irpso_addon.core.errors import BadInput
from .helpers.needs_solution import NeedsSolution

NOTHING = {
    "none": "The last solve changed no cameras, lamps or exposures",
    "applied": "The scene has these cameras, lamps and exposures already",
    "outdated": "The scene's cameras or lamps were changed after this solve; solve again",
}


class IRPSO_OT_apply_calibration(NeedsSolution, bpy.types.Operator):
    """Set the scene's cameras and lamps and its views' exposures to the values that the last solve found"""

    bl_idname = "irpso.apply_calibration"
    bl_label = "Apply to Scene"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Not during a solve, which has read the scene as it is now."""
        if session.running is not None:
            cls.poll_message_set("A job is running: wait, or stop it first")
            return False
        return super().poll(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Once for each solution: the scene remembers it, so that undo brings the button back."""
        obj = self.subject(context)
        state = session.calibration_state(context.scene, obj)
        if state in NOTHING:
            self.report({"ERROR"}, NOTHING[state])
            return {"CANCELLED"}
        try:
            line = apply_calibration(context.scene, self.solution(obj))
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        session.note_calibration(context.scene, obj)
        session.drop_checks()
        self.report({"INFO"}, line)
        return {"FINISHED"}
