"""Take a light out of a view."""

import bpy


class IRPSO_OT_remove_view_light(bpy.types.Operator):
    """Remove this light from the active view. Every light that renders lights a view without lights"""

    bl_idname = "irpso.remove_view_light"
    bl_label = "Remove Light"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    index: bpy.props.IntProperty(name="Index", description="Place of the light in the view", min=0)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The active view has lights."""
        settings = context.scene.irpso
        return settings.active_view < len(settings.views) and len(settings.views[settings.active_view].lights) > 0

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Removes it."""
        settings = context.scene.irpso
        lights = settings.views[settings.active_view].lights
        if self.index >= len(lights):
            return {"CANCELLED"}
        lights.remove(self.index)
        return {"FINISHED"}
