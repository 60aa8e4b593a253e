"""The noise of a scan's corners in the normals of its mesh: how much there is, and how it is taken out."""

from __future__ import annotations

import math

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.data import F64
from ...core.shoot.corner_noise import noise_of, without_noise

ALIKE, EDGES = 1e-3, 0.01  # difference of normals that are one; share of the corners that may have others
LOOKED_AT = 200_000  # vertices that say how much noise there is


def degrees_of_noise(mesh: bpy.types.Mesh) -> float:
    """By how much the noise of corners turns normals; 0: there is none, or the mesh has sharp edges."""
    found = _vertex_normals(mesh)
    if found is None:
        return 0.0
    normals, edges = found
    near = edges[(edges < LOOKED_AT).all(axis=1)]
    return math.degrees(noise_of(normals[:LOOKED_AT], near)) if len(near) else 0.0


def take_out_noise(mesh: bpy.types.Mesh) -> bool:
    """Whether there was some: of a mesh that is smooth everywhere.  Custom normals replace its own."""
    found = _vertex_normals(mesh)
    if found is None:
        return False
    normals, count = without_noise(*found)
    if count:
        mesh.normals_split_custom_set_from_vertices(normals.tolist())
    return count > 0


def _vertex_normals(mesh: bpy.types.Mesh) -> tuple[F64, NDArray[np.int32]] | None:
    """(V, 3) normals, and (E, 2) the vertices of edges; None where corners of one vertex differ, as at sharp edges."""
    vertices, edges = np.empty(len(mesh.loops), np.int32), np.empty(2 * len(mesh.edges), np.int32)
    corners = np.empty((len(mesh.loops), 3), np.float32)
    mesh.loops.foreach_get("vertex_index", vertices)
    mesh.edges.foreach_get("vertices", edges)
    mesh.corner_normals.foreach_get("vector", corners.ravel())
    normals = np.zeros((len(mesh.vertices), 3))
    normals[vertices] = corners
    apart = (np.abs(normals[vertices] - corners) > ALIKE).any(axis=1)
    return None if apart.mean() > EDGES else (normals, edges.reshape(-1, 2))
