"""Show the picture of the last check."""

import bpy

from ..irpso_addon.blender.shoot import check_sheet
from ..irpso_addon.blender.viewer import editors


class IRPSO_OT_show_check(bpy.types.Operator):
    """Show the picture of the last check in an Image Editor, or in a new window if none is open"""

    bl_idname = "irpso.show_check"
    bl_label = "Show Check"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        """There is one."""
        if check_sheet.last_image() is None:
            cls.poll_message_set("Check the shoot first")
            return False
        return not bpy.app.background

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Opens it."""
        image = check_sheet.last_image()
        if image is None:
            return {"CANCELLED"}
        editors.show_still(image, context)
        return {"FINISHED"}
