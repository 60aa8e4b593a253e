"""Least squares for registration: shifts and gains of views from their pixels; see registration.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..data import F32, F64, I32, Bool

BINOMIAL = (1 / 16, 4 / 16, 6 / 16)  # sigma 1 pixel: what is aliased in the prediction averages out
ALIASING = 0.2  # pixels: how far an edge in the prediction may lie from the true one
DARK = 0.1  # of the typical radiance: added to a pixel's own, for errors relative to it
TILE = 32  # pixels: errors this far apart are independent
ROUNDS = 3
FEWEST_SPARE = 0.25  # tiles beside the first that a variance is taken to come from, at least
CAUCHY = 2.4  # standard deviations at which a pixel has lost half its weight: 95 % efficient for normal errors
LEAST_PIXELS = 12  # of a view: from fewer it tells nothing
RIDGE = 1e-9  # of the largest: what the normal matrix's diagonal has at least
WIDEST = 10.0  # pixels: prior of shifts, so that nothing to see gives a large error instead of nonsense
BINS = 64  # by BINS, over the UV square: what two cameras show of it is compared
Image = TypeVar("Image", F32, Bool)
ViewFit = tuple[F64, F64]  # shift (2,) and its covariance (2, 2), pixels


@dataclass(frozen=True)
class Fit:
    """Of one camera's V views at N pixels."""

    shift: F64  # (V, 2) pixels, right and up
    covariance: F64  # (V, 2, 2)
    log_gain: F64  # (V,) mean 0
    gain_error: F64  # (V,)
    factor: F64  # (N,) brightness that all views show over the predicted
    noise: float  # what is left, relative: robust, the median of the views


def fit_views(seen: F64, factor: F64, tiles: I32, free: bool = True) -> Fit:
    """Shifts and gains of views that share their pixels.

    ``seen`` (4, V, N): predicted radiance, its slopes to the right and upwards (by pixel), observed; NaN where a view
    tells nothing.  ``factor`` (3, N): observed brightness over the predicted, and its slopes.  ``tiles`` (N,): groups
    of pixels that share their errors.

    To first order observed = (factor + df) predicted + gain * factor predicted - slope . shift, where the slope is
    that of factor times prediction; df of each pixel is eliminated (not ``free``: it is 0).
    """
    known = np.isfinite(seen).all(0)
    predicted, right, up, observed = np.where(known, seen, 0.0)
    expected = factor[0] * predicted
    columns = np.stack([-factor[0] * right - predicted * factor[1], -factor[0] * up - predicted * factor[2], expected])
    lit = expected[expected > 0]
    level = np.abs(expected) + DARK * (float(np.median(lit)) if len(lit) else 1.0)
    edges = ALIASING**2 * (columns[:2] ** 2).sum(0)
    left = (observed - expected) * known
    noise = np.full((len(known), 1), 0.01)
    weight = known / ((noise * level) ** 2 + edges)
    for _ in range(ROUNDS):
        solved, inverse, remains, change = _projected(columns, predicted, left, weight, free)
        noise = np.array([[scale(r[t])] for r, t in zip(remains / level, known, strict=True)])
        sure = known / ((noise * level) ** 2 + edges)
        spread = max(scale((remains * np.sqrt(sure))[known]), 1e-6)
        weight = sure / spread**2 / (1.0 + remains**2 * sure / (CAUCHY * spread) ** 2)
    views = len(known)
    scores = np.stack([by_tile(weight[v] * column[v] * remains[v], tiles) for column in columns for v in range(views)])
    covariance = inverse @ (scores @ scores.T) @ inverse
    blind = np.tile(known.sum(axis=1) < LEAST_PIXELS, 3)  # views that tell nothing: clipped, masked, not seen
    covariance = np.where(blind | blind[:, None], 0.0, covariance) + np.diag(np.where(blind, WIDEST**2, 0.0))
    variance = np.maximum(np.diag(covariance), 0.0)
    pairs = np.arange(views)[:, None] + np.array([0, views])
    gains = np.log1p(np.maximum(solved[2 * views:], -0.9))
    variance[2 * views:] *= _for_few(scores[2 * views:])
    return Fit(
        shift=solved[:2 * views].reshape(2, views).T, covariance=covariance[pairs[:, :, None], pairs[:, None, :]],
        log_gain=gains - gains.mean(), gain_error=np.sqrt(variance[2 * views:]), factor=factor[0] + change,
        noise=float(np.median(noise)))


def _for_few(scores: F64) -> F64:
    """(V,) by how much a variance from scores (V, tiles) is too small where few tiles say most: a fit's sum to 0.

    A view that is lit from behind shows its exposure in two or three tiles.  Their effective number is Kish's (1965).
    """
    squares = scores**2
    count = np.maximum(squares.sum(1) ** 2 / np.maximum((squares**2).sum(1), 1e-300), 1.0)
    return np.asarray(count / np.maximum(count - 1, FEWEST_SPARE))


