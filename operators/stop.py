"""Stop the running job."""

import bpy

from ..irpso_addon.blender import session


class IRPSO_OT_stop(bpy.types.Operator):
    """Stop the running job and keep what was found; Esc in the viewport does the same"""

    bl_idname = "irpso.stop"
    bl_label = "Stop"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A job is running."""
        return session.running is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Asks the job to stop; the operator that started it delivers what was found."""
        session.cancel_running()
        return {"FINISHED"}
