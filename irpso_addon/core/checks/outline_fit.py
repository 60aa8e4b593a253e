"""How an object's outline in a picture differs from where its camera says that it should be.

Along the outline, the difference of the two areas is the displacement's part across it.  The displacement is that of a
camera which looks a little aside, whose focal length is off, which is turned about its axis, and whose lens bends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..check_records import CERTAIN
from ..data import F32, F64, Bool
from .registration_fit import CAUCHY, ROUNDS, WIDEST, blurred, by_tile, scale, tiles_of

ALIKE = 0.9  # least cosine between what a silhouette's slope is and what it should be
FLAT = 1e-4  # of 1: nearer to 0 or 1, a blurred outline's slope is far below the least that is looked at
BAND = 3  # pixels around a silhouette in which the image's must lie
LEAST_OUTLINE = 50  # pixels
PARTS = 0.05  # of 1: alpha nearer to 0 or 1 is that of a whole pixel
FEW_PARTS = 0.1  # of the pixels along an outline: where fewer are covered in part, its mask has whole pixels alone
LEAST_INSET = 0.25  # pixels: less is not told from growth
ROUND = 0.98  # squared correlation of inset and growth: that of outlines so round that they are the same
GROWTH, ROLL, BEND, INSET = range(2, 6)  # their places in `Outline.values`; the shift is before them

Pixels = NDArray[np.intp]  # (N,) places in a picture, row by row


class Optics(NamedTuple):
    """Of a camera with straight lines, in the pixels of its picture's part that is looked at."""

    axis: tuple[float, float]  # where it looks, from the lower left corner of the first pixel
    focal: float  # length


@dataclass(frozen=True)
class Outline:
    """The outline's displacement: shift x, y (pixels, at ``centre``), growth (relative), roll (radians), bend, inset.

    The growth and the roll (counter-clockwise) are about ``centre``.  The bend is what a lens's radial term k1 lacks.
    The inset (pixels) is what a mask that is drawn too small, or a mesh that is too large, looks like.
    """

    values: F64  # (6,)
    inverse: F64  # (6, 6) of the normal matrix of least squares
    covariance: F64  # (6, 6) of the values, by tiles
    centre: F64  # (2,) x, y of the outline, from the lower left corner of the first pixel
    optics: Optics | None  # None: the bend is not looked for
    whole: bool  # whether the mask has whole pixels alone: it may lie half a pixel beside the outline

    def bent(self, bend: float) -> Outline:
        """The same, where the bend is known; without an inset, unless that is beyond doubt.

        In a mask of whole pixels, a growth that an inset explains nearly as well is as unsure as without knowing it.
        """
        inset, error = self.values[INSET], self.covariance[INSET, INSET] ** 0.5
        alike = self.inverse[GROWTH, INSET] ** 2 / (self.inverse[GROWTH, GROWTH] * self.inverse[INSET, INSET])
        free = self._known([BEND], [bend])
        if alike < ROUND and abs(inset) > max(LEAST_INSET, CERTAIN * error):
            return free
        result = self._known([BEND, INSET], [bend, 0.0])
        if self.whole:
            result.covariance[GROWTH, GROWTH] = max(each.covariance[GROWTH, GROWTH] for each in (result, free))
        return result

    def _known(self, which: list[int], values: list[float]) -> Outline:
        """The same, where some values are known."""
        ratio = self.inverse[:, which] @ np.linalg.inv(self.inverse[np.ix_(which, which)])
        step = np.eye(6) - ratio @ np.eye(6)[which]
        return Outline(self.values - ratio @ (self.values[which] - values), self.inverse,
                       step @ self.covariance @ step.T, self.centre, self.optics, self.whole)

    @property
    def shift(self) -> F64:
        """(2,) pixels."""
        return self.values[:2]

    @property
    def shift_covariance(self) -> F64:
        """(2, 2) pixels squared."""
        return self.covariance[:2, :2]


