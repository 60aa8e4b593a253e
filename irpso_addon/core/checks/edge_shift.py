"""By how much a picture lies beside a drawing of the mesh, told from edges alone, before any paint is known.

Where the picture has alpha or a mask, the drawing's edges are the object's outline and the creases of its normals,
whatever the lamps.  Else they are those of a white object under the view's lamps, since an outline in the dark is not
seen, or of the outline alone, since highlights and paint hide where a lamp's light ends: whichever lies clearer.
Where neither is clear in any view, the sum over views may be: wrong pictures have no shift in common.
Edges are compared by their directions, whichever side is the brighter one: the gradient, its angle doubled and its
length saturated, as in "orientation correlation" (Fitch, Kadyrov, Christmas, Kittler, BMVC 2002, without doubling).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..data import F32, F64
from .drawn_view import DrawnView
from .registration_fit import TILE, blurred
from .shoot_check import REACH

DRAWN, SEEN = 0.15, 0.06  # gradients by pixel at which an edge counts half: of drawings; of pictures, of their range
CLEAR = 7.0  # standard deviations of the window that a peak must stand above its mean
PEAK = 3  # pixels around the peak that are not the window
LEAST_OUTLINE = 8.0  # pixels of outline in a square of TILE
C64 = NDArray[np.complex64]


@dataclass(frozen=True)
class EdgeMatch:
    """How well the edges agree at each shift."""

    window: F64  # (2 REACH + 1, 2 REACH + 1) in standard deviations above the mean; no shift in the middle, rows up
    outlined: bool  # by alpha or a mask

    @property
    def shift(self) -> EdgeShift | None:
        """Where the picture's edges lie, to a fraction of a pixel; None where no place is clearly the best."""
        reach = len(self.window) // 2
        y, x = (int(n) for n in np.unravel_index(np.argmax(self.window), self.window.shape))
        inside = 0 < y < 2 * reach and 0 < x < 2 * reach
        if not inside or self.window[y, x] < CLEAR:
            return None
        dx, dy = _summit(self.window[y - 1:y + 2, x - 1:x + 2])
        return EdgeShift((x - reach + dx, y - reach + dy), self.outlined)


@dataclass(frozen=True)
class EdgeShift:
    """Pixels by which the picture's content lies to the right of and above the drawing."""

    shift: tuple[float, float]
    outlined: bool  # by alpha or a mask, to a tenth of a pixel; else to about a half


def match_of(drawn: DrawnView, irradiance: F32) -> EdgeMatch:
    """Of a view; ``irradiance`` (h, w) of its lights."""
    level = max(float(np.median(drawn.brightness[drawn.shown])), 1e-20) if drawn.shown.any() else 1.0
    coverage = drawn.image.coverage
    if has_outline(coverage):
        edges = _directed([drawn.share, *np.moveaxis(drawn.normal, -1, 0)], DRAWN)
        seen = _directed([_compressed(drawn.brightness, level) * coverage, coverage], SEEN)
        return edge_match(edges, seen, outlined=True)
    inside = drawn.covered.astype(np.float32)
    wide = np.where(drawn.covered, irradiance, blurred(irradiance) / np.maximum(blurred(inside), np.float32(1e-6)))
    lit = irradiance > 0.1 * irradiance.max()
    albedo = float(np.median(drawn.brightness[lit] / irradiance[lit])) if lit.any() else 1.0
    seen = _directed([_compressed(drawn.brightness, level)], SEEN)
    matches = (edge_match(_directed([_compressed(wide * np.float32(albedo), level) * drawn.share], SEEN), seen, False),
               edge_match(_directed([drawn.share], DRAWN), seen, False))
    return max(matches, key=lambda match: float(match.window.max()))


def together(matches: Sequence[EdgeMatch]) -> EdgeShift | None:
    """The shift that views have in common, none of which has a clear one by itself."""
    return EdgeMatch(_standardised(np.sum([match.window for match in matches], 0)), False).shift if matches else None


def has_outline(coverage: F32) -> bool:
    """Whether alpha or a mask (h, w) shows where the object ends."""
    return bool(coverage.min() < 0.25 and coverage.max() > 0.75)


def outline_distance(share: F32, coverage: F32) -> float | None:
    """Pixels between two outlines where they are farthest apart: a tenth of their parts is farther.

    In squares of TILE pixels, the area between them over their length.  ``share`` of each pixel that is drawn,
    ``coverage`` that the picture shows, (h, w) 0..1; None: there are none.
    """
    up, right = np.gradient(blurred(share))
    length, area = (_by_square(values) for values in (np.hypot(up, right), np.abs(share - coverage)))
    long = length > LEAST_OUTLINE
    return float(np.quantile(area[long] / length[long], 0.9)) if long.any() else None


def _by_square(values: F32) -> F64:
    """Sums of (h, w) over squares of TILE pixels."""
    starts = [np.arange(0, count, TILE) for count in values.shape]
    return np.asarray(np.add.reduceat(np.add.reduceat(values, starts[0], 0), starts[1], 1), np.float64)


def _compressed(brightness: F32, level: float) -> F32:
    """0..1, a half at ``level``: edges of dark and of bright places count alike."""
    bright = np.maximum(brightness, np.float32(0))
    return np.asarray(bright / (bright + np.float32(level)), np.float32)


def _directed(channels: list[F32], half: float) -> C64:
    """Doubled angles of the channels' gradients, together; lengths 0..1, ``half`` has the length 1/2."""
    total = np.zeros(channels[0].shape, np.complex64)
    for channel in channels:
        if channel.min() < channel.max():
            up, right = np.gradient(blurred(channel))
            total += (right + 1j * up) ** 2
    return np.asarray(total / (np.abs(total) + np.float32(half**2)), np.complex64)


def edge_match(drawn: C64, seen: C64, outlined: bool, reach: int = REACH) -> EdgeMatch:
    """By correlation, for shifts of up to ``reach`` pixels."""
    shape = [n + reach for n in drawn.shape]
    product = np.fft.ifft2(np.fft.fft2(seen, shape) * np.conj(np.fft.fft2(drawn, shape))).real
    window = np.roll(product, (reach, reach), (0, 1))[:2 * reach + 1, :2 * reach + 1]
    return EdgeMatch(_standardised(np.asarray(window, np.float64)), outlined)


def _standardised(window: F64) -> F64:
    """In standard deviations above the mean, both of what is not near the highest place."""
    y, x = np.unravel_index(np.argmax(window), window.shape)
    rows, columns = np.indices(window.shape)
    others = window[np.maximum(np.abs(rows - y), np.abs(columns - x)) > PEAK]
    return np.asarray((window - others.mean()) / max(float(others.std()), 1e-30))


def _summit(values: F64) -> tuple[float, float]:
    """Where the parabola (by axis) through 3 x 3 values, the middle one the greatest, has its top."""
    found = []
    for before, here, after in (values[1], values[:, 1]):
        bend = 2 * here - before - after
        found.append(float(np.clip((after - before) / (2 * bend), -0.5, 0.5)) if bend > 0 else 0.0)
    return found[0], found[1]
