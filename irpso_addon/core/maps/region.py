"""A solve of a part: which texels change, how they fade into those that are kept, and what is kept."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from ..data import F32, F64, Bool, Maps
from ..resampling import at_size, nearest

SEAM, SEAM_SHARE = 8.0, 1 / 32  # how far around the region the new result fades: texels, at most this of the map
VOXELS = 160  # at most, along the longest side of the surface


def fade(position: F32, covered: Bool, inside: Bool) -> F32:
    """(n, n): share of the new result: 1 inside, falling to 0 around it, 0 where not covered.

    ``position``: (n, n, 3) metres.  Distance is measured in space, not over the map: the region fades across seams of
    the UV map too.  In voxels of half the seam's width, the share of the surface that is inside, smoothed.
    """
    if not inside.any() or not (covered & ~inside).any():
        return np.asarray(inside & covered, np.float32)
    places = position[covered].astype(np.float64)
    low, high = places.min(axis=0), places.max(axis=0)
    seam = min(SEAM, SEAM_SHARE * len(covered))
    cell = max(0.5 * seam * _texel_width(position, covered), float((high - low).max()) / VOXELS, 1e-12)
    at = (places - low) / cell + 1.5  # a voxel of margin all round
    shape = tuple(int(n) for n in np.ceil((high - low) / cell) + 4)
    voxel = np.ravel_multi_index(tuple(at.astype(np.int64).T), shape)
    surface, marked = (_smoothed(np.bincount(voxel, weights, int(np.prod(shape))).reshape(shape).astype(np.float64))
                       for weights in (None, inside[covered].astype(np.float64)))
    share = np.divide(marked, surface, out=np.zeros_like(marked), where=surface > 0)
    result = np.zeros(covered.shape, np.float32)
    result[covered] = np.clip(2.0 * _sampled(share, at - 0.5), 0.0, 1.0)  # half the surface is inside at the border
    return np.where(inside & covered, np.float32(1.0), result)


def _texel_width(position: F32, covered: Bool) -> float:
    """Metres: the median step between neighbouring texels."""
    step = np.linalg.norm(np.diff(position, axis=1), axis=2)[covered[:, 1:] & covered[:, :-1]]
    return float(np.median(step)) if len(step) else 0.0


def _smoothed(values: F64) -> F64:
    """Means over 3 x 3 x 3 voxels."""
    for axis in range(3):
        near = np.pad(values, [(1, 1) if a == axis else (0, 0) for a in range(3)])
        count = values.shape[axis]
        values = np.mean([np.take(near, range(i, i + count), axis) for i in range(3)], axis=0)
    return values


def _sampled(values: F64, at: F64) -> F64:
    """Trilinear, (N,) at (N, 3) voxels; centres lie at whole numbers."""
    corner = np.floor(at).astype(np.int64)
    f = at - corner
    result = np.zeros(len(at))
    for i in range(8):
        step = np.array([i & 1, (i >> 1) & 1, i >> 2])
        weight = np.prod(np.where(step == 1, f, 1.0 - f), axis=1)
        result += weight * values[tuple((corner + step).T)]
    return result


def of_image(image: F32, size: int) -> Bool:
    """(size, size): the texels whose centres lie where (h, w) ``image`` is above a half."""
    return np.asarray(resampled(image, size) > 0.5)


def resampled(values: F32, size: int) -> F32:
    """(size, size, ...) from (h, w, ...), as resampling.at_size, within the range of the values."""
    if values.shape[:2] == (size, size):
        return values
    made = at_size(values, size).reshape(size, size, *values.shape[2:])
    return np.asarray(np.clip(made, values.min(), values.max()), np.float32)


def resized(maps: Maps, size: int) -> Maps:
    """The maps at another size; a texel counts as filled where one that it is made from does."""
    if maps.roughness.shape == (size, size):
        return maps
    values: dict[str, Any] = {field.name: getattr(maps, field.name) for field in fields(maps)}
    made: dict[str, Any] = {
        name: None if array is None else resampled(array.astype(np.float32), size) for name, array in values.items()}
    made["filled"], made["coverage"] = made["filled"] > 0, made["coverage"] > 0.5
    if maps.metallic is not None:  # metal and paint, with nothing in between
        made["metallic"] = nearest(maps.metallic, size)
    return Maps(**made)
