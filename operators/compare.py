"""Compare every method on the active object: error against time, as a chart in the Image Editor."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import bpy

from ..irpso_addon.blender import files, properties
from ..irpso_addon.blender.jobs.jobs import Task
from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.scene import scene
from ..irpso_addon.blender.viewer import editors, views
from ..irpso_addon.compare.measure import figure, hold_out
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.images.reference_image import with_raw_size
from ..irpso_addon.core.reporting.report import write_report
from .helpers.needs_ready_views import NeedsReadyViews
from .helpers.paths import captures_path, out_folder

HOLD_OUT = 5  # every so many a view is predicted, not solved from
PASSES = (100, 400, 1600)  # of the algorithm as published


class IRPSO_OT_compare(NeedsReadyViews, bpy.types.Operator):
    """Solve with every method from four fifths of the views, predict the other views, and chart error against time"""

    bl_idname = "irpso.compare"
    bl_label = "Compare Methods"
    bl_options = {"REGISTER"}

    _shown_message: str | None = None  # the message that the editor shows

    def task(self, context: bpy.types.Context, obj: bpy.types.Object) -> Task:
        """Reads the scene; model and the like are the Solve panel's.  Proves that the report can be saved."""
        chosen = context.window_manager.irpso_views
        if chosen.compare_save:
            out_folder(context.scene.irpso.out)
        settings = replace(properties.settings(context.scene.irpso), size=chosen.compare_size, start="anew")
        data = with_raw_size(scene.read_scene(context, obj.name, captures_path(context.scene)), settings)
        fit, held = hold_out(data, HOLD_OUT, False)
        return Task("compare.measure:measure", (fit, held, None, settings, PASSES if chosen.compare_paper else ()))

    def tick(self, _obj: bpy.types.Object) -> None:
        """Which method is at work."""
        assert session.running is not None
        if session.running.progress.message != self._shown_message:
            self._shown_message = session.running.progress.message
            editors.refresh()

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> Iterator[None]:
        """Shows the chart, saves the report."""
        value["versions"]["blender"] = files.blender_version()
        views.keep_chart(obj, figure(value))
        if not bpy.app.background:
            editors.show(bpy.context)
        yield
        if bpy.context.window_manager.irpso_views.compare_save:
            folder = out_folder(bpy.context.scene.irpso.out)
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise BadInput(f"{folder}: cannot write there ({error.strerror}); choose another folder") from None
            write_report(folder / "compare.json", {**value, "command": [self.bl_idname]})
            self.report({"INFO"}, f"{folder / 'compare.json'}: written")
        editors.refresh()
