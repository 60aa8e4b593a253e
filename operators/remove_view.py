"""Remove views from the scene's list."""

import bpy


class IRPSO_OT_remove_view(bpy.types.Operator):
    """Remove the active view from the list, or all of them"""

    bl_idname = "irpso.remove_view"
    bl_label = "Remove View"
    bl_options = {"REGISTER", "UNDO"}

    all: bpy.props.BoolProperty(name="All", description="Empty the list", default=False, options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The list has a view."""
        if not context.scene.irpso.views:
            cls.poll_message_set("The list of views is empty")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Removes, and keeps the next view active."""
        settings = context.scene.irpso
        if self.all:
            settings.views.clear()
        else:
            settings.views.remove(min(settings.active_view, len(settings.views) - 1))
        settings.active_view = max(0, min(settings.active_view, len(settings.views) - 1))
        return {"FINISHED"}
