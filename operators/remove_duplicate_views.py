"""Remove views whose image the list has already."""

import bpy

from ..irpso_addon.core.capture.file_preview import same_file
from ..irpso_addon.core.phrases import counted
from .helpers.needs_views import NeedsViews


class IRPSO_OT_remove_duplicate_views(NeedsViews, bpy.types.Operator):
    """Keep the first view of each image file and remove the others"""

    bl_idname = "irpso.remove_duplicate_views"
    bl_label = "Remove Duplicates"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Removes from the end, so that places before stay what they are."""
        settings = context.scene.irpso
        files = [same_file(bpy.path.abspath(view.image)) if view.image else None for view in settings.views]
        again = [i for i, file in enumerate(files) if file is not None and file in files[:i]]
        for index in reversed(again):
            settings.views.remove(index)
        settings.active_view -= sum(index <= settings.active_view for index in again)
        self.report({"INFO"}, f"removed {counted(len(again), 'view')}")
        return {"FINISHED"} if again else {"CANCELLED"}
