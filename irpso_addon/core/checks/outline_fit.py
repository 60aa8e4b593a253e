"""How an object's outline in a picture differs from where its camera says that it should be.

Along the outline, the difference of the two areas is the displacement's part across it.  The displacement is that of a
camera which looks a little aside, whose focal length is off, which is turned about its axis, and whose lens bends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..check_records import CERTAIN
from ..data import F32, F64
from .registration_fit import CAUCHY, ROUNDS, WIDEST, around, blurred, by_tile, scale, tiles_of

ALIKE = 0.9  # least cosine between what a silhouette's slope is and what it should be
BAND = 3  # pixels around a silhouette in which the image's must lie
LEAST_OUTLINE = 50  # pixels
PARTS = 0.05  # of 1: alpha nearer to 0 or 1 is that of a whole pixel
FEW_PARTS = 0.1  # of the pixels along an outline: where fewer are covered in part, its mask has whole pixels alone
LEAST_INSET = 0.25  # pixels: less is not told from growth
ROUND = 0.98  # squared correlation of inset and growth: that of outlines so round that they are the same
GROWTH, ROLL, BEND, INSET = range(2, 6)  # their places in `Outline.values`; the shift is before them


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
    (up, right), (up_drawn, right_drawn) = np.gradient(seen), np.gradient(drawn)
    steep, steep_drawn = np.hypot(up, right), np.hypot(up_drawn, right_drawn)
    alike = up * up_drawn + right * right_drawn > ALIKE * steep * steep_drawn  # not where a mask cuts the object
    up, right = 0.5 * (up + up_drawn), 0.5 * (right + right_drawn)
    lowest, highest = coverage, coverage
    for _ in range(BAND):
        lowest, highest = around(lowest, np.minimum), around(highest, np.maximum)
    near = (steep_drawn > 0.05) & (steep > 0.005) & alike & (highest > 0.75) & (lowest < 0.25)
    near[:BAND], near[-BAND:], near[:, :BAND], near[:, -BAND:] = False, False, False, False
    at = np.flatnonzero(near)
    if len(at) < LEAST_OUTLINE:
        return None
    row, column = np.unravel_index(at, share.shape)
    place = np.stack([column, row]).astype(np.float64) + 0.5
    centre: F64 = place.mean(1, keepdims=True, dtype=np.float64)  # about which shift and growth are hardly correlated
    across = np.stack([right.ravel()[at], up.ravel()[at]]).astype(np.float64)
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


def _fields(place: F64, centre: F64, optics: Optics | None) -> list[F64]:
    """(2, N) pixels by which each of the first five values moves the outline's places."""
    x, y = place - centre
    one, none = np.ones_like(x), np.zeros_like(x)
    bend = np.stack([none, none])
    if optics is not None:
        away, middle = ((at - np.reshape(optics.axis, (2, 1))) / optics.focal for at in (place, centre))
        bend = optics.focal * (away * (away**2).sum(0) - middle * (middle**2).sum(0))
    return [np.stack([one, none]), np.stack([none, one]), np.stack([x, y]), np.stack([-y, x]), bend]
