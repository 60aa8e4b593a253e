"""Add and remove chrome balls."""

import bpy


class IRPSO_OT_add_ball(bpy.types.Operator):
    """Add a chrome ball that the pictures of the scene's camera show"""

    bl_idname = "irpso.add_ball"
    bl_label = "Add Ball"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Appends; the next ball is mostly as large as the last, and by the same camera."""
        balls = context.scene.irpso.shoot.balls
        camera = balls[-1].camera if len(balls) else context.scene.camera
        radius = balls[-1].radius if len(balls) else None
        ball = balls.add()
        ball.camera = camera
        if radius is not None:
            ball.radius = radius
        return {"FINISHED"}


class IRPSO_OT_remove_ball(bpy.types.Operator):
    """Remove this chrome ball from the list"""

    bl_idname = "irpso.remove_ball"
    bl_label = "Remove Ball"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    index: bpy.props.IntProperty(name="Index", description="Place of the ball in the list", min=0)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Removes it."""
        balls = context.scene.irpso.shoot.balls
        if self.index >= len(balls):
            return {"CANCELLED"}
        balls.remove(self.index)
        return {"FINISHED"}
