"""Show the solve in an Image Editor."""

import bpy

from ..irpso_addon.blender.viewer import editors


class IRPSO_OT_show_views(bpy.types.Operator):
    """Show maps, predictions and results in this Image Editor, in an open one, or in a new window"""

    bl_idname = "irpso.show_views"
    bl_label = "Show in Image Editor"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There is a window; in the background Blender has one that nobody sees."""
        if bpy.app.background or context.window is None:
            cls.poll_message_set("Blender runs in the background: there is no window to show it in")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Nothing of the file is changed."""
        if context.area is not None and context.area.type == "IMAGE_EDITOR":
            editors.show_in(context.area)
        else:
            editors.show(context)
        return {"FINISHED"}
