"""How far maps are off because a pixel mixes texels, and because a texture interpolates between them."""

from __future__ import annotations

import numpy as np

from ..data import F32, Bool

ALONE, MIXED = 0.75, 4  # texels: widths of a pixel up to which it mixes none, and up to which it is told from texels
# Of what a plane leaves: see between_paints.  Twice as far apart, it leaves twice as much at a border, in the mean over
# the directions of borders, and sixteen times as much where paint bends steadily.
PAINT, FARTHER, BENT = np.float32(0.2), np.float32(2), np.float32(16)


def mixture(roughness: F32, sigma: F32, solved: Bool, pixel: float) -> F32:
    """(h, w) variance of roughness because pixels mix texels: it changes faster than its standard errors explain.

    Of 3 x 3 texels, a pixel apart, what a plane through them leaves beyond their own variance, twice: once because a
    pixel's mean is not the texel's, and once for what is finer than the pixels.
    """
    return np.zeros_like(roughness) if pixel < ALONE else 2 * _beyond_plane(roughness, sigma, solved, _apart(pixel))


def between_paints(base: F32, sigma: F32, solved: Bool, pixel: float) -> F32:
    """(h, w) variance of base colour, the mean of ``base``'s channels, where it changes from texel to texel.

    Pictures show a texture interpolated between texels, and a texel's mean differs from what fits them best at each
    border of two paints, however small the pixels are.  Paint that bends steadily is interpolated well.
    """
    tone, apart = base.mean(-1), _apart(pixel)
    near, far = (_beyond_plane(tone, sigma, solved, steps) for steps in (apart, 2 * apart))
    return np.asarray(PAINT * np.clip((BENT * near - far) / (BENT - FARTHER), 0, near), np.float32)


def _apart(pixel: float) -> int:
    """Whole texels for the width of a pixel."""
    return int(np.clip(round(pixel), 1, MIXED))


def _beyond_plane(values: F32, sigma: F32, solved: Bool, apart: int) -> F32:
    """(h, w) what a plane through 3 x 3 texels, so many ``apart``, leaves beyond their own variance."""
    h, w = values.shape
    padded = np.pad(np.where(solved, values, np.nan), apart, mode="edge")
    variances = np.pad(np.where(solved, sigma * sigma, np.nan), apart, mode="edge")
    total, squares, along_x, along_y, own = (np.zeros((h, w), np.float32) for _ in range(5))
    for y, x in np.ndindex(3, 3):
        at = np.s_[apart * y:apart * y + h, apart * x:apart * x + w]
        off = np.nan_to_num(padded[at] - values)
        total += off
        squares += off * off
        along_x += (x - 1) * off
        along_y += (y - 1) * off
        own += np.where(np.isnan(variances[at]), sigma * sigma, variances[at]) / 9
    left = (squares - total**2 / 9 - (along_x**2 + along_y**2) / 6) / 6  # six degrees of freedom
    return np.asarray(np.where(solved, np.maximum(left - own, 0), 0), np.float32)
