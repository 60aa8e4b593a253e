"""Rays against triangles in float64: what a camera's ray meets first, and whether anything lies between two points.

The boxes are a complete binary tree over the triangles in Morton order, each level an array; rays go down it level by
level, all at once.  No part of the OpenGL pipeline is used, so that this can judge it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..data import F32, F64, Bool

LEAF = 4  # triangles
RAYS_AT_ONCE = 8192  # a ray is in some tens of boxes at a time
PAIRS_AT_ONCE = 1 << 21  # of a ray and a box: bounds the memory where it is in thousands
EDGE = 1e-9  # by which a ray may miss a triangle in barycentric coordinates: no gaps between neighbours
MORTON_BITS = 10  # an axis
Index = NDArray[np.int64]


class Hit(NamedTuple):
    """What R rays meet first."""

    distance: F64  # (R,) in lengths of the ray's direction; infinite: nothing
    triangle: Index  # (R,) -1: none
    weights: F64  # (R, 3) barycentric


class Rays:
    """Triangles that rays are cast against."""

    def __init__(self, triangles: F32 | F64) -> None:
        """(T, 3, 3) world, metres; those without area or with a corner that is not finite stop nothing."""
        corners = np.asarray(triangles, np.float64).reshape(-1, 3, 3)
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
        whole = np.flatnonzero(np.isfinite(corners).all((1, 2)) & (area > 0))
        self._order = whole[np.argsort(_morton(corners[whole].mean(1)), kind="stable")]
        self._corners = corners[self._order]
        leaves = max(-(-len(self._order) // LEAF), 1)
        count = 1 << (leaves - 1).bit_length()
        low = np.full((count * LEAF, 3), np.inf)
        high = np.full((count * LEAF, 3), -np.inf)
        low[:len(self._order)], high[:len(self._order)] = self._corners.min(1), self._corners.max(1)
        low, high = low.reshape(count, LEAF, 3).min(1).T, high.reshape(count, LEAF, 3).max(1).T
        self._boxes = [(low, high)]  # (3, nodes) each; the root first, in the end
        while low.shape[1] > 1:
            low, high = low.reshape(3, -1, 2).min(2), high.reshape(3, -1, 2).max(2)
            self._boxes.insert(0, (low, high))

    def nearest(self, origin: F64, direction: F64) -> Hit:
        """The first triangle that each of R rays (R, 3) meets, from either side."""
        hit = Hit(np.full(len(origin), np.inf), np.full(len(origin), -1), np.zeros((len(origin), 3)))
        for first in range(0, len(origin), RAYS_AT_ONCE):
            part = slice(first, first + RAYS_AT_ONCE)
            for ray, place, distance, weights in self._met(origin[part], direction[part], np.inf):
                order = np.lexsort((distance, ray))
                ray, which = np.unique(ray[order], return_index=True)
                best = order[which]
                at = first + ray
                nearer = distance[best] < hit.distance[at]
                at, best = at[nearer], best[nearer]
                hit.distance[at], hit.triangle[at] = distance[best], self._order[place[best]]
                hit.weights[at] = weights[best]
        return hit

    def blocked(self, origin: F64, toward: F64, *, endless: bool = False) -> Bool:
        """(R,) whether a triangle lies between ``origin`` and origin + ``toward`` (R, 3); endless: or beyond."""
        found = np.zeros(len(origin), bool)
        for first in range(0, len(origin), RAYS_AT_ONCE):
            part = slice(first, first + RAYS_AT_ONCE)
            for ray, _, _, _ in self._met(origin[part], toward[part], np.inf if endless else 1.0):
                found[first + ray] = True
        return found

    def _met(self, origin: F64, direction: F64, most: float) -> Iterator[tuple[Index, Index, F64, F64]]:
        """Of all that rays meet before ``most``: ray, place in our order, distance, weights."""
        pairs = self._leaves(origin, direction, most)
        if pairs is None:
            half = len(origin) // 2
            for first, part in ((0, slice(half)), (half, slice(half, None))):
                for ray, place, distance, weights in self._met(origin[part], direction[part], most):
                    yield first + ray, place, distance, weights
            return
        ray, leaf = pairs
        place = leaf * LEAF
        for k in range(LEAF):
            inside = place + k < len(self._corners)
            at = ray[inside]
            distance, weights = _cross(origin[at], direction[at], self._corners[place[inside] + k])
            hit = ((weights[:, 0] > -EDGE) & (weights[:, 1] > -EDGE) & (weights[:, 2] > -EDGE)
                   & (distance > 0) & (distance < most))
            yield at[hit], place[inside][hit] + k, distance[hit], weights[hit]

    def _leaves(self, origin: F64, direction: F64, most: float) -> tuple[Index, Index] | None:
        """Pairs of a ray and a leaf whose box it goes through; None: too many for so many rays."""
        ray, node = np.arange(len(origin)), np.zeros(len(origin), np.int64)
        start, slope = origin.T, 1 / np.where(np.abs(direction) < 1e-200, 1e-200, direction).T
        for level, (low, high) in enumerate(self._boxes):
            if level:
                ray, node = np.repeat(ray, 2), (2 * node[:, None] + np.arange(2)).ravel()
            enter: F64 = np.zeros(len(ray))
            leave: F64 = np.full(len(ray), most)
            filled = low[0, node] <= high[0, node]
            for axis in range(3):  # one axis after the other: many times faster than over a short last axis
                one, other = ((box[axis, node] - start[axis, ray]) * slope[axis, ray] for box in (low, high))
                enter, leave = np.maximum(enter, np.minimum(one, other)), np.minimum(leave, np.maximum(one, other))
            through = filled & (enter <= leave * (1 + 1e-12))  # flat boxes are met on their very face
            ray, node = ray[through], node[through]
            if len(ray) > PAIRS_AT_ONCE and len(origin) > 1:
                return None
        return ray, node


def _cross(origin: F64, direction: F64, corners: F64) -> tuple[F64, F64]:
    """Distance (R,) and barycentric weights (R, 3), one ray a triangle.

    Moeller and Trumbore 1997, "Fast, Minimum Storage Ray/Triangle Intersection"; parallel rays get weights of -1.
    """
    a = corners[:, 0]
    e1, e2 = corners[:, 1] - a, corners[:, 2] - a
    p = np.cross(direction, e2)
    determinant = _dot(e1, p)
    flat = determinant == 0
    inverse = 1 / np.where(flat, 1.0, determinant)
    s = origin - a
    u = _dot(s, p) * inverse
    q = np.cross(s, e1)
    v = _dot(direction, q) * inverse
    weights = np.stack([1 - u - v, u, v], -1)
    return _dot(e2, q) * inverse, np.where(flat[:, None], -1.0, weights)


def _dot(a: F64, b: F64) -> F64:
    return np.asarray(np.einsum("rk,rk->r", a, b))


def _morton(points: F64) -> Index:
    """Place of each point (P, 3) along a curve that keeps neighbours together."""
    if not len(points):
        return np.zeros(0, np.int64)
    low = points.min(0)
    extent = np.maximum(points.max(0) - low, 1e-300)
    cell = np.minimum(((points - low) / extent * 2**MORTON_BITS).astype(np.int64), 2**MORTON_BITS - 1)
    code = np.zeros(len(points), np.int64)
    for bit in range(MORTON_BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code
