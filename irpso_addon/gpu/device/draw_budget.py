"""How much of a draw is drawn at a time: about as much as takes a slice (core/params.py), by what it took before.

So a window stays alive, a stop is heard soon, and no driver takes the device for hung.  What is drawn does not depend
on how it is divided: every pixel is computed for itself.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager

import numpy as np

from ...core.data import F32

Rectangle = tuple[int, int, int, int]  # x, y, width, height

FIRST = 1024.0  # units of a kind of draw before its speed is known
GROWTH = 4.0  # at most, from one measured piece to the next: a dear part may follow upon cheap ones
WORTH = 0.25  # of a slice; shorter pieces are not waited for one by one, and say little of how slow a draw is
LONGEST = 50.0  # ms; the most that is aimed at, whatever slice is asked for: half of what a piece may take


class DrawBudget:
    """Knows how fast each kind of draw is here.

    Units are what the caller likes, and alike in cost: pixels, or observations.  ``finish`` waits for the device.
    """

    def __init__(self, finish: Callable[[], None], slice_ms: float) -> None:
        self._finish = finish
        self.on_piece: Callable[[Hashable, float], None] | None = None  # hears of every piece: what, and its seconds
        self._seconds: dict[Hashable, float] = {}  # for a unit, rather too many than too few
        self._compiled: set[Hashable] = set()  # kinds that were drawn once: the first time may hold the compiler's work
        self._waiting = 0.0  # seconds of pieces that have not been waited for
        self.choose(slice_ms)

    def choose(self, slice_ms: float) -> None:
        """The time of a slice; infinite: nothing is divided."""
        self.slice = (slice_ms if math.isinf(slice_ms) else min(slice_ms, LONGEST)) / 1000

    def most(self, key: Hashable, first: float = FIRST) -> float:
        """Units that fit into a slice; ``first``, while nothing is known."""
        if math.isinf(self.slice):
            return math.inf
        return self.slice / self._seconds[key] if key in self._seconds else first

    @contextmanager
    def piece(self, key: Hashable, units: float) -> Iterator[None]:
        """One piece is drawn within; waits for it where that is worth it."""
        expected = units * self._seconds.get(key, math.inf)
        measured = expected > WORTH * self.slice or self.on_piece is not None
        if self._waiting and (measured or self._waiting + expected > self.slice):
            self.finish()
        start = time.perf_counter()
        yield
        if not measured:
            self._waiting += expected
            return
        self.finish()
        self._learn(key, units, time.perf_counter() - start)

    def forget(self, gone: Callable[[Hashable], bool]) -> None:
        """Of these kinds of draw nothing is known any more: their programs were given back."""
        for key in filter(gone, tuple(self._compiled)):
            self._compiled.discard(key)
            self._seconds.pop(key, None)

    def finish(self) -> None:
        """Wait for everything that has been drawn."""
        self._finish()
        self._waiting = 0.0

    def _learn(self, key: Hashable, units: float, took: float) -> None:
        if self.on_piece is not None:
            self.on_piece(key, took)
        if key not in self._compiled:
            self._compiled.add(key)
            return
        rate = took / max(units, 1.0)
        known = self._seconds.get(key, rate)
        if took < WORTH * self.slice:  # mostly waiting: only says that it is not slower
            rate = min(rate, known)
        self._seconds[key] = max(rate, known / GROWTH)


def rectangles(
    region: Rectangle, most: Callable[[], float], work: F32 | None = None,
) -> Iterator[tuple[Rectangle, float]]:
    """Divide a region into rows, or parts of a row where one is too much: (rectangle, its units).

    ``most``: units of the next one, asked again for each.  ``work``: units of each row of the region; None: its pixels.
    """
    x, y, width, height = region
    if work is None and 0 < width * height <= most():
        yield region, float(width * height)
        return
    ahead = np.cumsum(np.full(height, float(width)) if work is None else work, dtype=np.float64)
    done, row = 0.0, 0
    while row < height:
        allowed = most()
        end = int(np.searchsorted(ahead, done + allowed, side="right"))
        if end > row:
            yield (x, y + row, width, end - row), float(ahead[end - 1] - done)
        else:
            end, units = row + 1, float(ahead[row] - done)
            step = max(int(width * allowed / units), 1)
            for left in range(0, width, step):
                part = min(step, width - left)
                yield (x + left, y + row, part, 1), units * part / width
        done, row = float(ahead[end - 1]), end
