"""Find the outlines of the listed chrome balls."""

import bpy

from ..irpso_addon.blender.shoot.ball_list import keep_circles, read_balls
from ..irpso_addon.blender.shoot.ball_pictures import find_balls
from ..irpso_addon.blender.shoot.view_pictures import listed_views
from ..irpso_addon.core.errors import BadInput
from .helpers.needs_balls import NeedsBalls


class IRPSO_OT_find_balls(NeedsBalls, bpy.types.Operator):
    """Find the outline of each ball in its camera's pictures: near its circle, or anywhere if the circle is 0"""

    bl_idname = "irpso.find_balls"
    bl_label = "Find Balls"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Fills in the circles."""
        entries = context.scene.irpso.shoot.balls
        try:
            found = find_balls(listed_views(context), read_balls(entries))
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        keep_circles(entries, found)
        for ball in found:
            self.report({"INFO"}, ball.line)
        return {"FINISHED"}
