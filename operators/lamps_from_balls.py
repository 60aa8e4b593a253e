"""Place the lamps that chrome balls mirror."""

import bpy

from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.shoot.ball_lamps import place_lamps
from ..irpso_addon.blender.shoot.ball_list import keep_circles, read_balls
from ..irpso_addon.core.errors import BadInput
from .helpers.needs_balls import NeedsBalls


class IRPSO_OT_lamps_from_balls(NeedsBalls, bpy.types.Operator):
    """Place each lamp by its reflections in the balls. Views without lights get new lights, in the order of the list"""

    bl_idname = "irpso.lamps_from_balls"
    bl_label = "Place Lamps"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """One undo takes everything back."""
        entries = context.scene.irpso.shoot.balls
        try:
            placed = place_lamps(context, read_balls(entries))
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        keep_circles(entries, placed.balls)
        session.drop_checks()
        for line in placed.messages:
            self.report({"INFO"}, line)
        return {"FINISHED"}
