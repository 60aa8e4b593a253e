"""Mix-in of operators that look at the listed chrome balls."""

import bpy


class NeedsBalls:
    """Enabled when there are views and a ball."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The lists have a view and a ball."""
        settings = context.scene.irpso
        if not settings.views:
            cls.poll_message_set("The list of views is empty")
            return False
        if not settings.shoot.balls:
            cls.poll_message_set("Add a chrome ball first")
            return False
        return context.mode == "OBJECT"
