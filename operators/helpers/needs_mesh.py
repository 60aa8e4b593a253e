"""Mix-in of operators that change the active mesh."""

import bpy


class NeedsMesh:
    """Enabled for a mesh of this file, in Object Mode."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The active object is a mesh with faces that may be changed."""
        obj = context.active_object
        if obj is None or obj.type != "MESH" or context.mode != "OBJECT":
            cls.poll_message_set("Make a mesh object active, in Object Mode")
        elif not (obj.is_editable and obj.data.is_editable):
            cls.poll_message_set("The object is linked from a library: make it local first")
        elif not len(obj.data.polygons):
            cls.poll_message_set("The mesh has no faces")
        else:
            return True
        return False
