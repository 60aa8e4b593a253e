"""Load a capture file into the scene's list of views, to look at it and change it by hand."""

from pathlib import Path

import bpy

from ..irpso_addon.blender.glow import is_light
from ..irpso_addon.core.capture.captures import CaptureView, read_captures
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.phrases import counted
from .helpers.paths import captures_path, stored


class IRPSO_OT_load_captures(bpy.types.Operator):
    """Replace the list of views by those of the captures file. Solve then uses the list"""

    bl_idname = "irpso.load_captures"
    bl_label = "Load into List"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A captures file is named."""
        if not context.scene.irpso.captures:
            cls.poll_message_set("Choose a captures.json first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Checks every name first, then fills the list and clears the path."""
        scene = context.scene
        try:
            path = captures_path(scene)
            captured = read_captures(path)
            found = [_objects(scene, view, index, path) for index, view in enumerate(captured)]
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        scene.irpso.views.clear()
        for view, (camera, lights) in zip(captured, found, strict=True):
            item = scene.irpso.views.add()
            item.image, item.mask = stored(view.image), stored(view.mask)
            item.ambient, item.flat = stored(view.ambient), stored(view.flat)
            item.camera, item.exposure, item.colorspace = camera, view.exposure, view.colorspace or ""
            item.vignetting, item.response, item.turn = view.vignetting, view.response, view.turn
            item.shoulder, item.ambient_radiance = view.shoulder, view.ambient_radiance
            item.black_level, item.tint = view.black_level, view.tint
            for light in lights:
                item.lights.add().light = light
        scene.irpso.captures, scene.irpso.active_view = "", 0
        self.report({"INFO"}, f"loaded {counted(len(captured), 'view')} from {path.name}")
        return {"FINISHED"}


def _objects(
    scene: bpy.types.Scene, view: CaptureView, index: int, path: Path,
) -> tuple[bpy.types.Object, list[bpy.types.Object]]:
    """The view's camera and lights.  Raises BadInput."""
    wanted = [(view.camera, "CAMERA"), *((name, "LIGHT") for name in view.lights)]
    for name, kind in wanted:
        obj = scene.objects.get(name)
        if obj is None or not (obj.type == kind or (kind == "LIGHT" and is_light(obj))):
            raise BadInput(f"{path}: view {index}: the scene has no {kind.lower()} '{name}'; correct the name")
    return scene.objects[view.camera], [scene.objects[name] for name in view.lights]
