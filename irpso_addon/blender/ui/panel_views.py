"""The IRPSO tab of the Image Editor's sidebar: what it shows of a solve, while it runs and after."""

from __future__ import annotations

import math

import bpy
from bpy.types import Menu, Panel

from ...core.data import ViewPicture
from ...core.evaluation import chart_data
from ...core.phrases import percent
from ..jobs.session import session
from ..panel_common import letters, split, wrapped
from ..viewer import editors, views


class ViewsTab:
    """Mix-in: a panel of the IRPSO tab in the Image Editor's sidebar."""

    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "UI"
    bl_category = "IRPSO"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Where ours is shown."""
        return editors.is_ours(context.space_data.image)


class IRPSO_PT_open(ViewsTab, Panel):
    """Button that shows the viewer in this editor."""

    bl_label = "Viewer"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Where ours is not shown."""
        return not editors.is_ours(context.space_data.image)

    def draw(self, context: bpy.types.Context) -> None:
        """The button alone."""
        self.layout.operator("irpso.show_views", icon="IMAGE_DATA")


class IRPSO_PT_views(ViewsTab, Panel):
    """Choice of the maps, predictions or results to show."""

    bl_label = "Viewer"

    def draw(self, context: bpy.types.Context) -> None:
        """What to show, and what belongs to it."""
        layout, chosen = split(self.layout), context.window_manager.irpso_views
        obj, known = views.subject(context), views.look(context)
        row = layout.row(align=True)
        row.label(text=obj.name if obj else "No active object", icon="OBJECT_DATA")
        if known is not None and known.running:
            row.label(text="Solving", icon="SORTTIME")
        _choices(layout, chosen, "show", 2)
        {"MAPS": self._maps, "VIEWS": self._views, "RESULTS": self._results, "CHART": self._chart}[chosen.show](
            layout, context, chosen)

    @staticmethod
    def _maps(layout: bpy.types.UILayout, _context: bpy.types.Context, chosen: bpy.types.PropertyGroup) -> None:
        _choices(layout, chosen, "map", 2)

    @staticmethod
    def _views(layout: bpy.types.UILayout, context: bpy.types.Context, chosen: bpy.types.PropertyGroup) -> None:
        _choices(layout, chosen, "picture", 2)
        shown, known = views.picture(context), views.look(context)
        if shown is None or known is None:
            layout.label(text="No view yet", icon="INFO")
            return
        count = len(known.pictures)
        index = min(chosen.view, count - 1)
        row = layout.row(align=True)
        _step(row, "TRIA_LEFT", (index - 1) % count)
        row.menu("IRPSO_MT_pictures", text=f"{index + 1}/{count}  {shown.view}")
        _step(row, "TRIA_RIGHT", (index + 1) % count)
        box = layout.box().column(align=True)
        box.label(text=shown.camera, icon="CAMERA_DATA")
        wrapped(box, ", ".join(shown.lights) or "No light", letters(context), icon="LIGHT")
        box.label(text=_percent(shown), icon="DRIVER_DISTANCE")

    @staticmethod
    def _results(layout: bpy.types.UILayout, context: bpy.types.Context, chosen: bpy.types.PropertyGroup) -> None:
        both = views.pair(context)
        if both is None:
            wrapped(layout.column(align=True), "Solve again, for example with another method or model, to compare two "
                                               "results",
                    letters(context), icon="INFO")
            return
        _choices(layout, chosen, "compared", 2)
        _choices(layout, chosen, "contrast", 2)
        results = session.results_of(views.subject(context))
        for slot, result in zip("AB", both, strict=True):
            row = layout.row(align=True)
            row.menu(f"IRPSO_MT_result_{slot.lower()}", text=f"{slot}: {result.label}")
            button = row.row(align=True)
            button.enabled = result is not results[-1] and session.running is None
            button.operator("irpso.restore_result", text="", icon="LOOP_BACK").index = results.index(result)
        a, b = (result.solution for result in both)
        apart = views.figures(a.maps, b.maps)
        column = layout.box().column(align=True)
        _figure(column, "Base Color", f"{apart.base_rms:.4f} RMS")
        _figure(column, "Roughness", f"{apart.rough_mean:.4f} mean")
        _figure(column, "95 % Below", f"{apart.rough_high:.4f}")
        _figure(column, "Compared", f"{percent(apart.texels)} of texels")
        _figure(column, "A / B Seconds", f"{sum(a.seconds.values()):.1f} / {sum(b.seconds.values()):.1f}")
        _figure(column, "A / B Residual", f"{percent(a.residual, 2)} / {percent(b.residual, 2)}")

    @staticmethod
    def _chart(layout: bpy.types.UILayout, context: bpy.types.Context, chosen: bpy.types.PropertyGroup) -> None:
        column = layout.column()
        column.enabled = session.running is None
        column.prop(chosen, "compare_size")
        column.prop(chosen, "compare_paper")
        column.prop(chosen, "compare_save")
        column = layout.column()
        column.scale_y = 1.2
        column.operator("irpso.compare", icon="GRAPH")
        running = session.running
        if running is not None:
            row = layout.row(align=True)
            row.progress(factor=running.time.fraction, text=f"{running.progress.message or running.progress.stage}")
            row.operator("irpso.stop", text="", icon="X")
        made = views.chart(context)
        if made is not None:
            _table(layout.box().column(align=True), made.panels[0])


