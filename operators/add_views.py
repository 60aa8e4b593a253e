"""Add views to the scene's list, from cameras."""

from collections.abc import Iterator

import bpy

from ..irpso_addon.core.phrases import counted


class IRPSO_OT_add_views(bpy.types.Operator):
    """Add a view for each selected camera, or for every camera. Background images become reference images"""

    bl_idname = "irpso.add_views"
    bl_label = "Add from Cameras"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The scene has a camera."""
        if not any(obj.type == "CAMERA" for obj in context.scene.objects):
            cls.poll_message_set("Add a camera to the scene first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Appends what the list does not have yet."""
        settings = context.scene.irpso
        cameras = [obj for obj in context.selected_objects if obj.type == "CAMERA"]
        cameras = cameras or [obj for obj in context.scene.objects if obj.type == "CAMERA"]
        have = {(view.camera, view.image) for view in settings.views}
        fresh = [(cam, image) for cam in cameras for image in _backgrounds(cam) if (cam, image) not in have]
        for camera, image in fresh:
            view = settings.views.add()
            view.camera, view.image = camera, image
            settings.active_view = len(settings.views) - 1
        self.report({"INFO"}, f"added {counted(len(fresh), 'view')}")
        return {"FINISHED"} if fresh else {"CANCELLED"}


def _backgrounds(camera: bpy.types.Object) -> Iterator[str]:
    """Paths of the camera's background images; one empty path where it has none."""
    images = [slot.image.filepath for slot in camera.data.background_images if slot.source == "IMAGE" and slot.image]
    yield from images or [""]
