"""Open a scene to try IRPSO on, or stop making it."""

import bpy

from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.sample import sample


class IRPSO_OT_sample_scene(bpy.types.Operator):
    """Open a painted vase with pictures, cameras and lights. Cycles renders it the first time, in some seconds"""

    bl_idname = "irpso.sample_scene"
    bl_label = "Sample Scene"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Nothing is running that opening a file would end."""
        if session.running is not None:
            cls.poll_message_set("A job is running: wait, or stop it first")
        elif sample.state.making is not None:
            cls.poll_message_set("The sample scene is being made")
        else:
            return True
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Returns at once; the scene opens when it is there."""
        sample.start()
        if sample.state.error:  # in the window it is told later, in the panel
            self.report({"ERROR"}, sample.state.error)
            return {"CANCELLED"}
        return {"FINISHED"}


class IRPSO_OT_stop_sample(bpy.types.Operator):
    """Stop making the sample scene"""

    bl_idname = "irpso.stop_sample"
    bl_label = "Stop"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """It is being made."""
        return sample.state.making is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ends the second Blender."""
        sample.stop()
        return {"FINISHED"}
