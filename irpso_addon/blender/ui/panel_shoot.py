"""The Shoot panel: what a photographer has, in the order in which it is asked for; what is missing; the check."""

from __future__ import annotations

import bpy
from bpy.types import Panel

from ...core.phrases import percent
from ..jobs.session import session
from ..panel_common import Tab, letters, split, wrapped
from ..shoot.steps import Step, steps

FLASH = ("flash_right", "flash_above", "flash_front", "flash_size", "flash_power")
STEP = 0.66  # of the width that a step's text takes beside a button


class IRPSO_PT_shoot(Tab, Panel):
    """Files and lighting of a shoot."""

    bl_label = "Shoot"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Cameras, pictures, mesh, light, scale; then the button; after the import, whether brightness is absolute."""
        layout, shoot = split(self.layout), context.scene.irpso.shoot
        for name in ("project", "images", "mesh", "colors", "scale", "rig"):
            layout.prop(shoot, name)
        if shoot.rig == "flash":
            column = layout.column(align=True)
            column.use_property_split = False  # long names have room inside their fields
            for name in FLASH:
                column.prop(shoot, name)
        layout.operator("irpso.import_shoot", icon="IMPORT")
        if context.scene.irpso.photographs:  # what the user may find out after the import
            layout.prop(context.scene.irpso, "scale_known")
        row = layout.row()
        row.use_property_split = False
        row.prop(shoot, "card")
        layout.prop(shoot, "chart")
        row = layout.row(align=True)
        row.operator("irpso.grey_card", icon="EYEDROPPER")
        row.operator("irpso.grey_chart", icon="COLOR")


class IRPSO_PT_balls(Tab, Panel):
    """Chrome balls in the pictures, by which lamps are placed."""

    bl_label = "Lamps from Chrome Balls"
    bl_parent_id = "IRPSO_PT_shoot"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A flash on the camera needs none."""
        return context.scene.irpso.shoot.rig == "lamps"

    def draw(self, context: bpy.types.Context) -> None:
        """A box for each ball; then the buttons in the order in which they are pressed."""
        layout = split(self.layout)
        for index, ball in enumerate(context.scene.irpso.shoot.balls):
            column = layout.box().column(align=True)
            row = column.row(align=True)
            row.prop(ball, "camera")
            row.operator("irpso.remove_ball", text="", icon="X").index = index
            column.operator("irpso.draw_ball", icon="MESH_CIRCLE").index = index
            for name in ("x", "y", "circle", "drawn", "radius"):
                column.prop(ball, name)
            if ball.support > 0:
                column.label(text=f"{percent(ball.support)} of the outline shows, {ball.residual:.2f} pixels off")
        layout.operator("irpso.add_ball", icon="ADD")
        row = layout.row(align=True)
        row.operator("irpso.find_balls", icon="VIEWZOOM")
        row.operator("irpso.lamps_from_balls", icon="LIGHT")


class IRPSO_PT_shoot_check(Tab, Panel):
    """Missing parts of a shoot, and the check of its views."""

    bl_label = "Readiness and Check"
    bl_parent_id = "IRPSO_PT_shoot"

    def draw(self, context: bpy.types.Context) -> None:
        """A line for each step; below the check's button its figures, and a line for each thing that is wrong."""
        layout = self.layout
        todo = steps(context)
        first = next((step for step in todo if not step.done), None)  # the one thing in red: what is next
        for step in todo:
            _draw_step(layout, context, step, step is first)
        row = layout.row(align=True)
        row.operator("irpso.check_shoot", icon="VIEWZOOM")
        row.operator("irpso.show_check", text="", icon="IMAGE_DATA")
        check = session.check_of(context.active_object)
        if check is None:
            return
        column = layout.column(align=True)
        wrapped(column, check.summary, letters(context), "INFO")
        for finding in check.findings:
            wrapped(column, str(finding), letters(context))


def _draw_step(layout: bpy.types.UILayout, context: bpy.types.Context, step: Step, first: bool) -> None:
    row = layout.row() if step.mend is None else layout.split(factor=STEP)
    width = letters(context) if step.mend is None else int(STEP * letters(context)) - 2
    lines = row.column(align=True)
    lines.alert = first
    wrapped(lines, step.text, width, "CHECKMARK" if step.done else "ERROR")
    if step.mend is not None:
        name, text = step.mend
        button = row.row()
        button.active_default = first
        button.operator(name, text=text)


CLASSES = (IRPSO_PT_shoot, IRPSO_PT_balls, IRPSO_PT_shoot_check)
