"""The IRPSO tab of the 3D viewport's sidebar, from top to bottom the order of the work."""

from __future__ import annotations

import math
import textwrap
from dataclasses import fields
from pathlib import Path

import bpy
from bpy.types import Panel, UIList

from ..core.checks import Checks
from ..core.data import Solution
from ..core.params import SolveSettings
from . import session

WARNINGS_SHOWN = 4
LETTER_WIDTH = 6.2  # pixels of the panel's font, on average
# Settings that mean something for some choices of another alone: which one, and which choices.
ONLY_FOR = {"specular": ("model", {"one-lobe-specular"}), "ndf": ("model", {"two-lobe", "auto"})} | dict.fromkeys(
    ("particles", "iterations", "c1", "c2", "c3", "window", "threshold"), ("method", {"paper"}))


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


def shown(settings: bpy.types.PropertyGroup, advanced: bool) -> list[str]:
    """The rows of the parameter table that a panel shows: those that the present model and method use."""
    names = [field.name for field in fields(SolveSettings) if field.metadata["advanced"] == advanced]
    others = {name: ONLY_FOR.get(name, ("", set())) for name in names}
    return [name for name, (other, choices) in others.items() if not other or getattr(settings, other) in choices]


class _Tab:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "IRPSO"


class IRPSO_PT_capture(_Tab, Panel):
    """Where the pictures are."""

    bl_label = "Capture"

    def draw(self, context: bpy.types.Context) -> None:
        """captures.json, or the list of views."""
        layout, settings = self.layout, context.scene.irpso
        layout.use_property_split = True
        layout.use_property_decorate = False
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


class IRPSO_PT_solve(_Tab, Panel):
    """What is solved for, and how."""

    bl_label = "Solve"

    def draw(self, context: bpy.types.Context) -> None:
        """Settings, the button, and the progress while it runs."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column()
        column.enabled = session.running is None
        for name in shown(context.scene.irpso, advanced=False):
            column.prop(context.scene.irpso, name)
        column = layout.column()
        column.scale_y = 1.4
        column.operator("irpso.solve", icon="PLAY")
        if session.running is not None:
            progress = session.running.progress
            doing = "stopping" if session.running.stopping else progress.stage
            row = layout.row(align=True)
            row.progress(factor=progress.fraction, text=f"{session.running.title}: {progress.fraction:.0%} {doing}")
            row.operator("irpso.stop", text="", icon="X")


class IRPSO_PT_advanced(_Tab, Panel):
    """Settings that are seldom changed."""

    bl_label = "Advanced"
    bl_parent_id = "IRPSO_PT_solve"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """The table's advanced rows and the G-buffer."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        for name in shown(context.scene.irpso, advanced=True):
            layout.prop(context.scene.irpso, name)
        layout.operator("irpso.bake_gbuffer", icon="TEXTURE")


class IRPSO_PT_result(_Tab, Panel):
    """What came out, and where it goes."""

    bl_label = "Result"

    def draw(self, context: bpy.types.Context) -> None:
        """Summary, write, export."""
        layout, settings = self.layout, context.scene.irpso
        layout.use_property_split = True
        layout.use_property_decorate = False
        solution = session.solution_of(context.active_object)
        if solution is None:
            layout.label(text="Not solved since the file was opened", icon="INFO")
        else:
            letters = max(16, int(context.region.width / context.preferences.system.ui_scale / LETTER_WIDTH) - 9)
            self._draw_summary(layout, context.active_object.name, solution, letters)
        layout.operator("irpso.write_maps", icon="MATERIAL")
        layout.prop(settings, "out")
        layout.prop(settings, "format")
        layout.operator("irpso.export_maps", icon="EXPORT")

    @staticmethod
    def _draw_summary(layout: bpy.types.UILayout, name: str, solution: Solution, letters: int) -> None:
        texels, box = solution.texels, layout.box().column(align=True)
        state = "stopped early" if solution.cancelled else f"{sum(solution.seconds.values()):.1f} s"
        box.label(text=f"{name}: {state}", icon="ERROR" if solution.cancelled else "CHECKMARK")
        box.label(text=f"{texels['solved']:,} of {texels['covered']:,} texels solved", icon="TEXTURE")
        box.label(text=f"{texels['filled']:,} filled from neighbours", icon="BLANK1")
        skipped = f", {len(solution.views_skipped)} skipped" if solution.views_skipped else ""
        box.label(text=f"{len(solution.views_used)} views used{skipped}", icon="CAMERA_DATA")
        for slot, model in solution.model.items():
            level = f" {solution.levels[slot]:.3f}" if slot in solution.levels else ""
            box.label(text=f"{slot or name}: {model}{level}", icon="MATERIAL")
        for warning in solution.warnings[:WARNINGS_SHOWN]:
            _draw_wrapped(box, warning, letters)
        if len(solution.warnings) > WARNINGS_SHOWN:
            box.label(text=f"{len(solution.warnings) - WARNINGS_SHOWN} more in the Info editor", icon="BLANK1")


class IRPSO_PT_checks(_Tab, Panel):
    """What the pictures say of the maps, in figures."""

    bl_label = "Checks"
    bl_parent_id = "IRPSO_PT_result"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only of a solution."""
        solution = session.solution_of(context.active_object)
        return solution is not None and solution.checks is not None

    def draw(self, context: bpy.types.Context) -> None:
        """A row for each figure."""
        solution = session.solution_of(context.active_object)
        assert solution is not None and solution.checks is not None
        column = self.layout.column(align=True)
        for name, value in figures(solution.checks):
            row = column.split(factor=0.5)
            label = row.row()
            label.alignment = "RIGHT"
            label.label(text=name)
            row.label(text=value)


def figures(checks: Checks) -> list[tuple[str, str]]:
    """Name and value of each figure that a user may want to see; the worst of the views, lights and cameras."""
    def percent(value: float) -> str:
        return f"{value:.1%}" if math.isfinite(value) else "unknown"

    rows = [("Noise", percent(checks.noise)), ("Unexplained", percent(checks.structure)),
            ("Doubtful Roughness", percent(checks.doubtful)), ("No Highlight", percent(checks.no_highlight)),
            ("Clipped", percent(checks.clipped)), ("Light in Shadows", percent(checks.unlit_share))]
    if checks.slope:
        rows.append(("Exponent", f"{checks.slope.exponent:.3f}"))
    if checks.registration:
        worst = max(checks.registration, key=lambda m: m.pixels)
        rows.append(("Registration", f"{worst.pixels:.2f} px ({worst.camera})"))
    if checks.lights:
        light = max(checks.lights, key=lambda x: abs(math.log(x.gain)))
        rows.append(("Light Power", f"{light.gain - 1:+.1%} ({light.name})"))
    return rows


def _draw_wrapped(layout: bpy.types.UILayout, text: str, letters: int) -> None:
    """A label does not wrap: one for each line."""
    for row, line in enumerate(textwrap.wrap(text, letters)):
        layout.label(text=line, icon="BLANK1" if row else "ERROR")


CLASSES = (IRPSO_UL_views, IRPSO_PT_capture, IRPSO_PT_solve, IRPSO_PT_advanced, IRPSO_PT_result,
           IRPSO_PT_checks)
