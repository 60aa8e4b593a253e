"""The mesh in numpy, for solver.py: which triangle a texel shows, and what the surface is at a point of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data import F32, F64, I32, Bool, MeshArrays, NormalMap
from .rays import Index

PAIRS_AT_ONCE = 1 << 21  # of a triangle and a texel in its box


@dataclass(frozen=True)
class SurfacePoints:
    """P points of the mesh."""

    position: F64  # (P, 3) world, metres
    normal: F64  # (P, 3) world, unit shading normal, normal map included
    lifted: F64  # (P, 3) where shadow rays start: on the smooth surface that the corner normals describe


def rasterise(uvs: F32, size: int) -> tuple[Index, F64]:
    """Triangle (size, size) under each texel's centre, -1: none, the last of several; weights (size, size, 3).

    uvs: (T, 3, 2), what lies outside the unit square is left out; row 0 is the bottom.
    """
    owner, weights = np.full(size * size, -1), np.zeros((size * size, 3))
    corners = np.asarray(uvs, np.float64) * size - 0.5  # texel centres are whole numbers
    known = np.where(np.isfinite(corners), corners, -2.0)
    low = np.clip(np.ceil(known.min(1)), 0, size).astype(np.int64)
    high = np.clip(np.floor(known.max(1)), -1, size - 1).astype(np.int64)
    spans = np.maximum(high - low + 1, 0) * np.isfinite(corners).all((1, 2))[:, None]
    counts = spans.prod(1)
    ends = np.cumsum(counts)
    first = 0
    while first < len(counts):
        last = max(int(np.searchsorted(ends, (ends[first - 1] if first else 0) + PAIRS_AT_ONCE)), first + 1)
        number = counts[first:last]
        triangle = np.repeat(np.arange(first, min(last, len(counts))), number)
        place = np.arange(len(triangle)) - np.repeat(np.cumsum(number) - number, number)
        texel = low[triangle] + np.stack([place % spans[triangle, 0], place // spans[triangle, 0]], -1)
        share = _barycentric(corners[triangle], texel)
        inside = (share >= -1e-9).all(-1)
        at = texel[inside, 1] * size + texel[inside, 0]
        owner[at], weights[at] = triangle[inside], share[inside]
        first = last
    return owner.reshape(size, size), weights.reshape(size, size, 3)


def _barycentric(corners: F64, points: Index) -> F64:
    """(P, 3) of points (P, 2) in triangles (P, 3, 2); -1 where the triangle has no area."""
    a, b, c = (corners[:, i] - points for i in range(3))
    parts = np.stack([b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0], c[:, 0] * a[:, 1] - c[:, 1] * a[:, 0],
                      a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]], -1)
    area = parts.sum(-1, keepdims=True)
    return np.where(area == 0, -1.0, parts / np.where(area == 0, 1.0, area))


def places(mesh: MeshArrays, triangle: Index, weights: F64) -> SurfacePoints:
    """The surface at points given by triangle (P,) and barycentric weights (P, 3)."""
    corners = mesh.positions[triangle].astype(np.float64)
    corner_normals = mesh.normals[triangle].astype(np.float64)
    position = _mix(corners, weights)
    smooth = _unit(_mix(corner_normals, weights))
    return SurfacePoints(position, _mapped(mesh, triangle, weights, smooth),
                  _lifted(corners, corner_normals, position, weights, smooth))


def _lifted(corners: F64, normals: F64, position: F64, weights: F64, smooth: F64) -> F64:
    """Hanika 2021, "Hacking the Shadow Terminator" (Ray Tracing Gems II, chapter 4), and a hair off the facet."""
    apart = position[:, None] - corners
    below = np.minimum((apart * normals).sum(-1, keepdims=True), 0)
    lift = _mix(-below * normals, weights)
    edges = np.linalg.norm(corners - np.roll(corners, 1, 1), axis=-1).max(1, keepdims=True)
    length = np.linalg.norm(lift, axis=-1, keepdims=True)
    lift *= np.minimum(1, 0.25 * edges / np.maximum(length, 1e-300))  # hard edges: the planes say nothing
    facet = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    facet *= np.where((facet * smooth).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    return np.asarray(position + lift + 1e-5 * edges * facet)


def _mapped(mesh: MeshArrays, triangle: Index, weights: F64, smooth: F64) -> F64:
    """Shading normals: Blender's Normal Map node in object space where the material has one."""
    normal = smooth.copy()
    slots: I32 = mesh.slots[triangle]
    for slot, image in mesh.normal_maps.items():
        assert mesh.object_normals is not None and mesh.tangents is not None and mesh.normal_matrix is not None
        here: Bool = slots == slot
        at, share = triangle[here], weights[here]
        n, tangent = _mix(mesh.object_normals[at], share), _mix(mesh.tangents[at], share)
        n = _unit(n) if image.unit_normal else n
        colour = _sample(image, _mix(mesh.uvs[at], share)) * 2 - 1
        x, y = (colour[:, :2] * image.strength).T
        z = 1 + (colour[:, 2] - 1) * min(max(image.strength, 0.0), 1.0)
        side = tangent[:, 3:] * np.cross(n, tangent[:, :3])
        found = x[:, None] * tangent[:, :3] + y[:, None] * side + z[:, None] * n
        normal[here] = _unit(found @ np.asarray(mesh.normal_matrix, np.float64).T)
    return normal


def _sample(image: NormalMap, uv: F64) -> F64:
    """The map's values (P, 3) at uv (P, 2): bilinear, repeated (core/resampling.py clamps)."""
    h, w = image.pixels.shape[:2]
    at = uv * [w, h] - 0.5
    low = np.floor(at).astype(np.int64)
    s, t = (at - low).T[..., None]
    x0, y0, x1, y1 = low[:, 0] % w, low[:, 1] % h, (low[:, 0] + 1) % w, (low[:, 1] + 1) % h
    p = image.pixels
    return np.asarray((1 - t) * ((1 - s) * p[y0, x0] + s * p[y0, x1]) + t * ((1 - s) * p[y1, x0] + s * p[y1, x1]))


def _mix(corners: F64 | F32, weights: F64) -> F64:
    """Values at the corners (P, 3, c), mixed (P, c)."""
    return np.asarray((corners * weights[..., None]).sum(1), np.float64)


def _unit(vectors: F64) -> F64:
    """Of length 1; zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))
