"""Say what is wrong with pictures, cameras and lamps before they are solved."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import bpy

from ..irpso_addon.blender.jobs.jobs import Task
from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.panel_common import redraw_sidebars
from ..irpso_addon.blender.scene import look_through
from ..irpso_addon.blender.scene.scene import read_scene
from ..irpso_addon.blender.shoot import check_sheet
from ..irpso_addon.blender.viewer import editors
from ..irpso_addon.core.checks.shoot_check import ShootCheck
from .helpers.needs_ready_views import NeedsReadyViews
from .helpers.paths import captures_path


class IRPSO_OT_check_shoot(NeedsReadyViews, bpy.types.Operator):
    """Compare some of the pictures with the mesh and the lights, and list what does not fit"""

    bl_idname = "irpso.check_shoot"
    bl_label = "Check Shoot"

    def task(self, context: bpy.types.Context, obj: bpy.types.Object) -> Task:
        """Reads the scene, its lamps as they were before Look Through View."""
        if look_through.is_looking(context.scene):
            look_through.look_back(context.scene)
        return Task("solve.check_shoot:check", (read_scene(context, obj.name, captures_path(context.scene)),))

    def finish(self, obj: bpy.types.Object, value: Any, cancelled: bool) -> Iterator[None]:
        """Keeps what was found, shows the picture."""
        check: ShootCheck = value
        image = check_sheet.to_image(check)
        session.keep_check(obj, replace(check, pictures=()))
        editors.show_still(image)
        for finding in check.findings:
            self.report({"WARNING"}, str(finding))
        self.report({"INFO"}, f"{check.summary}; see image '{image.name}'")
        redraw_sidebars()
        yield from ()
