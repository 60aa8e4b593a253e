"""Mix-in of operators that use the active object's last solution."""

import bpy

from ...irpso_addon.blender.jobs.session import session
from ...irpso_addon.core.data import Solution
from ...irpso_addon.core.errors import BadInput


class NeedsSolution:
    """Enabled when the active object was solved since the file was opened."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The active object has a solution."""
        obj = context.active_object
        if obj is None or obj.type != "MESH":
            cls.poll_message_set("Make a mesh object active")
        elif session.solution_of(obj) is None:
            cls.poll_message_set("Solve this object first")
        else:
            return True
        return False

    @staticmethod
    def solution(obj: bpy.types.Object) -> Solution:
        """The object's solution.  Raises BadInput: while a file browser is open, another object may become active."""
        found = session.solution_of(obj)
        if found is None:
            raise BadInput(f"{obj.name}: was not solved since the file was opened; solve it first")
        return found
