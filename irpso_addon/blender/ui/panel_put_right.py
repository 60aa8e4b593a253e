"""The panel Put Right: lamps and exposures that the last solve has corrected, and the button that applies them."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
from bpy.types import Panel

from ...core.checks.calibration_lines import (
    ambient_row,
    exposure_row,
    gain_of,
    lamp_rows,
    response_row,
    sure_lamps,
    vignetting_row,
    world_rows,
)
from ...core.data import LampChange
from ...core.phrases import counted
from ..jobs.session import session
from ..panel_common import Tab, letters, wrapped

SHOWN = 3  # lamps
ROWS = 2  # of each
STATES = {
    "applied": ("CHECKMARK", "The scene has them"),
    "outdated": ("INFO", "The scene's lamps were changed after this solve. Solve again."),
}


class IRPSO_PT_put_right(Tab, Panel):
    """Lamps and exposures that the last solve corrected."""

    bl_label = "Corrections"
    bl_parent_id = "IRPSO_PT_result"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where something was."""
        solution = session.facts_of(session.subject(context))
        return solution is not None and solution.calibration is not None

    def draw(self, context: bpy.types.Context) -> None:
        """A row for each figure, and the button."""
        solution = session.facts_of(session.subject(context))
        assert solution is not None and solution.calibration is not None
        calibration, layout, width = solution.calibration, self.layout, letters(context)
        _draw_rows(layout, [("Left-out Views", gain_of(calibration))])
        state = session.calibration_state(context.scene, session.subject(context))
        if state in STATES:
            icon, text = STATES[state]
            wrapped(layout, text, width, icon)
        else:
            layout.operator("irpso.apply_calibration", icon="LIGHT")
        rows, exposures = lamp_rows(calibration), exposure_row(calibration)
        shared = [row for row in (vignetting_row(calibration), ambient_row(calibration), response_row(calibration))
                  if row is not None] + world_rows(calibration)
        lamps = sure_lamps(calibration)
        _draw_lamps(layout, lamps[:SHOWN], rows)
        if len(lamps) > SHOWN:
            header, body = layout.panel("IRPSO_more_lamps", default_closed=True)
            header.label(text=counted(len(lamps) - SHOWN, "More Lamp"))
            if body is not None:
                _draw_lamps(body, lamps[SHOWN:], rows[SHOWN * ROWS:])
        if exposures is not None:
            _draw_rows(layout, [exposures[:2]])
            wrapped(layout, exposures[2], width, "CAMERA_DATA")
        _draw_rows(layout, shared)
        if (exposures or shared) and context.scene.irpso.captures:
            wrapped(layout, "The capture file keeps its views unchanged", width, "INFO")
        if not (rows or exposures or shared):
            wrapped(layout, "Small changes, none certain by itself", width, "INFO")


def _draw_lamps(layout: bpy.types.UILayout, lamps: Sequence[LampChange], rows: Sequence[tuple[str, str]]) -> None:
    """Figures of each, and whether the next solve is to leave it alone."""
    for n, lamp in enumerate(lamps):
        _draw_rows(layout, rows[n * ROWS:(n + 1) * ROWS])
        obj = bpy.data.objects.get(lamp.lights[0])
        if obj is not None:
            row = layout.split(factor=0.5)
            row.label()
            row.prop(obj, "irpso_keep")


class IRPSO_PT_lamp(Panel):
    """Whether a lamp was measured, beside its other settings."""

    bl_label = "IRPSO"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "data"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Of lamps alone."""
        return context.object is not None and context.object.type == "LIGHT"

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