def _projected(columns: F64, predicted: F64, left: F64, weight: F64, free: bool) -> tuple[F64, F64, F64, F64]:
    """Weighted least squares with each pixel's brightness eliminated.

    Returns the 3 V unknowns, the inverse of their normal matrix, what remains (V, N) and the pixels' changes (N,).
    """
    count, views = len(columns), len(left)
    total = np.maximum((weight * predicted**2).sum(0), 1e-30) if free else np.full(predicted.shape[1], np.inf)
    across = weight * predicted * columns  # (3, V, N)
    flat = (across / np.sqrt(total)).reshape(count * views, -1)
    normal = -(flat @ flat.T)
    for a in range(count):
        for b in range(count):
            at = np.arange(views)
            normal[a * views + at, b * views + at] += (weight * columns[a] * columns[b]).sum(1)
    normal[np.diag_indices(2 * views)] += WIDEST**-2
    normal[2 * views:, 2 * views:] += max(np.trace(normal[2 * views:, 2 * views:]), 1.0) / views**2  # gains: mean 0
    blind = np.tile((weight > 0).sum(axis=1) < LEAST_PIXELS, count)
    normal[np.diag_indices(count * views)] += np.where(blind, 1.0, RIDGE) * normal.diagonal().max()
    rest = left - predicted * ((weight * predicted * left).sum(0) / total)
    inverse = np.linalg.inv(normal)
    solved = inverse @ (weight * columns * rest).sum(-1).reshape(-1)
    remains = left - (columns * solved.reshape(count, views, 1)).sum(0)
    change = (weight * predicted * remains).sum(0) / total
    return solved, inverse, (remains - predicted * change) * (weight > 0), change


def scale(values: F64) -> float:
    """Robust standard deviation (from the median of absolute values)."""
    return 1.4826 * float(np.median(np.abs(values))) + 1e-6 if len(values) else 1.0


def by_tile(values: F64, tiles: I32) -> F64:
    """Sums over the pixels of each tile."""
    return np.bincount(tiles, values, minlength=int(tiles.max(initial=0)) + 1)


def tiles_of(rows: I32, columns: I32) -> I32:
    """(N,) number of the TILE by TILE square that each pixel lies in."""
    return np.asarray(np.unique(rows // TILE * 65536 + columns // TILE, return_inverse=True)[1], np.int32)


def blurred(image: F32) -> F32:
    """``image`` (h, w) through a binomial filter of 5 x 5, its edges repeated."""
    first, second, third = (np.float32(k) for k in BINOMIAL[:3])
    part = np.empty_like(image)
    for axis in (0, 1):
        wide = np.pad(image, [(2, 2) if a == axis else (0, 0) for a in (0, 1)], mode="edge")
        rows = [_rows(wide, n, image.shape[axis], axis) for n in range(5)]
        image = rows[0] + rows[4]
        image *= first
        image += np.multiply(third, rows[2], out=part)
        image += np.multiply(second, np.add(rows[1], rows[3], out=part), out=part)
    return image


def eroded(mask: Bool, steps: int) -> Bool:
    """Without what lies within so many pixels (by rows and columns) of anything outside.  Edges are repeated."""
    for _ in range(steps):
        for axis in (0, 1):
            wide = np.pad(mask, [(1, 1) if a == axis else (0, 0) for a in (0, 1)], mode="edge")
            one, two, three = (_rows(wide, n, mask.shape[axis], axis) for n in range(3))
            mask = one & two & three
    return mask


def _rows(image: Image, first: int, count: int, axis: int) -> Image:
    """Rows (axis 0) or columns (axis 1) of an image."""
    return image[first:first + count] if axis == 0 else image[:, first:first + count]


def gain_of_cameras(cameras: list[tuple[F32, F64]]) -> F64:
    """(C,) logarithm of each camera's gain, mean 0: by what several of them show of the same places.

    For each camera ``uv`` (N, 2) of its pixels and their brightness over the predicted (N,).  The places' own
    brightness is eliminated: alternating medians over places and cameras (Tukey's median polish).
    """
    table = np.full((len(cameras), BINS * BINS), np.nan)
    for row, (uv, factor) in zip(table, cameras, strict=True):
        good = factor > 1e-3
        place = np.clip((uv[good] * BINS).astype(int), 0, BINS - 1) @ np.array([1, BINS])
        count = np.bincount(place, minlength=BINS * BINS)
        mean = np.bincount(place, np.log(factor[good]), minlength=BINS * BINS) / np.maximum(count, 1)
        row[count >= 3] = mean[count >= 3]
    shared = table[:, np.isfinite(table).sum(0) > 1]
    gains = np.zeros(len(cameras))
    for _ in range(20 if shared.size else 0):
        places = np.nanmean(shared - gains[:, None], axis=0)
        for n, row in enumerate(shared - places):
            gains[n] = np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else 0.0
        gains -= gains.mean()
    return gains
