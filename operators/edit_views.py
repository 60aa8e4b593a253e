"""Exposure, color space and tone curve of all views in the list at once."""

import bpy

from ..irpso_addon.core.images.response import LEAST_RESPONSE, LEAST_SHOULDER, MOST_RESPONSE, MOST_SHOULDER
from ..irpso_addon.core.phrases import counted
from .helpers.needs_views import NeedsViews


class IRPSO_OT_edit_views(NeedsViews, bpy.types.Operator):
    """Set the exposure, the colour space or the tone curve of all views in the list that are in use"""

    bl_idname = "irpso.edit_views"
    bl_label = "Set Exposure, Color Space, Curve"
    bl_options = {"REGISTER", "UNDO"}

    set_exposure: bpy.props.BoolProperty(
        name="Set Exposure", description="Give the views this exposure", default=False, options={"SKIP_SAVE"})
    exposure: bpy.props.FloatProperty(
        name="Exposure", description="Exposure of the images in EV", soft_min=-10.0, soft_max=10.0)
    set_colorspace: bpy.props.BoolProperty(
        name="Set Color Space", description="Give the views this colour space", default=False, options={"SKIP_SAVE"})
    colorspace: bpy.props.StringProperty(
        name="Color Space", description="Color space of the images' values; empty: linear in float files, else sRGB")

    set_curve: bpy.props.BoolProperty(
        name="Set Tone Curve", description="Give the views this response and shoulder", default=False,
        options={"SKIP_SAVE"})
    response: bpy.props.FloatProperty(
        name="Response", description="Exponent of the files' tone curve; linear files: 1",
        default=1.0, min=LEAST_RESPONSE, max=MOST_RESPONSE)
    shoulder: bpy.props.FloatProperty(
        name="Shoulder", description="How many times flatter the files' tone curve is at white than in the dark; "
        "without one: 1", default=1.0, min=LEAST_SHOULDER, max=MOST_SHOULDER, soft_max=50.0)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Begins with those of the active view."""
        settings = context.scene.irpso
        view = settings.views[min(settings.active_view, len(settings.views) - 1)]
        self.exposure, self.colorspace = view.exposure, view.colorspace
        self.response, self.shoulder = view.response, view.shoulder
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, _context: bpy.types.Context) -> None:
        """A row for each, with its switch."""
        for switch, *values in (("set_exposure", "exposure"), ("set_colorspace", "colorspace"),
                                ("set_curve", "response", "shoulder")):
            row = self.layout.row()
            row.prop(self, switch, text="")
            rest = row.column(align=True)
            rest.active = getattr(self, switch)
            for value in values:
                rest.prop(self, value)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Views that are switched off stay as they are."""
        views = [view for view in context.scene.irpso.views if view.enabled]
        for view in views:
            if self.set_exposure:
                view.exposure = self.exposure
            if self.set_colorspace:
                view.colorspace = self.colorspace
            if self.set_curve:
                view.response, view.shoulder = self.response, self.shoulder
        changed = self.set_exposure or self.set_colorspace or self.set_curve
        self.report({"INFO"}, f"Set {counted(len(views), 'view')}" if changed else "Nothing was switched on to be set")
        return {"FINISHED"} if changed else {"CANCELLED"}
