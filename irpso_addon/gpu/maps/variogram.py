"""How far a roughness may be off that a texel has from its neighbours, not from its own data.

The neighbours' prior assumes how much roughness changes across a map.  How much it does change is measured here, on
the texels that their own data determine, as a variogram (Matheron 1963, "Principles of geostatistics", eq. 1; here the
mean square itself, without the half): the mean square difference of two texels of a material by their distance.
Where texels of one colour differ far less, those of other colours do not count: docs/decisions/0049.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...core.data import F32, F64, I32, Bool
from ..solve.colour_kinds import KINDS, colour_kinds

DISTANCES = (1, 2, 4, 8, 16, 32)  # texels; the last is what a block solves around itself
INFORMED = 0.5  # share that a texel's own data determine, from which on it tells of the material
LEAST_PAIRS = 50.0
KINDS_TELL = 0.5  # of the whole material's variogram: if that of texels of one kind is less, base colour tells


def borrowed_variance(
    roughness: F32, sigma: F32, share: F32, slots: I32, pixel: float, base: F32,
) -> tuple[F32, Bool]:
    """(variance of roughness because it is the neighbours', where that is known), (h, w) each.

    ``share``: 0..1, how far the texel's own data determine its roughness.  ``slots``: material of each solved texel, -1
    elsewhere.  ``pixel``: width of a pixel in texels.  ``base``: (h, w, 3) base colour.

    With a normal prior of variance P the posterior's is (1 - share) P.  P is the material's mean square difference over
    the distance of the nearest data or, where that is larger, the mean square difference of the texels as near as that.
    Texels nearer than a pixel repeat its data: that many count once, and none is nearer than a pixel.  It is not known
    where no texels of the material are informed.
    Where base colour tells roughness, the material is the texels of one kind of colour, if such data are near.
    """
    variance, known = np.zeros_like(roughness), np.ones(roughness.shape, bool)
    for slot in np.unique(slots[slots >= 0]):
        rows, columns = (np.flatnonzero((slots == slot).any(axis)) for axis in (1, 0))
        at = np.s_[rows[0]:rows[-1] + 1, columns[0]:columns[-1] + 1]
        mine = slots[at] == slot
        r, s, own = (np.where(mine, a[at], 0).astype(np.float64) for a in (roughness, sigma, share))
        weight = np.where(own > INFORMED, own, 0)
        curve = variogram(r, s, weight)
        if curve is None:
            known[at] &= ~mine
            continue
        found, _ = _of_prior(r, own, mine, curve, max(pixel, 1.0))
        kinds = colour_kinds(base[at], mine)
        alike = variogram(r, s, weight, kinds)
        if alike is not None and alike.sum() < KINDS_TELL * curve.sum():
            found = np.minimum(found, _of_kinds(r, own, kinds, alike, max(pixel, 1.0))[mine])
        variance[at][mine] = (1 - share[at][mine]) * found
    return variance, known


def variogram(roughness: F64, sigma: F64, weight: F64, kinds: I32 | None = None) -> F64 | None:
    """Mean square difference at each of DISTANCES, beyond the texels' own variances; never falls; None: too few pairs.

    Of (h, w) texels; those of weight 0 do not count.  ``kinds``: pairs of two kinds do not count.
    """
    found = []
    for apart in DISTANCES:
        sums = np.zeros(2)
        for a, b in ((np.s_[:, apart:], np.s_[:, :-apart]), (np.s_[apart:], np.s_[:-apart])):
            both = weight[a] * weight[b] * (True if kinds is None else kinds[a] == kinds[b])
            square = (roughness[a] - roughness[b]) ** 2 - sigma[a] ** 2 - sigma[b] ** 2
            sums += ((both * square).sum(), both.sum())
        found.append(max(sums[0] / sums[1], 0.0) if sums[1] > LEAST_PAIRS else np.nan)
    values = np.array(found)
    measured = ~np.isnan(values)
    if not measured.any():
        return None
    return np.maximum.accumulate(np.interp(DISTANCES, np.array(DISTANCES)[measured], values[measured]))


def _of_kinds(roughness: F64, share: F64, kinds: I32, curve: F64, pixel: float) -> F64:
    """`_of_prior` of the texels of each kind; infinite where no data of a texel's own kind are near."""
    found = np.full(kinds.shape, np.inf)
    for kind in range(KINDS):
        its = kinds == kind
        if its.any():
            variance, near = _of_prior(roughness, share, its, curve, pixel)
            found[its] = np.where(near, variance, np.inf)
    return found


def _of_prior(roughness: F64, share: F64, its: Bool, curve: F64, pixel: float) -> tuple[F64, Bool]:
    """(variance of the prior, whether data are near), (N,) each, of the texels ``its``, which alone count.

    ``roughness``, ``share``: (h, w).  ``curve``: their variogram.
    """
    around, own = _Windows(its), roughness[its]
    values = np.where(its, roughness, 0)
    data, texels, total, squares = (around.integral(a) for a in (
        np.where(its, share, 0), its.astype(np.float64), values, values**2))
    distance, differ, known = np.full(own.shape, float(DISTANCES[-1])), np.zeros(own.shape), np.ones(own.shape, bool)
    left = np.arange(len(own))
    for apart in DISTANCES:
        near = around.sums(data, apart, left) >= pixel**2
        here = left[near]
        distance[here] = np.minimum(distance[here], apart)
        if apart < pixel:
            continue
        left = left[~near]
        if apart == DISTANCES[-1]:
            known[left] = False
            here = np.concatenate([here, left])
        count = around.sums(texels, apart, here)
        mean, square = (around.sums(a, apart, here) / count for a in (total, squares))
        differ[here] = np.maximum(square - 2 * own[here] * mean + own[here] ** 2, 0)
    distance = np.maximum(distance, np.ceil(pixel))
    return np.maximum(np.interp(distance, DISTANCES, curve), differ), known


class _Windows:
    """Sums over squares around some texels, from integral images (Crow 1984, "Summed-area tables", eq. 1)."""

    def __init__(self, texels: Bool) -> None:
        """``texels``: (h, w)."""
        self.margin = DISTANCES[-1]
        self.width = texels.shape[1] + 2 * self.margin + 1
        row, column = np.nonzero(texels)
        self.at = row * self.width + column  # of each texel's upper left corner, less a margin

    def integral(self, values: F64) -> F64:
        """Of (h, w) values: the sums of all above and to the left, with a margin all around; flat."""
        sums = np.zeros((len(values) + 2 * self.margin + 1, self.width))
        inside = sums[self.margin + 1:, self.margin + 1:]
        inside[:len(values), :values.shape[1]] = values
        np.cumsum(inside, 0, out=inside)
        np.cumsum(inside, 1, out=inside)
        return sums.ravel()

    def sums(self, integral: F64, apart: int, which: NDArray[np.int64]) -> F64:
        """(N,) over so many texels to each side of some of the texels."""
        low, high, at = self.margin - apart, self.margin + apart + 1, self.at[which]
        above, below = ([integral.take(at + (y * self.width + x)) for x in (low, high)] for y in (low, high))
        return np.asarray((below[1] - above[1]) - (below[0] - above[0]))
