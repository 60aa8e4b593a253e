"""Mix-in of operators that use the last solution of the active object, or of the mesh that was active last."""

import bpy

from ...irpso_addon.blender.jobs.session import session
from ...irpso_addon.core.data import Solution
from ...irpso_addon.core.errors import BadInput


class NeedsSolution:
    """Enabled when the object was solved, now or in an earlier session whose result the file has."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The object has a solution."""
        obj = cls.subject(context)
        if obj is None or obj.type != "MESH":
            cls.poll_message_set("Make a mesh object active")
        elif session.facts_of(obj) is None:
            cls.poll_message_set("Solve this object first")
        else:
            return True
        return False

    @staticmethod
    def subject(context: bpy.types.Context) -> bpy.types.Object | None:
        """The object that is meant."""
        return session.subject(context)

    @staticmethod
    def solution(obj: bpy.types.Object) -> Solution:
        """The object's solution.  Raises BadInput where its maps are gone.

        While a file browser is open, another object may become active.
        """
        results = session.results_of(obj)
        if not results:
            raise BadInput(f"{obj.name}: has no result; solve it first")
        return results[-1].presented(obj)