class IRPSO_PT_display(ViewsTab, Panel):
    """Exposure, error scale, and position of the line."""

    bl_label = "Display"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Of a map or a picture."""
        return super().poll(context) and context.window_manager.irpso_views.show != "CHART"

    def draw(self, context: bpy.types.Context) -> None:
        """Those that what is shown uses."""
        layout, chosen = split(self.layout), context.window_manager.irpso_views
        plate = views.plate(context)
        kind = "" if plate is None else plate.kind
        column = layout.column()
        column.enabled = kind == "color"
        column.prop(chosen, "exposure")
        column = layout.column()
        column.enabled = kind in ("heat", "relative", "difference")
        column.prop(chosen, "scale", slider=True)
        column = layout.column()
        column.enabled = plate is not None and plate.wipe
        column.prop(chosen, "wipe", slider=True)
        column = layout.column()
        column.enabled = chosen.show in ("MAPS", "VIEWS")
        column.prop(chosen, "curve")


def _choices(layout: bpy.types.UILayout, chosen: bpy.types.PropertyGroup, name: str, columns: int) -> None:
    """All items of an enumeration, so many in a row, as wide as the panel."""
    column = layout.column(align=True)
    column.use_property_split = False
    items = chosen.bl_rna.properties[name].enum_items
    for first in range(0, len(items), columns):
        row = column.row(align=True)
        for item in items[first:first + columns]:
            row.prop_enum(chosen, name, item.identifier)


def _step(row: bpy.types.UILayout, icon: str, to: int) -> None:
    button = row.operator("wm.context_set_int", text="", icon=icon)
    button.data_path, button.value = "window_manager.irpso_views.view", to


def _table(column: bpy.types.UILayout, panel: chart_data.Panel) -> None:
    """Method, seconds, error."""
    rows = [("Method", "Seconds", "Error")]
    for curve in panel.curves:
        for i, value in enumerate(curve.values):
            name = f"{curve.label} {curve.notes[i]}" if curve.notes else curve.label
            rows.append((name, f"{curve.seconds[i]:.1f}" if curve.seconds else "", f"{value:.2f} %"))
    for name, seconds, error in rows:
        row = column.split(factor=0.5)
        row.label(text=name)
        for text in (seconds, error):
            cell = row.row()
            cell.alignment = "RIGHT"
            cell.label(text=text)


def _figure(column: bpy.types.UILayout, name: str, value: str) -> None:
    row = column.split(factor=0.4)
    label = row.row()
    label.alignment = "RIGHT"
    label.label(text=name)
    row.label(text=value)


def _percent(shown: ViewPicture) -> str:
    value = views.error(shown)
    return f"Prediction off by {percent(value, 1)}" if math.isfinite(value) else "Nothing to compare"


class IRPSO_MT_pictures(Menu):
    """List of every view."""

    bl_label = "View"

    def draw(self, context: bpy.types.Context) -> None:
        """Its number, file and camera."""
        known = views.look(context)
        for i, picture in enumerate(known.pictures if known else ()):
            row = self.layout.operator("wm.context_set_int", text=f"{i + 1}  {picture.view}  ({picture.camera})")
            row.data_path, row.value = "window_manager.irpso_views.view", i


class _ResultMenu:
    bl_label = "Result"
    slot = ""

    def draw(self, context: bpy.types.Context) -> None:
        """The newest first."""
        for i, result in enumerate(reversed(session.results_of(views.subject(context)))):
            row = self.layout.operator("wm.context_set_int", text=result.label)
            row.data_path, row.value = f"window_manager.irpso_views.{self.slot}", i


class IRPSO_MT_result_a(_ResultMenu, Menu):
    """The result left of the line."""

    slot = "first"


class IRPSO_MT_result_b(_ResultMenu, Menu):
    """The result right of the line."""

    slot = "second"


CLASSES = (IRPSO_MT_pictures, IRPSO_MT_result_a, IRPSO_MT_result_b, IRPSO_PT_open, IRPSO_PT_views, IRPSO_PT_display)
