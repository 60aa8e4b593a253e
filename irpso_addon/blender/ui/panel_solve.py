"""The Solve panel: what is solved for, and how."""

from __future__ import annotations

from dataclasses import fields

import bpy
from bpy.types import Panel

from ...core.params import SolveSettings
from .. import preferences, presets
from ..jobs import jobs, solve_region, solve_speed
from ..jobs.session import Running, session
from ..material import material_preflight, material_sharing
from ..panel_common import Tab, letters, split, wrapped
from ..scene import readiness

# Settings that mean something for some choices of another alone: which one, and which choices.
ONLY_FOR = {"specular": ("model", {"one-lobe-specular"}), "ndf": ("model", {"two-lobe", "auto"})} | dict.fromkeys(
    ("particles", "iterations", "c1", "c2", "c3", "window", "threshold"), ("method", {"paper"}))


ELSEWHERE = ("start",)  # drawn by `steer`


def shown(settings: bpy.types.PropertyGroup, advanced: bool) -> list[str]:
    """The rows of the parameter table that a panel shows: those that the present model and method use."""
    names = [field.name for field in fields(SolveSettings) if field.metadata["advanced"] == advanced]
    others = {name: ONLY_FOR.get(name, ("", set())) for name in names}
    return [name for name, (other, choices) in others.items() if not other or getattr(settings, other) in choices]


class IRPSO_PT_solve(Tab, Panel):
    """Settings of the solve."""

    bl_label = "Solve"

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        """The menu of presets."""
        presets.IRPSO_PT_solve_presets.draw_panel_header(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        """Settings, the button, and the progress while it runs."""
        layout = split(self.layout)
        column = layout.column()
        column.enabled = session.running is None
        for name in shown(context.scene.irpso, advanced=False):
            if name not in ELSEWHERE:
                column.prop(context.scene.irpso, name)
        solve_region.draw(column, context)
        if session.running is not None:
            draw_running(layout, session.running)
            draw_unseen(layout, context)
            return
        _draw_shared(layout, context)
        column = layout.column()
        column.scale_y = 1.4
        count = len(readiness.solve_objects(context))
        why_not = readiness.why_not(context)
        unfit = None if why_not else _unfit(context)
        last = session.facts_of(session.subject(context))
        column.active_default = why_not is None and unfit is None and (last is None or last.cancelled)
        column.operator("irpso.solve", text=f"Solve {count} Objects" if count > 1 else "Solve", icon="PLAY")
        if session.device_trouble:
            preferences.draw_offer(layout)
        solve_speed.draw(layout, context)
        readiness.draw(layout, context, [unfit] if unfit else [])
        if why_not is None:
            jobs.warm_soon()


def _unfit(context: bpy.types.Context) -> str | None:
    """Why the maps could not go onto the active object."""
    active = context.active_object
    return material_preflight.why_not(active) if active is not None and active.type == "MESH" else None


def _draw_shared(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """That other objects use a material too, and what becomes of it."""
    shared = {name: others for obj in readiness.solve_objects(context)
              for name, others in material_sharing.shared_with(obj).items()}
    if not shared:
        return
    name, others = next(iter(shared.items()))
    column = layout.column(align=True)
    more = f" (and {len(shared) - 1} more materials)" if len(shared) > 1 else ""
    text = f"Material '{name}' is used by {material_sharing.named(others)} too{more}"
    wrapped(column, text, letters(context), "INFO")
    column.row().prop(context.scene.irpso, "shared_material", expand=True)


def draw_unseen(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Where this viewport shows no materials: the button that makes it."""
    shading = getattr(context.space_data, "shading", None)
    if shading is None or shading.type in ("MATERIAL", "RENDERED") or (
            shading.type == "SOLID" and shading.color_type == "TEXTURE"):
        return
    column = layout.column(align=True)
    wrapped(column, "This viewport shows no materials", letters(context), "INFO")
    column.operator("irpso.show_in_viewport", icon="MATERIAL")


def draw_running(layout: bpy.types.UILayout, running: Running) -> None:
    """The bar of a running job, with Pause and Stop."""
    row = layout.row(align=True)
    row.progress(factor=running.time.fraction, text=running.words())
    row.operator("irpso.pause", text="", icon="PLAY" if running.paused else "PAUSE", depress=running.paused)
    row.operator("irpso.stop", text="", icon="X")


class IRPSO_PT_advanced(Tab, Panel):
    """Settings for special cases."""

    bl_label = "Advanced"
    bl_parent_id = "IRPSO_PT_solve"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """The table's advanced rows; for developers the G-buffer."""
        layout = split(self.layout)
        for name in shown(context.scene.irpso, advanced=True):
            layout.prop(context.scene.irpso, name)
        if context.preferences.view.show_developer_ui:  # for whoever looks into a solve
            layout.operator("irpso.bake_gbuffer", icon="TEXTURE")


CLASSES = (IRPSO_PT_solve, IRPSO_PT_advanced)
