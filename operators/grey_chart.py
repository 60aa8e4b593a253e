"""Check the pictures' response, find their tone curve, and set the lamps' power, by a chart's six greys."""

from collections.abc import Sequence

import bpy

from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.scene.scene import subject_of
from ..irpso_addon.blender.shoot.grey_chart import GreyChart, read_chart
from ..irpso_addon.blender.shoot.view_pictures import (
    ListedView,
    active_view,
    listed_image,
    listed_views,
    view_or_file,
)
from ..irpso_addon.core.data import F64
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.shoot.picture_marks import Point, chart_lines
from .helpers.click_in_picture import ClickInPicture
from .helpers.needs_views import NeedsViews
from .helpers.paths import absolute


class IRPSO_OT_grey_chart(NeedsViews, ClickInPicture, bpy.types.Operator):
    """Check whether the pictures are linear, and set their tone curve and the lamps' power, by a colour chart in \
Chart's Picture or the active view's. Click its white patch, then its black patch"""

    bl_idname = "irpso.grey_chart"
    bl_label = "Click Six Greys"
    bl_options = {"REGISTER", "UNDO"}
    prompt = "Click the middle of the chart's white patch, then the middle of its black patch."
    two_clicks = True

    image: bpy.props.StringProperty(
        name="Picture", description="File that shows the chart; empty: Chart's Picture, or else that of the active "
        "view", default="")
    white: bpy.props.FloatVectorProperty(
        name="White", description="Middle of the white patch, pixels from the picture's upper left corner", size=2)
    black: bpy.props.FloatVectorProperty(
        name="Black", description="Middle of the black patch, pixels from the picture's upper left corner", size=2)

    def pictures(self, context: bpy.types.Context) -> tuple[ListedView, Sequence[ListedView]]:
        """The one that is chosen for the chart, or the active view's."""
        subject_of(context, None)
        chosen = _chosen(context)
        shown = view_or_file(listed_views(context), chosen) if chosen else active_view(context)
        self.image = str(shown.view.image)
        return shown, ()

    def lines(self, start: Point, end: Point, size: tuple[int, int]) -> list[F64]:
        """The six squares on the line."""
        return chart_lines(start, end)

    def keep(self, start: Point, end: Point, size: tuple[int, int]) -> None:
        """Both ends."""
        self.white, self.black = start, end

    def execute(self, context: bpy.types.Context) -> set[str]:
        """One undo takes it back."""
        try:
            image = self.image or _chosen(context) or listed_image(context, -1)
            found = read_chart(context, subject_of(context, None),
                               GreyChart(image, tuple(self.white), tuple(self.black)))
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        session.drop_checks()
        for line in found.messages:
            self.report({"INFO"}, line)
        self.report({"INFO"} if found.linear else {"WARNING"}, found.response)
        return {"FINISHED"}


def _chosen(context: bpy.types.Context) -> str:
    """The picture that the panel names; empty: none."""
    return absolute(context.scene.irpso.shoot.chart)
