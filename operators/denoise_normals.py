"""Take the noise of a scan's corners out of its normals."""

import bpy

from ..irpso_addon.blender.scene.mesh_noise import take_out_noise
from .helpers.needs_mesh import NeedsMesh


class IRPSO_OT_denoise_normals(NeedsMesh, bpy.types.Operator):
    """Shade the active mesh smooth and average its normals with their neighbors', as long as that takes away noise.

    Vertices and faces stay as they are
    """

    bl_idname = "irpso.denoise_normals"
    bl_label = "Denoise Normals"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh of this file in Object Mode whose own normals are those that are seen."""
        if not super().poll(context):
            return False
        obj = context.active_object
        if len(obj.modifiers) or obj.data.shape_keys is not None:
            cls.poll_message_set("Modifiers and shape keys make normals of their own: apply them first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """One undo takes it back."""
        obj = context.active_object
        flat = not any(face.use_smooth for face in obj.data.polygons) and not obj.data.has_custom_normals
        if flat:
            obj.data.shade_smooth()
        noisy = take_out_noise(obj.data)
        if not (flat or noisy):
            self.report({"WARNING"}, f"'{obj.name}': its normals have no such noise, or its edges are sharp")
            return {"CANCELLED"}
        self.report({"INFO"}, f"'{obj.name}': " + " and ".join(
            ["it was shaded smooth"] * flat + ["noise was taken out of its normals"] * noisy))
        return {"FINISHED"}
