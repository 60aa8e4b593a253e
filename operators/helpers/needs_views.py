"""Mix-in of operators that work on the scene's list of views."""

import bpy


class NeedsViews:
    """Enabled when the list has a view."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The list has a view."""
        if not context.scene.irpso.views:
            cls.poll_message_set("The list of views is empty")
            return False
        return True
