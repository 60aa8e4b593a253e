"""Normals of a map's texels as a tangent-space normal map: OpenGL's convention (green up), MikkTSpace's tangents.

The map is what Blender's Normal Map node, glTF and the engines expect: over a triangle, normal n and tangent t are
interpolated, b = sign cross(n, t), and the value c stands for c.x t + c.y b + c.z n.  Tangents are MikkTSpace's
(Mikkelsen 2008, "Simulation of Wrinkled Surfaces Revisited", appendix): at a corner the mean of those of the triangles
that share its place, normal and UV, each by its angle.  They are taken in object space, over triangles, as in Cycles.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cpu_solver.rasterise import rasterise
from ..data import F32, F64, Bool, MeshArrays, NormalMap

LEAST = 1e-20
PADDING = 16  # texels around islands
FLAT = (0.5, 0.5, 1.0)


def object_space(mesh: MeshArrays) -> tuple[F64, F64, bool]:
    """(positions (T, 3, 3) without the object's place, unit corner normals (T, 3, 3), whether it is mirrored)."""
    inverse = _inverse(mesh)
    positions = mesh.positions.astype(np.float64) @ inverse.T
    normals = mesh.normals.astype(np.float64) @ np.linalg.inv(inverse)
    return positions, _unit(normals), bool(np.linalg.det(inverse) < 0)


def tangents(mesh: MeshArrays) -> F64:
    """(T, 3, 4) of each corner, in object space: unit, and the sign of its bitangent."""
    positions, normals, mirrored = object_space(mesh)
    order = [0, 2, 1] if mirrored else [0, 1, 2]  # as the object has them
    p, n, uv = positions[:, order], normals[:, order], mesh.uvs[:, order].astype(np.float64)
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    along = _unit(e1 * d2[:, 1:] - e2 * d1[:, 1:]) * np.where(area > 0, 1.0, -1.0)[:, None]
    flat = _unit(along[:, None] - n * (along[:, None] * n).sum(-1, keepdims=True))
    angle = np.empty(p.shape[:2])
    for k in range(3):
        a, b = (_unit(edge - n[:, k] * (edge * n[:, k]).sum(-1, keepdims=True))
                for edge in (p[:, (k + 1) % 3] - p[:, k], p[:, (k + 2) % 3] - p[:, k]))
        angle[:, k] = np.arccos(np.clip((a * b).sum(-1), -1, 1))
    angle[np.abs(area) < LEAST] = 0.0
    sums = _by_corner(mesh, order, area > 0, flat * angle[..., None])
    sign = np.repeat(np.where(area > 0, 1.0, -1.0)[:, None, None], 3, 1)
    return np.concatenate([_unit(sums), sign], -1)[:, order]


def _by_corner(mesh: MeshArrays, order: list[int], turned: Bool, vectors: F64) -> F64:
    """(T, 3, 3) sums over the corners that share place, normal, UV and orientation."""
    parts = [mesh.positions[:, order], mesh.normals[:, order], mesh.uvs[:, order],
             np.repeat(turned[:, None, None], 3, 1).astype(np.float32)]
    keys = np.ascontiguousarray(np.concatenate(parts, -1).reshape(-1, 9) + np.float32(0))  # -0 is 0
    _, of = np.unique(keys.view(np.dtype((np.void, keys.itemsize * 9))).ravel(), return_inverse=True)
    flat = vectors.reshape(-1, 3)
    sums = np.stack([np.bincount(of.ravel(), flat[:, k]) for k in range(3)], -1)
    return np.asarray(sums[of.ravel()].reshape(vectors.shape))


def encoded(mesh: MeshArrays, normal: F32, coverage: Bool) -> F32:
    """(n, n, 3) 0..1 of world shading normals (n, n, 3) where ``coverage``, padded; flat elsewhere.

    The mesh's UVs are those of the square that the texels cover.
    """
    owner, weights = rasterise(mesh.uvs if mesh.grid is None else mesh.grid, len(normal))
    known = coverage & (owner >= 0)
    at, share = owner[known], weights[known]
    _, corner, _ = object_space(mesh)
    frame = tangents(mesh)
    n, t = _mix(corner[at], share), _mix(frame[at, :, :3], share)
    n = _unit(n) if mesh.unit_normal else n
    axes = np.stack([t, np.cross(n, t) * frame[at, 0, 3:], n], -1)
    wanted = normal[known].astype(np.float64) @ np.linalg.inv(_inverse(mesh))
    fine = np.abs(np.linalg.det(axes)) > 1e-6  # tangents of faces whose UVs have no area
    value = np.tile([0.0, 0.0, 1.0], (len(wanted), 1))
    value[fine] = np.linalg.solve(axes[fine], wanted[fine][..., None])[..., 0]
    value = _unit(np.where(value[:, 2:] > 0, value, [0.0, 0.0, 1.0]))
    result = np.tile(np.array(FLAT, np.float32), (*coverage.shape, 1))
    result[known] = value * 0.5 + 0.5
    return padded(result, known, PADDING)


def tangent_part(mesh: MeshArrays) -> MeshArrays:
    """Of a mesh with a ``grid``: triangles on the square from 0 to 1, and those that share in their corners' tangents.

    Some triangle lies there.  Corners that share a tangent share their UVs, and so lie where the former do.
    """
    assert mesh.grid is not None
    low, high = mesh.grid.min(axis=1), mesh.grid.max(axis=1)
    inside = ((low <= 1) & (high >= 0)).all(axis=1)
    around = low[inside].min(axis=0), high[inside].max(axis=0)
    kept = ((low <= around[1]) & (high >= around[0])).all(axis=1)
    return replace(mesh, positions=mesh.positions[kept], normals=mesh.normals[kept], uvs=mesh.uvs[kept],
                   slots=mesh.slots[kept], grid=mesh.grid[kept], normal_maps={}, object_normals=None, tangents=None)


def wearing(mesh: MeshArrays, normal: F32) -> MeshArrays:
    """The mesh with a normal map (h, w, 3), as of `encoded`, on all of its materials in place of theirs."""
    worn = NormalMap(normal, 1.0, mesh.unit_normal)
    return replace(mesh, object_normals=object_space(mesh)[1].astype(np.float32),
                   tangents=tangents(mesh).astype(np.float32),
                   normal_matrix=np.eye(3, dtype=np.float32) if mesh.normal_matrix is None else mesh.normal_matrix,
                   normal_maps={slot: worn for slot in range(len(mesh.slot_names))})


def padded(values: F32, known: Bool, steps: int) -> F32:
    """(h, w, c) with values around what is known, so many texels wide: means of neighbours."""
    values, known = values.copy(), known.copy()
    height, width = known.shape
    for _ in range(steps):
        total, count = np.zeros_like(values), np.zeros(known.shape, np.float32)
        shown = np.pad(np.where(known[..., None], values, 0), ((1, 1), (1, 1), (0, 0)))
        there = np.pad(known.astype(np.float32), 1)
        for y, x in ((0, 1), (2, 1), (1, 0), (1, 2)):
            total += shown[y:y + height, x:x + width]
            count += there[y:y + height, x:x + width]
        new = ~known & (count > 0)
        if not new.any():
            break
        values[new] = total[new] / count[new][:, None]
        known |= new
    return values


def _inverse(mesh: MeshArrays) -> F64:
    """(3, 3) world to object space, without its place."""
    return np.eye(3) if mesh.normal_matrix is None else np.asarray(mesh.normal_matrix, np.float64).T


def _mix(corners: F64, weights: F64) -> F64:
    return np.asarray(np.einsum("pck,pc->pk", corners, weights))


def _unit(vectors: F64) -> F64:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > LEAST, length, 1.0))
