"""Arrays at other sizes."""

from __future__ import annotations

import numpy as np

from .data import F32, F64

BAD = 1e3  # stands in for NaN and infinity: such a texel scores as the worst value in range


def at_size(array: F32 | F64, size: int) -> F64:
    """(h, w, c) or (h, w) at ``size`` x ``size`` texels, (size, size, c): block means where it divides, else bilinear.

    NaN and infinite values become -BAD or BAD.
    """
    finite: F64 = array.reshape(*array.shape[:2], -1).astype(np.float64)
    finite = np.nan_to_num(finite, nan=BAD, posinf=BAD, neginf=-BAD)
    height, width, channels = finite.shape
    if height % size == 0 and width % size == 0:
        blocks: F64 = finite.reshape(size, height // size, size, width // size, channels).mean((1, 3))
        return blocks
    return _lerp(_lerp(finite, size, axis=0), size, axis=1)


def _lerp(array: F64, size: int, axis: int) -> F64:
    """Linear interpolation along one axis at the centres of ``size`` texels, clamped at the ends."""
    length = array.shape[axis]
    x = np.clip((np.arange(size) + 0.5) / size * length - 0.5, 0, length - 1)
    low = np.minimum(x.astype(int), max(length - 2, 0))
    shape = [1] * array.ndim
    shape[axis] = size
    t = (x - low).reshape(shape)
    below, above = array.take(low, axis), array.take(np.minimum(low + 1, length - 1), axis)
    mixed: F64 = (1 - t) * below + t * above
    return mixed
