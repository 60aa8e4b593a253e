"""Sort the list of views."""

from pathlib import PurePath

import bpy

from ..irpso_addon.core.capture.matching import natural
from .helpers.needs_views import NeedsViews


class IRPSO_OT_sort_views(NeedsViews, bpy.types.Operator):
    """Sort the views by camera, then by file name with numbers in order"""

    bl_idname = "irpso.sort_views"
    bl_label = "Sort by Camera and Name"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Moves each view to its place; the active one stays active."""
        settings = context.scene.irpso
        views = settings.views
        keys = [(natural(PurePath(v.camera.name if v.camera else "")), natural(PurePath(v.image))) for v in views]
        order = sorted(range(len(views)), key=lambda i: keys[i])
        active = order.index(settings.active_view) if settings.active_view < len(views) else 0
        at = list(range(len(views)))  # which view stands where while they are moved
        for place, wanted in enumerate(order):
            views.move(at.index(wanted), place)
            at.remove(wanted)
            at.insert(place, wanted)
        settings.active_view = active
        return {"FINISHED"}
