"""The Capture panel: where the pictures are."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.types import Panel, UIList

from .tab import Tab, split


class IRPSO_UL_views(UIList):
    """Views: on or off, image, camera."""

    def draw_item(self, _context, layout, _data, view, _icon, _active_data, _active_property, _index=0, _flag=0):
        """One line of the list."""
        layout.use_property_split = False  # the panel's; it would leave half of the line empty
        row = layout.row(align=True)
        row.prop(view, "enabled", text="")
        name = Path(view.image.replace("\\", "/")).name
        parts = row.split(factor=0.6)
        parts.label(text=name or "no image", icon="NONE" if name else "ERROR")
        parts.label(text=view.camera.name if view.camera else "no camera", icon="NONE" if view.camera else "ERROR")


class IRPSO_PT_capture(Tab, Panel):
    """Where the pictures are."""

    bl_label = "Capture"

    def draw(self, context: bpy.types.Context) -> None:
        """captures.json, or the list of views."""
        layout, settings = split(self.layout), context.scene.irpso
        layout.prop(settings, "captures")
        if settings.captures:
            layout.operator("irpso.load_captures", icon="IMPORT")
            return
        row = layout.row()
        row.template_list("IRPSO_UL_views", "", settings, "views", settings, "active_view", rows=4)
        buttons = row.column(align=True)
        buttons.operator("irpso.add_views", text="", icon="ADD")
        buttons.operator("irpso.remove_view", text="", icon="REMOVE")
        buttons.separator()
        buttons.operator("irpso.remove_view", text="", icon="TRASH").all = True
        if settings.active_view < len(settings.views):
            self._draw_view(layout, settings.views[settings.active_view])
        else:
            layout.label(text="Views: the cameras' background images", icon="INFO")

    @staticmethod
    def _draw_view(layout: bpy.types.UILayout, view: bpy.types.PropertyGroup) -> None:
        column = layout.column()
        column.active = view.enabled
        column.prop(view, "image")
        column.prop(view, "camera")
        column.prop(view, "exposure")
        column.prop(view, "mask")
        column.prop(view, "colorspace")
        for item in view.lights:
            column.prop(item, "light")
        if not view.lights:
            column.label(text="Lit by every light that renders", icon="LIGHT")
        column.operator("irpso.set_view_lights", icon="LIGHT")


CLASSES = (IRPSO_UL_views, IRPSO_PT_capture)
