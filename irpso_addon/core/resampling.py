"""Arrays at other sizes and at places between their texels.

Elsewhere on purpose: tables whose first and last node lie at 0 and 1 (core/shading/tables.py), the normal map, which
repeats (core/cpu_solver/rasterise.py), masks and reference images, which arrive in bands (core/images/mask.py and
reference_image.py), what is shown small (core/evaluation/display.py, cli/demo.py), and lines across pictures
(core/shoot/edge_lines.py), which end where the picture does.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .data import F32, F64, Bool

T = TypeVar("T", bound=np.generic)
BORDER = 1e-4  # of the grid
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
    middles = (np.arange(size) + 0.5) / size
    return linear(linear(finite, middles * height - 0.5, axis=0), middles * width - 0.5, axis=1)


def linear(array: F32 | F64, at: F64, axis: int) -> F64:
    """Linear interpolation along one axis at places in texels, whose centres are whole numbers; clamped at the ends."""
    last = array.shape[axis] - 1
    x = np.clip(at, 0, last)
    low = np.minimum(x.astype(int), max(last - 1, 0))
    shape = [1] * array.ndim
    shape[axis] = len(at)
    t = (x - low).reshape(shape)
    below, above = array.take(low, axis), array.take(np.minimum(low + 1, last), axis)
    mixed: F64 = (1 - t) * below + t * above
    return mixed


def on_grid(uv: F32) -> Bool:
    """(...) whether places (..., 2) lie on a grid from 0 to 1; rounding may put those at its border outside."""
    return np.asarray(((uv > -BORDER) & (uv < 1 + BORDER)).all(-1))


def bilinear(grid: F32 | F64, uv: F32 | F64) -> F64:
    """(P, c) of (h, w, c) at (P, 2), 0 to 1 over the grid; texel centres lie at (i + 1/2) / n, clamped outside them."""
    height, width = grid.shape[:2]
    at = np.clip(uv.astype(np.float64) * [width, height] - 0.5, 0, [width - 1, height - 1])
    low = np.minimum(at.astype(int), [width - 2, height - 2])
    (x, y), (s, t) = low.T, (at - low).T[..., None]
    value: F64 = (1 - t) * ((1 - s) * grid[y, x] + s * grid[y, x + 1]) + t * (
        (1 - s) * grid[y + 1, x] + s * grid[y + 1, x + 1])
    return value


def nearest(values: NDArray[T], size: int) -> NDArray[T]:
    """A square map at another size: each texel that of the nearest one."""
    if values.shape[0] == size:
        return values
    at = ((np.arange(size) + 0.5) * values.shape[0] / size).astype(np.int64)
    picked: NDArray[T] = values[at][:, at]
    return picked


def block_means(values: F32, size: int) -> F32:
    """A square map at a smaller size: means over blocks, NaN where one has; the nearest texel where no blocks fit."""
    share = values.shape[0] // size
    if share < 2 or share * size != values.shape[0]:
        return nearest(values, size)
    blocks = values.reshape(size, share, size, share, *values.shape[2:])
    return np.asarray(blocks.mean(axis=(1, 3)), np.float32)
