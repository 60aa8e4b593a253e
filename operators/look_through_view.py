"""Look through a view's camera with its own lamps on, and put everything back."""

import bpy

from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.scene import look_through
from .helpers.needs_views import NeedsViews


class IRPSO_OT_look_through_view(NeedsViews, bpy.types.Operator):
    """Look through the active view's camera, with the lamps on that were on in its picture; F12 then renders it"""

    bl_idname = "irpso.look_through_view"
    bl_label = "Look Through View"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There are views, and no job reads the scene."""
        if session.running is not None:
            cls.poll_message_set("A job is running: wait, or stop it first")
            return False
        return super().poll(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """The scene's camera and its lamps; the viewport looks through the camera."""
        scene = context.scene
        index = min(scene.irpso.active_view, len(scene.irpso.views) - 1)
        view = look_through.named_view(context, index)
        if view is None:
            self.report({"ERROR"}, f"View {index + 1}: has no camera; choose one")
            return {"CANCELLED"}
        look_through.look_through(scene, view)
        _show(context, "CAMERA")
        self.report({"INFO"}, f"{view.camera}: {', '.join(view.lights) or 'no lamp'}")
        return {"FINISHED"}


class IRPSO_OT_look_back(bpy.types.Operator):
    """Put the scene's camera and lamps back as they were before Look Through View"""

    bl_idname = "irpso.look_back"
    bl_label = "Put Lamps and Camera Back"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Something was changed."""
        if not look_through.is_looking(context.scene):
            cls.poll_message_set("Lamps and camera are as they were")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """The viewport leaves the camera."""
        look_through.look_back(context.scene)
        _show(context, "PERSP")
        return {"FINISHED"}


def _show(context: bpy.types.Context, perspective: str) -> None:
    """In the viewport whose button was pressed."""
    region = getattr(context.space_data, "region_3d", None)
    if region is not None and (perspective == "CAMERA" or region.view_perspective == "CAMERA"):
        region.view_perspective = perspective
