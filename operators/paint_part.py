"""Mark the part to solve by hand: into the mode for it, and out of it again."""

import bpy

from ..irpso_addon.blender.jobs import solve_region


class IRPSO_OT_paint_part(bpy.types.Operator):
    """Mark the region to solve: paint weights, paint an image white, or select faces. Click again for Object Mode"""

    bl_idname = "irpso.paint_part"
    bl_label = "Mark Region"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh of this file."""
        obj = context.active_object
        if obj is None or obj.type != "MESH":
            cls.poll_message_set("Make a mesh object active")
        elif not (obj.is_editable and obj.data.is_editable):
            cls.poll_message_set("The object is linked from a library: make it local first")
        elif context.scene.irpso.region == "ALL":
            cls.poll_message_set("Choose first how to mark the region")
        else:
            return True
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Makes the group or image where there is none."""
        obj, settings = context.active_object, context.scene.irpso
        mode = solve_region.MODES[settings.region][0]
        if obj.mode == mode:
            bpy.ops.object.mode_set(mode="OBJECT")
            return {"FINISHED"}
        if settings.region == "GROUP":
            group = obj.vertex_groups.get(settings.region_group) or obj.vertex_groups.new(name="Region")
            settings.region_group, obj.vertex_groups.active_index = group.name, group.index
        elif settings.region == "IMAGE":
            if settings.region_image is None:
                settings.region_image = bpy.data.images.new("Region", settings.size, settings.size)
            paint = context.tool_settings.image_paint
            paint.mode, paint.canvas = "IMAGE", settings.region_image
            # Blender 5 has them for each mode
            unified = getattr(paint, "unified_paint_settings", None) or context.tool_settings.unified_paint_settings
            unified.color, unified.secondary_color = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
        bpy.ops.object.mode_set(mode=mode)
        if settings.region == "FACES":
            context.tool_settings.mesh_select_mode = (False, False, True)
        return {"FINISHED"}
