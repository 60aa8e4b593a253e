"""Add views to the scene's list, from cameras."""

from collections.abc import Iterator
from pathlib import Path

import bpy

from ..irpso_addon.core.phrases import counted
from .helpers.paths import stored

LINEAR = {".exr", ".hdr"}  # files whose values a solve takes for linear by itself; others for sRGB


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
        fresh = [(cam, image, space) for cam in cameras for image, space in _backgrounds(cam)
                 if (cam, image) not in have]
        for camera, image, space in fresh:
            view = settings.views.add()
            view.camera, view.image, view.colorspace = camera, image, space
            settings.active_view = len(settings.views) - 1
        self.report({"INFO"}, f"added {counted(len(fresh), 'view')}")
        return {"FINISHED"} if fresh else {"CANCELLED"}


def _backgrounds(camera: bpy.types.Object) -> Iterator[tuple[str, str]]:
    """Paths and color spaces of the camera's background images; one without either where it has none."""
    images = [slot.image for slot in camera.data.background_images if slot.source == "IMAGE" and slot.image]
    yield from ((_path(image), _space(image)) for image in images) if images else [("", "")]


def _path(image: bpy.types.Image) -> str:
    """As this file keeps it; a linked image's is relative to its library."""
    if image.library is None or not image.filepath:
        return image.filepath
    return stored(Path(bpy.path.abspath(image.filepath, library=image.library)))


def _space(image: bpy.types.Image) -> str:
    """Where somebody has chosen another than the file's suffix tells; Blender knows none of a missing file."""
    name = image.colorspace_settings.name
    usual = "Linear Rec.709" if Path(image.filepath).suffix.lower() in LINEAR else "sRGB"
    return "" if name == usual or not image.size[0] else name
