"""Whether the brightest lights in a picture of high range are cut off."""

from __future__ import annotations

import numpy as np

from ..data import F32, F64

FEW = 10  # pixels: a sun's middle may show the same value so often
SLOPE, BELOW = 0.25, 2.0  # of the pixels that end at the top, as many lie at most so many octaves below: lights fade
CROWD, NEAR = 3.0, 1 / 24  # times as many pixels end there as lie just below, within so many octaves: few files do so
BINS, PLATEAU = 24, 0.05  # to an octave; what one of them adds to a slope, of the pixels at the top


class BrightestPixels:
    """Of a picture that comes in bands.

    A light that is cut off has a plateau, and a slope from there down to what is around it.  A soft box of one colour
    has no slope, and another one beside it is a plateau too.  Files whose values have few digits have neighbouring
    values about as often.
    """

    def __init__(self) -> None:
        self.top, self.at_top = 0.0, 0
        self._counts: dict[int, int] = {}  # pixels by the bin of their value, as far as they may matter

    def add(self, rgb: F32 | F64) -> None:
        """(..., 3) of a band; not negative."""
        values = rgb.max(-1).ravel()
        highest = float(values.max(initial=0))
        if highest > self.top:
            self.top, self.at_top = highest, 0
        if self.top == 0:
            return
        self.at_top += int((values == self.top).sum())
        bright: F32 | F64 = values[values > 2.0 ** -(BELOW + 1) * self.top]
        for at, count in zip(*np.unique(np.floor(BINS * np.log2(bright)).astype(int), return_counts=True), strict=True):
            self._counts[int(at)] = self._counts.get(int(at), 0) + int(count)

    def clipped(self) -> int:
        """Pixels at which a light seems to be cut off; 0: none."""
        if self.at_top < FEW:
            return 0
        cut = (self.at_top > CROWD * self._within(NEAR, self.at_top)
               and self._within(BELOW, max(PLATEAU * self.at_top, 1)) >= SLOPE * self.at_top)
        return self.at_top if cut else 0

    def _within(self, octaves: float, most: float) -> float:
        """Pixels that are so little below the top, those at the top aside, at most so many of each bin."""
        last = int(np.floor(BINS * np.log2(self.top)))
        first = last - round(BINS * octaves)
        counts = {**self._counts, last: self._counts.get(last, 0) - self.at_top}
        return sum(min(count, most) for at, count in counts.items() if first <= at <= last)
