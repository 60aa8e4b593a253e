"""Move the active view in the list."""

import bpy


class IRPSO_OT_move_view(bpy.types.Operator):
    """Move the active view up or down"""

    bl_idname = "irpso.move_view"
    bl_label = "Move View"
    bl_options = {"REGISTER", "UNDO"}

    up: bpy.props.BoolProperty(name="Up", description="Move towards the first view. Off: towards the "
                                                      "last", default=True)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There is something to change places with."""
        if len(context.scene.irpso.views) < 2:
            cls.poll_message_set("The list has fewer than two views")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Moves by one place; not past the ends."""
        settings = context.scene.irpso
        at = settings.active_view
        target = at - 1 if self.up else at + 1
        if not 0 <= target < len(settings.views):
            return {"CANCELLED"}
        settings.views.move(at, target)
        settings.active_view = target
        return {"FINISHED"}
