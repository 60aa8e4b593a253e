"""Brightness along lines across an outline, and where it changes most: edges to a fraction of a pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..data import F64, Bool


def sampled(bright: F64, points: F64) -> F64:
    """``bright`` (h, w) at pixels (..., 2), bilinear; NaN beyond the centres of the outermost pixels."""
    height, width = bright.shape
    x, y = points[..., 0] - 0.5, points[..., 1] - 0.5
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = np.where(inside, x, 0), np.where(inside, y, 0)
    left, top = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    p, q = x - left, y - top
    value = ((1 - q) * ((1 - p) * bright[top, left] + p * bright[top, left + 1])
             + q * ((1 - p) * bright[top + 1, left] + p * bright[top + 1, left + 1]))
    return np.asarray(np.where(inside, value, np.nan))


def smooth(lines: F64, sigma: float) -> F64:
    """Gaussian of ``sigma`` samples along the last axis; NaN where it meets one, or the line's end."""
    reach = int(np.ceil(3 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    padded = np.pad(lines, [(0, 0), (reach, reach)], constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, len(kernel), axis=1)
    return np.asarray(windows @ (kernel / kernel.sum()))


def _inner_peaks(slopes: F64) -> Bool:
    """Where (lines, samples) rises to a sample and falls after it."""
    peaks = np.zeros(slopes.shape, bool)
    peaks[:, 1:-1] = (slopes[:, 1:-1] >= slopes[:, :-2]) & (slopes[:, 1:-1] > slopes[:, 2:])
    return peaks


def highest_peaks(slopes: F64, count: int) -> tuple[NDArray[np.intp], F64]:
    """Indices, rising, and heights (lines, count) of each line's highest peaks; height 0 where there are fewer."""
    heights = np.where(_inner_peaks(slopes), slopes, 0.0)
    at = np.sort(np.argsort(-heights, axis=1)[:, :count], axis=1)
    return at, np.take_along_axis(heights, at, 1)


def highest_peak(slopes: F64) -> tuple[F64, Bool]:
    """Where each line's highest peak lies, in samples, by a parabola; and whether there is one."""
    heights = np.where(_inner_peaks(slopes), slopes, 0.0)
    top = np.clip(heights.argmax(1), 1, slopes.shape[1] - 2)
    rows = np.arange(len(slopes))
    before, at, after = (slopes[rows, top + k] for k in (-1, 0, 1))
    with np.errstate(all="ignore"):
        shift = 0.5 * (before - after) / (before - 2 * at + after)
    found = heights[rows, top] > 0
    return np.asarray(top + np.where(np.isfinite(shift), np.clip(shift, -0.5, 0.5), 0.0)), found
