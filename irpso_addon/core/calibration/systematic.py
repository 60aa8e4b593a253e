"""How much of what a fit leaves over is no noise: what texels apart from each other are off by alike."""

from __future__ import annotations

import numpy as np

from ..data import F64, I32, Bool

OUTLIER = 3.0  # standard deviations: a single texel counts no more
LEAST_PAIRS = 100


def systematic(left: F64, known: Bool, region: I32, square: I32) -> float:
    """Standard deviation of what the texels of a region are off by alike in a view.

    The mean product of pairs of texels in a region, in units of ``left`` (T, V).  Noise is not in it, because texels of
    a square, which may show the same pixels, make no pairs.  ``known`` (T, V): what counts; ``region``, ``square``
    (T,): numbers.
    """
    if not known.any():
        return 0.0
    most = OUTLIER * 1.4826 * float(np.median(np.abs(left[known])))
    value = np.where(known, np.clip(left, -most, most), 0.0)
    (alike, all_pairs), (near, near_pairs) = (_products(value, known, place) for place in (region, square))
    pairs = all_pairs - near_pairs
    return float(np.sqrt(max(alike - near, 0.0) / pairs)) if pairs >= LEAST_PAIRS else 0.0


def _products(value: F64, known: Bool, place: I32) -> tuple[float, float]:
    """Sum of the products of all pairs at a place in a view, and how many they are."""
    number = np.unique(place, return_inverse=True)[1]
    total, count = (np.stack([np.bincount(number, column) for column in part.T]) for part in (
        value, known.astype(np.float64)))
    return float((total**2).sum()), float((count**2).sum())
