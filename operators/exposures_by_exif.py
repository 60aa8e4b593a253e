"""Exposure of the views in the list as their files' EXIF states it."""

import bpy

from ..irpso_addon.blender.scene.view_exposures import left, read_shot, stated
from ..irpso_addon.core.phrases import counted
from .helpers.needs_views import NeedsViews

SAME = 1e-4  # EV: of single floats


class IRPSO_OT_exposures_by_exif(NeedsViews, bpy.types.Operator):
    """Set Exposure of all views in use by time, aperture and ISO of their EXIF. Not for a flash shorter than the \
exposure time, whose light does not depend on the time"""

    bl_idname = "irpso.exposures_by_exif"
    bl_label = "Set Exposures by EXIF"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Views whose EXIF cannot be compared with others keep theirs, and a line names them."""
        views = context.scene.irpso.views
        shots = [read_shot(bpy.path.abspath(view.image)) for view in views]
        changed = {at: value for at, value in stated(context.scene, shots).items()
                   if abs(value - views[at].exposure) > SAME}
        for at, value in changed.items():
            views[at].exposure = value
        self.report({"INFO"}, f"Set Exposure of {counted(len(changed), 'view')} by EXIF" if changed else
                    "EXIF states no other Exposure for any view")
        if line := left(context.scene, shots):
            self.report({"WARNING"}, line)
        return {"FINISHED"} if changed else {"CANCELLED"}
