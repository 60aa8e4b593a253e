"""The panel Put Right: cameras, lamps and exposures that the last solve has corrected, and its button."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
from bpy.types import Panel

from ...core.change_records import Calibration
from ...core.checks.calibration_lines import (
    ambient_row,
    balance_row,
    black_row,
    exposure_row,
    gain_of,
    lamp_rows,
    response_rows,
    size_row,
    sure_lamps,
    vignetting_row,
    world_rows,
)
from ...core.checks.camera_lines import camera_rows, sure_cameras
from ...core.phrases import counted
from ..jobs.session import session
from ..panel_common import Tab, letters, wrapped

SHOWN = 3  # lamps, and cameras
Items = Sequence[tuple[str, Sequence[tuple[str, str]]]]  # names of objects, and their rows
STATES = {
    "applied": ("CHECKMARK", "The scene has them"),
    "outdated": ("INFO", "The scene's cameras or lamps were changed after this solve. Solve again."),
}


class IRPSO_PT_put_right(Tab, Panel):
    """Cameras, lamps and exposures that the last solve corrected."""

    bl_label = "Corrections"
    bl_parent_id = "IRPSO_PT_result"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where something was."""
        solution = session.facts_of(session.subject(context))
        return solution is not None and solution.put_right

    def draw(self, context: bpy.types.Context) -> None:
        """A row for each figure, and the button."""
        solution = session.facts_of(session.subject(context))
        assert solution is not None
        layout, width = self.layout, letters(context)
        if solution.calibration is not None:
            _draw_rows(layout, [("Left-out Views", gain_of(solution.calibration))])
        state = session.calibration_state(context.scene, session.subject(context))
        if state in STATES:
            icon, text = STATES[state]
            wrapped(layout, text, width, icon)
        else:
            layout.operator("irpso.apply_calibration", icon="CHECKMARK")
            layout.prop(context.window_manager.irpso_views, "places")
        cameras = [(camera.camera, camera_rows(camera)) for camera in sure_cameras(solution.cameras)]
        _draw_items(layout, cameras, "Camera")
        rows = _draw_light(layout, solution.calibration, width) if solution.calibration is not None else False
        if rows and context.scene.irpso.captures:
            wrapped(layout, "The capture file keeps its views unchanged", width, "INFO")
        if not (cameras or rows or (solution.calibration and sure_lamps(solution.calibration))):
            wrapped(layout, "Small changes, none certain by itself", width, "INFO")


def _draw_light(layout: bpy.types.UILayout, calibration: Calibration, width: int) -> bool:
    """Rows of lamps, worlds and exposures; whether something of the views is in them."""
    of_views = [row for row in (exposure_row(calibration), balance_row(calibration)) if row is not None]
    shared = [row for row in (size_row(calibration), vignetting_row(calibration), ambient_row(calibration),
                              black_row(calibration))
              if row is not None] + response_rows(calibration) + world_rows(calibration)
    lamps = [(lamp.lights[0], lamp_rows(lamp)) for lamp in sure_lamps(calibration)]
    _draw_items(layout, lamps, "Lamp")
    for what, change, view in of_views:
        _draw_rows(layout, [(what, change)])
        wrapped(layout, view, width, "CAMERA_DATA")
    _draw_rows(layout, shared)
    return bool(of_views or shared)


def _draw_items(layout: bpy.types.UILayout, items: Items, what: str) -> None:
    """Cameras or lamps by their names, those beyond the first in a panel that is closed."""
    for name, rows in items[:SHOWN]:
        _draw_item(layout, name, rows)
    if len(items) > SHOWN:
        header, body = layout.panel(f"IRPSO_more_{what.lower()}s", default_closed=True)
        header.label(text=counted(len(items) - SHOWN, f"More {what}"))
        for name, rows in items[SHOWN:] if body is not None else ():
            _draw_item(body, name, rows)


def _draw_item(layout: bpy.types.UILayout, name: str, rows: Sequence[tuple[str, str]]) -> None:
    """Figures of it, and whether the next solve is to leave it alone."""
    _draw_rows(layout, rows)
    obj = bpy.data.objects.get(name)
    if obj is not None:
        row = layout.split(factor=0.5)
        row.label()
        row.prop(obj, "irpso_keep")


class IRPSO_PT_lamp(Panel):
    """Whether a lamp or camera was measured, beside its other settings."""

    bl_label = "IRPSO"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "data"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Of lamps and cameras alone."""
        return context.object is not None and context.object.type in {"LIGHT", "CAMERA"}

    def draw(self, context: bpy.types.Context) -> None:
        """The one setting."""
        self.layout.prop(context.object, "irpso_keep")


def _draw_rows(layout: bpy.types.UILayout, rows: Sequence[tuple[str, str]]) -> None:
    """Names to the right of their half, figures left of theirs."""
    column = layout.column(align=True)
    for name, value in rows:
        row = column.split(factor=0.5)
        label = row.row()
        label.alignment = "RIGHT"
        label.label(text=name)
        row.label(text=value)
