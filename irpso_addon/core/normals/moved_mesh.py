"""A mesh whose vertices lie where its refined normals say that the surface is.

What refined normals add to a mesh's own is minus the slope of what its surface is off by, along the normal.  Vertices
move along their normals so that the facets turn as the tilts say: least squares, by conjugate gradients.  A pull
towards no movement ends what no tilt says: shapes as large as `low_pass` takes out of tilts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..data import F32, F64, MeshArrays

I64 = NDArray[np.int64]
REACH = 0.2  # of the object's longest side: shapes that are larger are not in the tilts (`low_pass`)
MOST = 200_000  # triangles: so that it ends in seconds
ROUNDS = 300
SETTLED = 1e-3  # of the residual of no movement
LEAST_EXPLAINED = 0.5  # of the squares of tilts: facets that are too wide, or tilts that are no slope, explain less
# Places in a triangle where its tilt is looked up, by the shares of its corners.
SHARES = np.array([(4, 1, 1), (1, 4, 1), (1, 1, 4), (2, 2, 2)]) / 6


def moved(mesh: MeshArrays, offsets: F32) -> F32 | None:
    """(T, 3, 3) positions; None: the mesh cannot follow its normals.

    ``offsets``: (m, m, 3) over the texel grid, world: what is added to the unit normals.
    """
    if len(mesh.positions) > MOST:
        return None
    surface = _Surface.of(mesh)
    tilt = surface.tilts(mesh.uvs if mesh.grid is None else mesh.grid, offsets)
    height = _solved(surface, tilt)
    if surface.unexplained(height, tilt) >= (1 - LEAST_EXPLAINED) * surface.unexplained(np.zeros_like(height), tilt):
        return None
    return (mesh.positions + (height[:, None] * surface.normal)[surface.corners]).astype(np.float32)


@dataclass(frozen=True)
class _Surface:
    """Vertices and triangles of the mesh; V vertices, T triangles."""

    corners: I64  # (T, 3) vertices
    normal: F64  # (V, 3) unit
    slope: F64  # (T, 3, 3) by corner: gradient of the height over the triangle, where that vertex moves by 1
    facet: F64  # (T, 3) unit normal
    area: F64  # (T,)
    size: float  # of the longest side

    @classmethod
    def of(cls, mesh: MeshArrays) -> _Surface:
        place, corners = np.unique(mesh.positions.reshape(-1, 3), axis=0, return_inverse=True)
        corners = corners.reshape(-1, 3)
        place = place.astype(np.float64)
        at = place[corners]
        across = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
        twice = np.linalg.norm(across, axis=1)
        facet = across / np.maximum(twice, 1e-20)[:, None]
        normal = _sums(corners, mesh.normals.astype(np.float64), len(place))
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)
        edges = at[:, [2, 0, 1]] - at[:, [1, 2, 0]]
        shown = np.einsum("tk,tik->ti", facet, normal[corners])  # of a vertex's movement in the facet's height
        slope = np.cross(facet[:, None], edges) / np.maximum(twice, 1e-20)[:, None, None] * shown[..., None]
        slope[twice < 1e-16] = 0
        return cls(corners, normal, slope, facet, twice / 2, float(np.ptp(place, axis=0).max()))

    def tilts(self, uvs: F32, offsets: F32) -> F64:
        """(T, 3) mean of what is added to the normals of each triangle, in its plane."""
        rows, columns = offsets.shape[:2]
        tilt = np.zeros_like(self.facet)
        for share in SHARES:
            u, v = np.einsum("i,tik->kt", share, uvs)
            column, row = (np.clip((value * count).astype(int), 0, count - 1) for value, count in (
                (u, columns), (v, rows)))
            tilt += offsets[row, column] / len(SHARES)
        return np.asarray(tilt - self.facet * (tilt * self.facet).sum(1, keepdims=True))

    def slopes(self, height: F64) -> F64:
        """(T, 3) of heights (V,)."""
        return np.asarray(np.einsum("tik,ti->tk", self.slope, height[self.corners]))

    def unexplained(self, height: F64, tilt: F64) -> float:
        """Sum of squares of what is left of the tilts."""
        return float((self.area * ((self.slopes(height) + tilt) ** 2).sum(1)).sum())


def _solved(surface: _Surface, tilt: F64) -> F64:
    """(V,) heights of the vertices, metres."""
    count = len(surface.normal)
    blocks = np.einsum("t,tik,tjk->tij", surface.area, surface.slope, surface.slope)
    own = _sums(surface.corners, np.repeat(surface.area[:, None] / 3, 3, 1)[..., None], count)[:, 0]
    own /= max(REACH * surface.size, 1e-12) ** 2

    def held(height: F64) -> F64:
        pulled = np.einsum("tij,tj->ti", blocks, height[surface.corners])
        return np.asarray(own * height + np.bincount(surface.corners.ravel(), pulled.ravel(), count))

    stiff = own + np.bincount(surface.corners.ravel(), np.einsum("tii->ti", blocks).ravel(), count)
    pull = -np.einsum("t,tik,tk->ti", surface.area, surface.slope, tilt)
    return _conjugate_gradients(held, np.bincount(surface.corners.ravel(), pull.ravel(), count),
                                1 / np.maximum(stiff, 1e-30))


def _conjugate_gradients(held: Callable[[F64], F64], pull: F64, inverse: F64) -> F64:
    """What is held as strongly as it is pulled; ``inverse``: about that of ``held``."""
    found, left, way, before = np.zeros_like(pull), pull, np.zeros_like(pull), 1.0
    least = SETTLED**2 * float(pull @ (inverse * pull))
    for n in range(ROUNDS):
        nearer = inverse * left
        now = float(left @ nearer)
        if now <= least:
            break
        way = nearer + (now / before if n else 0.0) * way
        pulled = held(way)
        step = now / float(way @ pulled)
        found, left, before = found + step * way, left - step * pulled, now
    return found


def _sums(corners: I64, values: F64, count: int) -> F64:
    """(V, k) sums over the corners of each vertex, of (T, 3, k) values."""
    return np.stack([np.bincount(corners.ravel(), values[..., k].ravel(), count) for k in range(values.shape[2])], -1)
