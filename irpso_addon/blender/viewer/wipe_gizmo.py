"""The line of the wipe, to be dragged in the Image Editor."""

from __future__ import annotations

import bpy
from bpy.types import Gizmo, GizmoGroup

from . import editors, views
from .view_draw import image_place

REACH = 10  # pixels at either side of the line


class IRPSO_GT_wipe(Gizmo):
    """The handle; `view_draw` draws it."""

    bl_idname = "IRPSO_GT_wipe"

    def setup(self) -> None:
        """Nothing to prepare."""

    def draw(self, _context: bpy.types.Context) -> None:
        """Drawn with the picture."""

    def test_select(self, context: bpy.types.Context, location: tuple[int, int]) -> int:
        """Whether the mouse is at the line: 0, or -1 for no."""
        place = image_place(context.region)
        line = place.left + context.window_manager.irpso_views.wipe * (place.right - place.left)
        near = abs(location[0] - line) < REACH * context.preferences.system.ui_scale
        return 0 if near and place.bottom <= location[1] <= place.top else -1

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Begins to drag."""
        self.before = context.window_manager.irpso_views.wipe
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event, _tweak: set[str]) -> set[str]:
        """The line follows the mouse."""
        place = image_place(context.region)
        share = (event.mouse_region_x - place.left) / max(place.right - place.left, 1)
        context.window_manager.irpso_views.wipe = min(max(share, 0.0), 1.0)
        return {"RUNNING_MODAL"}

    def exit(self, context: bpy.types.Context, cancel: bool) -> None:
        """Esc puts it back."""
        if cancel:
            context.window_manager.irpso_views.wipe = self.before


class IRPSO_GGT_wipe(GizmoGroup):
    """Where two pictures are wiped."""

    bl_idname = "IRPSO_GGT_wipe"
    bl_label = "Wipe"
    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "WINDOW"
    bl_options = {"PERSISTENT", "SHOW_MODAL_ALL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Ours is shown, and has a line."""
        if not editors.is_ours(context.space_data.image):
            return False
        plate = views.plate(context)
        return plate is not None and plate.wipe

    def setup(self, _context: bpy.types.Context) -> None:
        """One handle."""
        handle = self.gizmos.new(IRPSO_GT_wipe.bl_idname)
        handle.use_draw_modal = True


CLASSES = (IRPSO_GT_wipe, IRPSO_GGT_wipe)
