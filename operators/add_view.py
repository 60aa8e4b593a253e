"""Add an empty view to the list."""

import bpy


class IRPSO_OT_add_view(bpy.types.Operator):
    """Add a view of the scene's camera, without an image"""

    bl_idname = "irpso.add_view"
    bl_label = "Add View"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Appends and makes it active."""
        settings = context.scene.irpso
        settings.views.add().camera = context.scene.camera
        settings.active_view = len(settings.views) - 1
        return {"FINISHED"}
