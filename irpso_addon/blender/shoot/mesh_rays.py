"""Where rays meet a mesh of the scene."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ...core.data import F64


class MeshRays:
    """A mesh as the scene shows it now."""

    def __init__(self, context: bpy.types.Context, mesh: bpy.types.Object) -> None:
        depsgraph = context.evaluated_depsgraph_get()
        shape = mesh.evaluated_get(depsgraph)
        self._tree = BVHTree.FromObject(shape, depsgraph)
        self._matrix = shape.matrix_world.copy()
        self._inverse = self._matrix.inverted_safe()
        self._turn = self._inverse.to_3x3()
        self._turn_normal = self._turn.transposed()

    def hit(self, origin: F64, direction: F64) -> tuple[F64, F64] | None:
        """Place and unit normal, (3,) world, where a ray meets it first; the normal looks to where the ray begins."""
        ray = self._turn @ Vector(direction)
        if not ray.length > 0:
            return None
        place, normal, _, _ = self._tree.ray_cast(self._inverse @ Vector(origin), ray.normalized())
        if place is None:
            return None
        turned = np.array((self._turn_normal @ normal).normalized(), np.float64)
        return np.array(self._matrix @ place, np.float64), -turned if turned @ direction > 0 else turned
