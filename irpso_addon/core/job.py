"""A long job is a generator of Progress; whoever runs it owns the loop."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from typing import TypeVar

from .live_maps import Live

Result = TypeVar("Result")


@dataclass(frozen=True)
class Progress:
    """Where a job stands: ``fraction`` of the whole in 0..1, the ``stage`` word, a short ``message``.

    ``look`` tells what has been found so far; it may be called on the GL thread until the job's next step.  ``due``:
    this look is not to be missed, however lately there was another.
    """

    fraction: float
    stage: str
    message: str = ""
    look: Callable[[], Live] | None = field(default=None, compare=False, repr=False)
    due: bool = False


def retold(
    steps: Generator[Progress, None, Result], tell: Callable[[Progress], Progress],
) -> Generator[Progress, None, Result]:
    """A job as part of another, whose progress ``tell`` makes of its own.  A stop ends it: it has nothing to keep."""
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result
        yield tell(step)
