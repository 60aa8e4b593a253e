"""Say which lights were on in a view."""

import bpy

from ..irpso_addon.blender.glow import is_light


class IRPSO_OT_set_view_lights(bpy.types.Operator):
    """Set the active view's lights to the selected lights and glowing meshes, or to all if none is selected"""

    bl_idname = "irpso.set_view_lights"
    bl_label = "Use Selected Lights"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A view is active."""
        settings = context.scene.irpso
        if settings.active_view >= len(settings.views):
            cls.poll_message_set("Choose a view in the list first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Replaces the view's lights."""
        settings = context.scene.irpso
        view = settings.views[settings.active_view]
        view.lights.clear()
        chosen = [obj for obj in context.selected_objects if is_light(obj)]
        for obj in chosen:
            view.lights.add().light = obj
        self.report({"INFO"}, f"{len(chosen)} lights" if chosen else "every light that renders")
        return {"FINISHED"}
