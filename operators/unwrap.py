"""Give a mesh the UV map that a solve needs."""

import bpy

from ..irpso_addon.blender.shoot.uv_unwrap import unwrap


class IRPSO_OT_unwrap(bpy.types.Operator):
    """Make a UV map and a material, where the active mesh has none"""

    bl_idname = "irpso.unwrap"
    bl_label = "Make UV Map"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh of this file in Object Mode, that is seen: Blender unwraps no other."""
        obj = context.active_object
        if obj is None or obj.type != "MESH" or context.mode != "OBJECT":
            cls.poll_message_set("Make a mesh object active, in Object Mode")
        elif not (obj.is_editable and obj.data.is_editable):
            cls.poll_message_set("The object is linked from a library: make it local first")
        elif not len(obj.data.polygons):
            cls.poll_message_set("The mesh has no faces")
        elif not obj.visible_get():
            cls.poll_message_set("The object is hidden: show it first")
        else:
            return True
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        """One undo takes it back."""
        lines = unwrap(context.active_object)
        for line in lines:
            self.report({"INFO"}, line)
        return {"FINISHED"}
