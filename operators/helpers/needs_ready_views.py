"""Mix-in of jobs that look at the active mesh's views."""

import bpy

from ...irpso_addon.blender.scene import readiness
from .modal_job import ModalJob


class NeedsReadyViews(ModalJob):
    """Enabled where nothing is known against a mesh and its views; in the background the job itself says what is."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh with views."""
        if not super().poll(context):
            return False
        why = None if bpy.app.background else readiness.why_not(context)
        if why is not None:
            cls.poll_message_set(why)
        return why is None
