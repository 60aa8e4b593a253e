"""How far a job is and how long it still takes, as a person wants to be told: neither ever goes back.

Steps of a job are not of equal length, so that its fraction alone would stand still and then jump.  Before it begins
there is an estimate of its seconds; the fraction counts the more, the farther the job is.  Pauses do not count.
"""

from __future__ import annotations

import time
from collections.abc import Callable

TELLING = 0.05  # fraction from which on a job without an estimate tells how long it takes
AHEAD = 2.0  # so many times the job's own fraction may be told
CREEP = 0.004  # share of the rest that it goes on each second at least, so that nobody takes it for dead
MOST = 0.99  # fraction that is told before the end
MORE = 1.03  # a job that is not over takes at least so many times what it has taken


class RunningTime:
    """The time of one job.  ``expected``: seconds that it is estimated to take; None: nobody knows."""

    def __init__(self, expected: float | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.expected, self._clock = expected, clock
        self._began, self._held, self._updated = clock(), 0.0, 0.0
        self._since = 0.0  # when the present pause began; 0: none
        self.fraction = 0.0
        self.left: float | None = None  # seconds; None: cannot be told yet

    @property
    def seconds(self) -> float:
        """Since it began, pauses left out."""
        now = self._clock()
        return now - self._began - self._held - (now - self._since if self._since else 0.0)

    def pause(self, on: bool) -> None:
        """A pause begins or ends."""
        if on and not self._since:
            self._since = self._clock()
        elif not on and self._since:
            self._held, self._since = self._held + self._clock() - self._since, 0.0

    def update(self, done: float) -> None:
        """The job's own ``done``, of 1."""
        seconds = self.seconds
        total = self._total(done, seconds)
        reached = done if total is None else min(seconds / total, AHEAD * done + 0.1)
        crept = self.fraction + (MOST - self.fraction) * CREEP * max(seconds - self._updated, 0.0)
        self.fraction, self._updated = max(self.fraction, min(crept, MOST), min(reached, MOST)), seconds
        if total is not None:
            left = total - seconds
            self.left = left if self.left is None else min(self.left, left)

    def _total(self, done: float, seconds: float) -> float | None:
        """What it takes in all."""
        by_work = seconds / done if done > TELLING and seconds > 0 else None
        if self.expected is None:
            return by_work
        total = self.expected
        if by_work is not None:
            overdue = seconds / max(self.expected, 1e-3) - 0.75  # an estimate that is over says nothing any more
            share = min(max(done**2, overdue), 1.0)
            total = self.expected ** (1 - share) * by_work**share
        return max(total, MORE * seconds, 1e-3)
