"""Two results beside each other in figures, and pictures made small enough to show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data import F16, F32, F64, Maps
from ..resampling import nearest

BRIGHT = 0.98
MOST = 256  # texels along a side that two results are compared at


@dataclass(frozen=True)
class Difference:
    """Of two results, over the texels that both have solved (all that both cover, where there is none)."""

    base_rms: float  # of base colour, linear, over texels and channels
    rough_mean: float  # of roughness, absolute
    rough_high: float  # 95 % of the texels differ by less
    texels: float  # share of the covered ones that is compared


def apart(first: Maps, second: Maps) -> Difference:
    """How far two results of one object are apart; at the coarser one's size, or MOST."""
    size = min(len(first.roughness), len(second.roughness), MOST)
    a, b = (_sampled(maps, size) for maps in (first, second))
    covered = (a[..., 4] > 0) & (b[..., 4] > 0)
    where = covered & (a[..., 5] == 0) & (b[..., 5] == 0)
    if not where.any():
        where = covered
    if not where.any():
        return Difference(float("nan"), float("nan"), float("nan"), 0.0)
    off = np.abs(a[where] - b[where])
    return Difference(
        base_rms=float(np.sqrt(np.mean(off[:, :3] ** 2))), rough_mean=float(off[:, 3].mean()),
        rough_high=float(np.quantile(off[:, 3], 0.95)), texels=float(where.sum() / covered.sum()))


def _sampled(maps: Maps, size: int) -> F64:
    """(size, size, 6) base colour, roughness, coverage, filled of the texels nearest to the coarse ones' centres."""
    layers = [maps.roughness, maps.coverage, maps.filled]
    thin = [nearest(layer, size).astype(np.float64)[..., None] for layer in layers]
    return np.concatenate([nearest(maps.base_color, size).astype(np.float64), *thin], -1)


def white(picture: F32 | F16) -> float:
    """The value of (h, w, 3) that a display should show as white: BRIGHT of the known pixels are darker."""
    picture = reduced(picture, 128)  # enough to tell, at a fraction of a millisecond
    known = picture.max(-1)[np.isfinite(picture).all(-1)]
    return max(float(np.quantile(known, BRIGHT)), 1e-6) if known.size else 1.0


def reduced(array: F32 | F16, most: int) -> F32 | F16:
    """Every n-th row and column of (h, w) or (h, w, c), so that neither side is longer than ``most``."""
    step = -(-max(array.shape[:2]) // most)
    return array[::step, ::step]
