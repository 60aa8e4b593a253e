"""The part of tilts that is no detail of a surface: what regions, or like normals all over the object, have in common.

Lamps that are a little off tilt the normals of a region alike.  A reflection that is none of the model's tilts like
normals alike, as far as lamps and cameras are far away.
"""

from __future__ import annotations

import numpy as np

from ..data import F64, I32

CELLS = 24  # across the longest side of what the places fill
WIDTH = 5.0  # cells: standard deviation of the Gaussian
LEAST = 1e-12


def common(position: F64, normal: F64, offset: F64, weight: F64) -> F64:
    """(N, 3) the common part of offsets of normals.  position, normal: (N, 3), as given; weight: (N,) of each."""
    result = np.zeros_like(offset)
    for place in (position, normal):
        low = _LowPass(place)
        low.add(place, offset - result, weight)
        low.blur()
        result += low.at(place)
    return np.asarray(result - normal * (result * normal).sum(-1, keepdims=True))


class _LowPass:
    """Means of vectors over places near by, from sums in cells of space."""

    def __init__(self, position: F64) -> None:
        """``position``: (N, 3) of all places."""
        self.low = position.min(0)
        self.cell = max(float(np.ptp(position, axis=0).max()), LEAST) / CELLS
        shape = tuple(np.ceil(np.ptp(position, axis=0) / self.cell).astype(int) + 2)
        self.sums = np.zeros((*shape, 4))

    def add(self, position: F64, vector: F64, weight: F64) -> None:
        """Of (N, 3) places, (N, 3) vectors and (N,) weights."""
        at, _ = self._at(position)
        np.add.at(self.sums, tuple(at.T), np.concatenate([vector * weight[:, None], weight[:, None]], -1))

    def blur(self) -> None:
        """To be called once all are added."""
        reach = int(3 * WIDTH)
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / WIDTH) ** 2)
        for axis in range(3):
            padded = np.pad(self.sums, [(reach, reach) if n == axis else (0, 0) for n in range(4)])
            length = self.sums.shape[axis]
            self.sums = sum((factor * padded.take(range(k, k + length), axis) for k, factor in enumerate(kernel)),
                            np.zeros_like(self.sums))

    def at(self, position: F64) -> F64:
        """(N, 3) the mean vector at places; trilinear."""
        at, share = self._at(position)
        result = np.zeros((len(position), 4))
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, share, 1 - share).prod(-1)
            result += weight[:, None] * self.sums[tuple((at + corner).T)]
        return np.asarray(result[:, :3] / np.maximum(result[:, 3:], LEAST))

    def _at(self, position: F64) -> tuple[I32, F64]:
        place = np.clip((position - self.low) / self.cell, 0, np.array(self.sums.shape[:3]) - 1.001)
        at = np.floor(place).astype(np.int32)
        return np.asarray(at), np.asarray(place - at)
