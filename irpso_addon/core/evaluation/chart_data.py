"""What a chart of error against time shows, whoever draws it: matplotlib on the command line, Blender in its window."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

# Okabe and Ito's palette: told apart with any colour vision; the seventh is the ink of the page.
COLOURS = ("#0072B2", "#56B4E9", "#009E73", "#D55E00", "#E69F00", "#CC79A7", "#000000")
MARKS = 8  # of an axis, at most


@dataclass(frozen=True)
class Curve:
    """One method in one panel.  ``seconds`` None: a level drawn across, of what has no time worth a point."""

    label: str
    place: int  # its colour and marker, the same in every panel
    seconds: Sequence[float] | None
    values: Sequence[float]
    notes: Sequence[str] = ()  # beside each point
    hollow: Sequence[float | None] = ()  # another value of each point, or none: a mark that is not filled

    def hollows(self) -> list[tuple[float, float]]:
        """(seconds, value) of the marks that are not filled."""
        return [(s, v) for s, v in zip(self.seconds or (), self.hollow, strict=False) if v is not None]


@dataclass(frozen=True)
class Panel:
    """One error."""

    title: str
    curves: list[Curve]
    log: bool = False
    up: bool = False  # whether more is better


@dataclass(frozen=True)
class Chart:
    """Panels side by side under one title."""

    title: str
    panels: tuple[Panel, ...]
    foot: str = ""  # machine, versions, date


def log_ticks(low: float, high: float) -> list[float]:
    """Marks of a logarithmic axis from ``low`` to ``high``, both above 0: 1, 2, 5 of each decade, or decades alone."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    decades = [10.0**decade for decade in range(first, last + 1)]
    marks = [mark for decade in decades for mark in (decade, 2 * decade, 5 * decade) if low <= mark <= high]
    return marks if len(marks) <= MARKS else [mark for mark in decades if low <= mark <= high]


def linear_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """At most ``most`` round marks of an axis from ``low`` to ``high``."""
    rough = (high - low) / most
    decade = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * decade for factor in (1.0, 2.0, 5.0, 10.0) if factor * decade >= rough)
    return [step * i for i in range(math.ceil(low / step), math.floor(high / step) + 1)]
