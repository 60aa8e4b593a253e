"""Have the viewport show materials."""

import bpy


class IRPSO_OT_show_in_viewport(bpy.types.Operator):
    """Show the result in this viewport: Material Preview, which shows materials where Solid shows one grey"""

    bl_idname = "irpso.show_in_viewport"
    bl_label = "Show in Viewport"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """In a viewport."""
        return context.space_data is not None and context.space_data.type == "VIEW_3D"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Nothing of the file but this editor's shading is changed."""
        context.space_data.shading.type = "MATERIAL"
        return {"FINISHED"}
