"""Draw the circle of a chrome ball in a picture."""

from collections.abc import Sequence

import bpy

from ..irpso_addon.blender.shoot.ball_list import draw_circle
from ..irpso_addon.blender.shoot.view_pictures import ListedView, active_view, listed_image, listed_views
from ..irpso_addon.core.data import F64
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.shoot.picture_marks import Point, circle_line, dragged_circle
from .helpers.click_in_picture import ClickInPicture
from .helpers.needs_balls import NeedsBalls


class IRPSO_OT_draw_ball(NeedsBalls, ClickInPicture, bpy.types.Operator):
    """Drag a circle from the middle of this chrome ball to its rim, in a picture of its camera"""

    bl_idname = "irpso.draw_ball"
    bl_label = "Draw Circle"
    bl_options = {"REGISTER", "UNDO"}
    prompt = "Drag from the middle of the ball to its rim. The wheel zooms."
    two_clicks = True

    index: bpy.props.IntProperty(name="Index", description="Place of the ball in the list", min=0)
    image: bpy.props.StringProperty(
        name="Picture", description="File of the view that shows the ball; empty: the active view", default="")
    x: bpy.props.FloatProperty(
        name="X", description="Middle of the circle, pixels from the picture's left edge", precision=1)
    y: bpy.props.FloatProperty(
        name="Y", description="Middle of the circle, pixels from the picture's upper edge", precision=1)
    circle: bpy.props.FloatProperty(name="Circle", description="Radius of the circle, pixels", min=0.0, precision=1)

    def pictures(self, context: bpy.types.Context) -> tuple[ListedView, Sequence[ListedView]]:
        """Of the ball's camera, the active view first if it can be; without a camera, of the active view's."""
        balls = context.scene.irpso.shoot.balls
        if self.index >= len(balls):
            raise BadInput(f"ball {self.index + 1}: is not in the list")
        shown = active_view(context, balls[self.index].camera)
        self.image = str(shown.view.image)
        return shown, [view for view in listed_views(context) if view.entry.camera == shown.entry.camera]

    def lines(self, start: Point, end: Point, size: tuple[int, int]) -> list[F64]:
        """The circle."""
        return [circle_line(dragged_circle(start, end))]

    def keep(self, start: Point, end: Point, size: tuple[int, int]) -> None:
        """The circle."""
        self.x, self.y, self.circle = dragged_circle(start, end)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """One undo takes it back."""
        try:
            draw_circle(context, self.index, self.image or listed_image(context, -1), (self.x, self.y, self.circle))
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}
