"""Remove views from the scene's list."""

import bpy

from .helpers.needs_views import NeedsViews


class IRPSO_OT_remove_view(NeedsViews, bpy.types.Operator):
    """Remove the active view from the list, or all views"""

    bl_idname = "irpso.remove_view"
    bl_label = "Remove View"
    bl_options = {"REGISTER", "UNDO"}

    all: bpy.props.BoolProperty(name="All", description="Remove all views", default=False, options={"SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Removes, and keeps the next view active."""
        settings = context.scene.irpso
        if self.all:
            settings.views.clear()
        else:
            settings.views.remove(min(settings.active_view, len(settings.views) - 1))
        settings.active_view = max(0, min(settings.active_view, len(settings.views) - 1))
        return {"FINISHED"}
