"""Noise of a scan's normals: its corners are off by a part of a face's width, each by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..data import F64

NOISE = 2.0  # how much more of a normal one mean takes away than the next one does, where noise is most of it
MOST = 5  # means


def without_noise(normals: F64, edges: NDArray[np.int32]) -> tuple[F64, int]:
    """(V, 3) unit normals without the noise that corners have each by itself, and how many means that took.

    ``edges``: (E, 2) vertices that are neighbours.  The mean with the neighbours takes away most of such noise at once,
    and of shape about as much each time: of waves that are many edges long hardly anything.
    """
    mean = _mean(normals, edges)
    for count in range(MOST):
        further = _mean(mean, edges)
        if not _apart(normals, mean) > NOISE * _apart(mean, further):
            return normals, count
        normals, mean = mean, further
    return normals, MOST


def noise_of(normals: F64, edges: NDArray[np.int32]) -> float:
    """Radians by which the first mean turns normals, in the median; 0 where what it takes away is no such noise."""
    mean = _mean(normals, edges)
    turned = _apart(normals, mean)
    return turned if turned > NOISE * _apart(mean, _mean(mean, edges)) else 0.0


def _apart(one: F64, other: F64) -> float:
    """How far normals lie apart, in the median."""
    return float(np.median(np.linalg.norm(one - other, axis=1)))


def _mean(normals: F64, edges: NDArray[np.int32]) -> F64:
    one, other = edges.T
    total = normals + np.stack([np.bincount(one, normals[other, k], len(normals))
                                + np.bincount(other, normals[one, k], len(normals)) for k in range(3)], axis=1)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30))
