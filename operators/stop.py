"""Stop or hold the running job."""

import bpy

from ..irpso_addon.blender.jobs.session import session


class _WhileRunning:
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A job is running."""
        return session.running is not None


class IRPSO_OT_stop(_WhileRunning, bpy.types.Operator):
    """Stop the running job and keep its result so far. Esc in the viewport does the same"""

    bl_idname = "irpso.stop"
    bl_label = "Stop"
    bl_options = {"INTERNAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Stops it; the operator that started it delivers what was found."""
        session.cancel_running()
        return {"FINISHED"}


class IRPSO_OT_pause(_WhileRunning, bpy.types.Operator):
    """Pause or continue the running job. Nothing is lost"""

    bl_idname = "irpso.pause"
    bl_label = "Pause"
    bl_options = {"INTERNAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Holds it after its present step."""
        session.pause_running()
        return {"FINISHED"}
