"""The Result panel: what came out, and where it goes."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import shorten

import bpy
from bpy.types import Panel

from ...core.checks.check_figures import Level, check_figures
from ...core.data import MaterialPrediction, Solution
from ...core.maps.map_set import MapFiles
from ...core.maps.targets import IRPSO
from ...core.params import choice_name
from ...core.phrases import counted, percent
from ..jobs import solve_object
from ..jobs.session import session
from ..panel_common import Tab, letters, split, wrapped
from .panel_put_right import IRPSO_PT_lamp, IRPSO_PT_put_right
from .panel_solve import draw_unseen

NAMES = 0.5  # of the panel's width
LIGHTS = {Level.NONE: "BLANK1", Level.GOOD: "STRIP_COLOR_04", Level.NEAR: "STRIP_COLOR_03",
          Level.BEYOND: "STRIP_COLOR_01"}


class IRPSO_PT_result(Tab, Panel):
    """Summary, warnings, and export of the last solve."""

    bl_label = "Result"

    def draw(self, context: bpy.types.Context) -> None:
        """Summary, what to do about it, where it goes."""
        layout, settings, obj = split(self.layout), context.scene.irpso, session.subject(context)
        solution = session.facts_of(obj)
        if solution is None or obj is None:
            layout.label(text="Not solved yet", icon="INFO")
            return
        self._draw_summary(layout, obj.name, solution, session.files_of(obj), letters(context))
        _draw_warnings(layout, solution.warnings, letters(context))
        _draw_remedies(layout, context, obj)
        _draw_earlier(layout, obj, solution)
        draw_unseen(layout, context)
        layout.operator("irpso.show_views", icon="IMAGE_DATA")
        if session.running is None and not solve_object.is_placed(obj):
            layout.operator("irpso.write_maps", icon="MATERIAL")
        layout.prop(settings, "out")
        layout.prop(settings, "target")
        if settings.target == IRPSO:  # the others have formats of their own
            layout.prop(settings, "format")
        row = layout.row()
        row.active_default = session.running is None and not solution.cancelled
        row.operator("irpso.export_maps", icon="EXPORT")

    @staticmethod
    def _draw_summary(
        layout: bpy.types.UILayout, name: str, solution: Solution, files: MapFiles | None, width: int,
    ) -> None:
        texels, box = solution.texels, layout.box().column(align=True)
        if not texels:
            box.label(text=f"{name}: maps of an earlier session", icon="CHECKMARK")
            return
        state = "stopped early" if solution.cancelled else f"{sum(solution.seconds.values()):.1f} s"
        box.label(text=f"{name}: {state}", icon="ERROR" if solution.cancelled else "CHECKMARK")
        box.label(text=f"{texels['solved']:,} of {texels['covered']:,} texels solved", icon="TEXTURE")
        how = "still coarse" if solution.cancelled else "filled from neighbours"
        box.label(text=f"{texels['filled']:,} {how}", icon="BLANK1")
        if texels.get("kept"):
            box.label(text=f"{texels['kept']:,} kept from the last result", icon="BLANK1")
        if files is not None:
            box.label(text=f"Files in {files.of('basecolor', files.udims[0]).parent.name}", icon="FILE_FOLDER")
        skipped = f", {len(solution.views_skipped)} skipped" if solution.views_skipped else ""
        box.label(text=f"{len(solution.views_used)} views used{skipped}", icon="CAMERA_DATA")
        for slot, model in solution.model.items():
            level = f" {solution.levels[slot]:.3f}" if slot in solution.levels else ""
            metallic = f", Metallic {solution.metallic[slot]:.3f}" if slot in solution.metallic else ""
            if slot in solution.paint:
                metallic += f", 0 on {percent(solution.paint[slot])}"
            coat = solution.coats.get(slot)
            above = f", coat {coat.weight:.2f} of roughness {coat.roughness:.2f}" if coat else ""
            if slot in solution.diffuse_roughness:
                above = f", Diffuse Roughness {solution.diffuse_roughness[slot]:.2f}"
            box.label(text=f"{slot or name}: {choice_name(model)}{level}{metallic}{above}", icon="MATERIAL")
            if slot in solution.predictions:
                box.label(text=predicted(solution.predictions[slot]), icon="BLANK1")


def _draw_warnings(layout: bpy.types.UILayout, warnings: Sequence[str], width: int) -> None:
    """What each is about, in a line; all of it where that is unfolded."""
    if not warnings:
        return
    header, body = layout.panel("IRPSO_warnings", default_closed=True)
    header.label(text=counted(len(warnings), "Warning"), icon="ERROR")
    column = (layout if body is None else body).column(align=True)
    for warning in warnings:
        if body is not None:
            wrapped(column, warning, width)
        else:
            column.label(text=shorten(warning, width, placeholder="..."), icon="DOT")


def _draw_earlier(layout: bpy.types.UILayout, obj: bpy.types.Object, solution: Solution) -> None:
    """The other results, each with the button that puts it back; open where the last one was stopped."""
    earlier = list(enumerate(session.results_of(obj)))[-2::-1]
    if not earlier:
        return
    header, body = layout.panel("IRPSO_earlier", default_closed=not solution.cancelled)
    header.label(text=counted(len(earlier), "Other Result"))
    if body is None:
        if solution.cancelled:
            index, result = next(((i, r) for i, r in earlier if not r.facts.cancelled), earlier[0])
            layout.operator("irpso.restore_result", text=f"Back to {result.label}", icon="LOOP_BACK").index = index
        return
    column = body.column(align=True)
    for index, result in earlier:
        column.operator("irpso.restore_result", text=result.label, icon="LOOP_BACK").index = index


def _draw_remedies(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """A button for each warning that a change of the scene answers."""
    column = layout.column(align=True)
    for index, remedy in session.open_remedies(context.scene, obj).items():
        column.operator("irpso.apply_remedy", text=remedy.label, icon="MODIFIER").index = index


class IRPSO_PT_checks(Tab, Panel):
    """Figures behind the warnings."""

    bl_label = "Checks"
    bl_parent_id = "IRPSO_PT_result"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only of a solution."""
        solution = session.facts_of(session.subject(context))
        return solution is not None and solution.checks is not None

    def draw(self, context: bpy.types.Context) -> None:
        """A row for each figure: green within its limit, yellow near it, red beyond it."""
        solution = session.facts_of(session.subject(context))
        assert solution is not None and solution.checks is not None
        column = self.layout.column(align=True)
        for figure in check_figures(solution.checks):
            row = column.split(factor=NAMES)
            label = row.row()
            label.alignment = "RIGHT"
            label.label(text=figure.name)
            value = row.column(align=True)
            value.alert = figure.level is Level.BEYOND
            value.label(text=figure.value, icon=LIGHTS[figure.level])
            if figure.worst:
                value.label(text=figure.worst, icon="BLANK1")


def predicted(prediction: MaterialPrediction) -> str:
    """How far the material's model errs about views that were left out."""
    error = prediction.error
    return f"Left-out {prediction.left_out}: {percent(error.relative_rms, 1)} off, {error.lightness:.1f} L*"


CLASSES = (IRPSO_PT_result, IRPSO_PT_put_right, IRPSO_PT_checks, IRPSO_PT_lamp)
