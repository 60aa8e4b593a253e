"""Give a mesh the UV map that a solve needs."""

import bpy

from ..irpso_addon.blender.shoot.uv_unwrap import unwrap
from .helpers.needs_mesh import NeedsMesh


class IRPSO_OT_unwrap(NeedsMesh, bpy.types.Operator):
    """Make a UV map and a material, where the active mesh has none"""

    bl_idname = "irpso.unwrap"
    bl_label = "Make UV Map"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh of this file in Object Mode, that is seen: Blender unwraps no other."""
        if not super().poll(context):
            return False
        if not context.active_object.visible_get():
            cls.poll_message_set("The object is hidden: show it first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """One undo takes it back."""
        lines = unwrap(context.active_object)
        for line in lines:
            self.report({"INFO"}, line)
        return {"FINISHED"}
