"""Facets: what a triangle is beside the smooth surface that its corner normals describe."""

from __future__ import annotations

import numpy as np

from ...core.data import F32, F64, MeshArrays

AT_ONCE = 1 << 15  # triangles that are computed together: what a processor's cache holds


def facets(mesh: MeshArrays) -> F32:
    """(T, 4): unit facet normal of each triangle and its lift in metres.

    The lift is how far the smooth surface that the corner normals describe stands above the flat
    facet (half the largest height of a corner's tangent plane above another corner), after the
    shadow-terminator offset of Hanika (Ray Tracing Gems II, 2021, ch. 4).  In a hollow it stands
    below: the lift is 0.  Degenerate triangles get a zero normal.
    """
    found = np.empty((len(mesh.positions), 4), np.float32)
    for first in range(0, len(found), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        found[part] = _facets(mesh.positions[part].astype(np.float64), mesh.normals[part].astype(np.float64))
    return found


def _facets(p: F64, n: F64) -> F64:
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-20, normal / np.maximum(length, 1e-20), 0.0)
    lift, longest = np.zeros(len(p)), np.zeros(len(p))
    for i, j in ((0, 1), (1, 2), (2, 0)):
        edge = p[:, j] - p[:, i]
        longest = np.maximum(longest, np.einsum("tk,tk->t", edge, edge))
        for corner, height in ((i, -0.5), (j, 0.5)):  # negative in a hollow
            lift = np.maximum(lift, height * np.einsum("tk,tk->t", edge, n[:, corner]))
    lift = np.minimum(lift, 0.25 * np.sqrt(longest))  # flat shading and hard edges: the planes say nothing
    return np.concatenate([normal, lift[:, None]], axis=1)