def silhouette(share: F32, coverage: F32, optics: Optics | None = None) -> Outline | None:
    """The displacement of an object's outline in a picture; None where no outline can be seen.

    ``share`` (h, w) 0..1: of each pixel's square, what the object should cover; ``coverage`` (h, w) 0..1: the image's
    alpha or mask.
    """
    seen, drawn = blurred(blurred(coverage)), blurred(blurred(share))
    at = _between(drawn)
    slopes, slopes_drawn = _slopes(seen, at), _slopes(drawn, at)
    steep, steep_drawn = np.hypot(*slopes), np.hypot(*slopes_drawn)
    alike = (slopes * slopes_drawn).sum(0) > ALIKE * steep * steep_drawn  # not where a mask cuts the object
    near = np.flatnonzero((steep_drawn > 0.05) & (steep > 0.005) & alike)
    near = near[_at_edges(coverage, at[near])]
    at, across = at[near], (0.5 * (slopes + slopes_drawn)[:, near]).astype(np.float64)
    if len(at) < LEAST_OUTLINE:
        return None
    row, column = np.unravel_index(at, share.shape)
    place = np.stack([column, row]).astype(np.float64) + 0.5
    centre: F64 = place.mean(1, keepdims=True, dtype=np.float64)  # about which shift and growth are hardly correlated
    fields = _fields(place, centre, optics)
    widest = np.array([max(float(np.abs(field).max()), 1e-9) for field in fields])  # pixels by a value of 1
    slope = np.stack([*((across * field).sum(0) for field in fields), np.hypot(*across)])
    widest = np.append(widest, 1.0)
    slope /= widest[:, None]
    left = (drawn - seen).ravel()[at].astype(np.float64)
    weight = np.ones(len(at))
    for _ in range(2 * ROUNDS):
        inverse = np.linalg.inv((weight * slope) @ slope.T + np.eye(len(slope)) * WIDEST**-2)
        found = inverse @ (slope @ (weight * left))
        remains = left - found @ slope
        weight = 1.0 / (1.0 + (remains / (CAUCHY * scale(remains))) ** 2)
    tiles = tiles_of(row.astype(np.int32), column.astype(np.int32))
    scores = np.stack([by_tile(weight * remains * part, tiles) for part in slope])
    covariance = inverse @ (scores @ scores.T) @ inverse
    each = np.outer(widest, widest)
    along = coverage.ravel()[at]
    whole = bool(np.mean((along > PARTS) & (along < 1 - PARTS)) < FEW_PARTS)
    return Outline(found / widest, inverse / each, covariance / each, centre[:, 0], optics, whole)


def _between(drawn: F32) -> Pixels:
    """Where a blurred outline is neither 0 nor 1, but for BAND pixels along the picture's edges."""
    inside = np.zeros(drawn.shape, bool)
    middle = (slice(BAND, -BAND), slice(BAND, -BAND))
    inside[middle] = (drawn[middle] > FLAT) & (drawn[middle] < 1 - FLAT)
    return np.flatnonzero(inside)


def _at_edges(coverage: F32, at: Pixels) -> Bool:
    """(N,) whether an image has an edge within BAND of some pixels."""
    steps = np.arange(-BAND, BAND + 1)
    beside = coverage.ravel()[at[:, None] + (coverage.shape[1] * steps[:, None] + steps).ravel()]
    return np.asarray((beside.max(1) > 0.75) & (beside.min(1) < 0.25))


def _slopes(image: F32, at: Pixels) -> F32:
    """(2, N) to the right and upwards, by pixel."""
    values, width = image.ravel(), image.shape[1]
    return np.stack([np.float32(0.5) * (values[at + step] - values[at - step]) for step in (1, width)])


def _fields(place: F64, centre: F64, optics: Optics | None) -> list[F64]:
    """(2, N) pixels by which each of the first five values moves the outline's places."""
    x, y = place - centre
    one, none = np.ones_like(x), np.zeros_like(x)
    bend = np.stack([none, none])
    if optics is not None:
        away, middle = ((at - np.reshape(optics.axis, (2, 1))) / optics.focal for at in (place, centre))
        bend = optics.focal * (away * (away**2).sum(0) - middle * (middle**2).sum(0))
    return [np.stack([one, none]), np.stack([none, one]), np.stack([x, y]), np.stack([-y, x]), bend]
