"""Exposure and color space of all views in the list at once."""

import bpy

from ..irpso_addon.core.phrases import counted
from .helpers.needs_views import NeedsViews


class IRPSO_OT_edit_views(NeedsViews, bpy.types.Operator):
    """Set the exposure or the color space of all views in the list that are in use"""

    bl_idname = "irpso.edit_views"
    bl_label = "Set Exposure and Color Space"
    bl_options = {"REGISTER", "UNDO"}

    set_exposure: bpy.props.BoolProperty(
        name="Set Exposure", description="Give the views this exposure", default=False, options={"SKIP_SAVE"})
    exposure: bpy.props.FloatProperty(
        name="Exposure", description="Exposure of the images in EV", soft_min=-10.0, soft_max=10.0)
    set_colorspace: bpy.props.BoolProperty(
        name="Set Color Space", description="Give the views this color space", default=False, options={"SKIP_SAVE"})
    colorspace: bpy.props.StringProperty(
        name="Color Space", description="Color space of the images' values; empty: linear in float files, else sRGB")

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Begins with those of the active view."""
        settings = context.scene.irpso
        view = settings.views[min(settings.active_view, len(settings.views) - 1)]
        self.exposure, self.colorspace = view.exposure, view.colorspace
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, _context: bpy.types.Context) -> None:
        """A row for each, with its switch."""
        for switch, value in (("set_exposure", "exposure"), ("set_colorspace", "colorspace")):
            row = self.layout.row()
            row.prop(self, switch, text="")
            rest = row.row()
            rest.active = getattr(self, switch)
            rest.prop(self, value)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Views that are switched off stay as they are."""
        views = [view for view in context.scene.irpso.views if view.enabled]
        for view in views:
            if self.set_exposure:
                view.exposure = self.exposure
            if self.set_colorspace:
                view.colorspace = self.colorspace
        changed = self.set_exposure or self.set_colorspace
        self.report({"INFO"}, f"Set {counted(len(views), 'view')}" if changed else "Nothing was switched on to be set")
        return {"FINISHED"} if changed else {"CANCELLED"}
