"""Set the lamps' power by a grey card in a picture."""

from collections.abc import Sequence

import bpy

from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.scene.scene import subject_of
from ..irpso_addon.blender.shoot.grey_card import GreyCard, set_power_by_grey_card
from ..irpso_addon.blender.shoot.view_pictures import ListedView, active_view, listed_image
from ..irpso_addon.core.data import F64
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.shoot.picture_marks import Point, dragged_square, square_line
from .helpers.click_in_picture import ClickInPicture
from .helpers.needs_views import NeedsViews


class IRPSO_OT_grey_card(NeedsViews, ClickInPicture, bpy.types.Operator):
    """Set the power of the views' lights by a grey card in the active view's picture. Drag a square on the card"""

    bl_idname = "irpso.grey_card"
    bl_label = "Click Grey Card"
    bl_options = {"REGISTER", "UNDO"}
    prompt = "Drag a square on the grey card, or click its middle."

    view: bpy.props.IntProperty(
        name="View", description="Number of the view that shows the card, from 0; -1: the active view", default=-1,
        min=-1)
    image: bpy.props.StringProperty(
        name="Picture", description="File of the view that shows the card, in place of its number", default="")
    x: bpy.props.FloatProperty(
        name="X", description="Middle of a square on the card, pixels from the picture's left edge", min=0.0)
    y: bpy.props.FloatProperty(
        name="Y", description="Middle of a square on the card, pixels from the picture's upper edge", min=0.0)
    side: bpy.props.FloatProperty(
        name="Side", description="Width and height of the square, pixels", default=20.0, min=1.0)
    reflectance: bpy.props.FloatProperty(
        name="Reflectance", description="Reflectance of the card, as stated by its maker", default=0.18,
        min=0.001, max=1.0)

    def pictures(self, context: bpy.types.Context) -> tuple[ListedView, Sequence[ListedView]]:
        """The active view's."""
        subject_of(context, None)
        shown = active_view(context)
        self.image = str(shown.view.image)
        if not self.properties.is_property_set("reflectance"):
            self.reflectance = context.scene.irpso.shoot.card
        return shown, ()

    def lines(self, start: Point, end: Point, size: tuple[int, int]) -> list[F64]:
        """The square."""
        return [square_line(dragged_square(start, end, size))]

    def keep(self, start: Point, end: Point, size: tuple[int, int]) -> None:
        """The square."""
        self.x, self.y, self.side = dragged_square(start, end, size)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """One undo takes it back."""
        try:
            card = GreyCard(self.image or listed_image(context, self.view), self.x, self.y, self.side, self.reflectance)
            lines = set_power_by_grey_card(context, subject_of(context, None), card)
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        session.drop_checks()
        for line in lines:
            self.report({"INFO"}, line)
        return {"FINISHED"}
