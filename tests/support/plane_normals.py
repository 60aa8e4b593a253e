"""How far the normals of a solved plane are from the true ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from irpso_addon.core.data import Solution
from tests.support import synthetic as syn

NormalAt = Callable[[np.ndarray], np.ndarray]  # of points of the plane


def angles(solution: Solution, given: NormalAt, truth: NormalAt) -> tuple[np.ndarray, np.ndarray]:
    """Degrees from the true normals to the mesh's own and to those of the map, in which tangents are world axes."""
    maps = solution.maps
    size = len(maps.coverage)
    at = (np.arange(size) + 0.5) / size
    places = np.stack([*(np.meshgrid(at, at)), np.zeros((size, size))], -1)
    points = (places - syn.MARGIN) / (1 - 2 * syn.MARGIN) * 2 - 1
    points[..., 2] = 0
    inside = maps.coverage & (np.abs(points[..., :2]).max(-1) < 0.9)
    mesh, true = given(points)[inside], truth(points)[inside]
    value = maps.normal[inside].astype(np.float64) * 2 - 1
    tangent = np.cross([0.0, 1.0, 0.0], mesh)  # of the plane's UVs
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    found = value[:, :1] * tangent + value[:, 1:2] * np.cross(mesh, tangent) + value[:, 2:] * mesh
    return tuple(np.degrees(np.arccos(np.clip((a * true).sum(-1), -1, 1))) for a in (mesh, found))
