"""The Result panel: what came out, and where it goes."""

from __future__ import annotations

import math

import bpy
from bpy.types import Panel

from ...core.check_records import Checks
from ...core.data import MaterialPrediction, Solution
from ...core.maps.map_set import MapFiles
from ..jobs.session import session
from ..panel_common import Tab, letters, split, wrapped

WARNINGS_SHOWN = 4


class IRPSO_PT_result(Tab, Panel):
    """What came out, and where it goes."""

    bl_label = "Result"

    def draw(self, context: bpy.types.Context) -> None:
        """Summary, write, export."""
        layout, settings = split(self.layout), context.scene.irpso
        solution = session.solution_of(context.active_object)
        if solution is None:
            layout.label(text="Not solved since the file was opened", icon="INFO")
        else:
            files = session.files_of(context.active_object)
            self._draw_summary(layout, context.active_object.name, solution, files, letters(context))
        layout.operator("irpso.show_views", icon="IMAGE_DATA")
        layout.operator("irpso.write_maps", icon="MATERIAL")
        layout.prop(settings, "out")
        layout.prop(settings, "format")
        layout.operator("irpso.export_maps", icon="EXPORT")

    @staticmethod
    def _draw_summary(
        layout: bpy.types.UILayout, name: str, solution: Solution, files: MapFiles | None, width: int,
    ) -> None:
        texels, box = solution.texels, layout.box().column(align=True)
        state = "stopped early" if solution.cancelled else f"{sum(solution.seconds.values()):.1f} s"
        box.label(text=f"{name}: {state}", icon="ERROR" if solution.cancelled else "CHECKMARK")
        box.label(text=f"{texels['solved']:,} of {texels['covered']:,} texels solved", icon="TEXTURE")
        box.label(text=f"{texels['filled']:,} filled from neighbours", icon="BLANK1")
        if texels.get("kept"):
            box.label(text=f"{texels['kept']:,} kept of the last result", icon="BLANK1")
        if files is not None:
            box.label(text=f"Files in {files.of('basecolor', files.udims[0]).parent.name}", icon="FILE_FOLDER")
        skipped = f", {len(solution.views_skipped)} skipped" if solution.views_skipped else ""
        box.label(text=f"{len(solution.views_used)} views used{skipped}", icon="CAMERA_DATA")
        for slot, model in solution.model.items():
            level = f" {solution.levels[slot]:.3f}" if slot in solution.levels else ""
            metallic = f", Metallic {solution.metallic[slot]:.3f}" if slot in solution.metallic else ""
            box.label(text=f"{slot or name}: {model}{level}{metallic}", icon="MATERIAL")
            if slot in solution.predictions:
                box.label(text=predicted(solution.predictions[slot]), icon="BLANK1")
        for warning in solution.warnings[:WARNINGS_SHOWN]:
            wrapped(box, warning, width)
        if len(solution.warnings) > WARNINGS_SHOWN:
            box.label(text=f"{len(solution.warnings) - WARNINGS_SHOWN} more in the Info editor", icon="BLANK1")


class IRPSO_PT_checks(Tab, Panel):
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


def predicted(prediction: MaterialPrediction) -> str:
    """How far the material's model errs about views that were left out."""
    error = prediction.error
    return f"Left-out {prediction.left_out}: {error.relative_rms:.1%} off, {error.lightness:.1f} L*"


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


CLASSES = (IRPSO_PT_result, IRPSO_PT_checks)
