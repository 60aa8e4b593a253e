"""A long job is a generator of Progress; whoever runs it owns the loop.

Stopped, the runner throws Cancelled into it, once, where it waits: the job may answer with what it has, or let it pass.
A job made of others hands that on to the one that works, by `mapped`.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from .errors import Cancelled
from .live_maps import Live

Result = TypeVar("Result")


@dataclass(frozen=True)
class Progress:
    """Where a job stands: ``fraction`` of the whole in 0..1, the ``stage`` word, a short ``message``.

    ``look`` tells what has been found so far; it may be called on the GL thread until the job's next step.  ``due``:
    this look is not to be missed, however lately there was another.  ``block`` of a solve in blocks: which one is
    solved now, counted from 1, and of how many.
    """

    fraction: float
    stage: str
    message: str = ""
    look: Callable[[], Live] | None = field(default=None, compare=False, repr=False)
    due: bool = False
    block: tuple[int, int] | None = None


Steps = Generator[Progress, None, Result]
WORDS = {  # what users read of a stage; the others are words already
    "headers": "opening pictures", "gbuffer": "drawing the mesh", "observe": "reading pictures",
    "pictures": "developing pictures", "cameras": "checking cameras", "calibrate": "checking lamps",
    "normals": "checking normals", "solve": "solving", "maps": "making maps", "indirect": "rendering bounced light",
    "indirect_test": "looking for bounced light", "merge": "joining blocks", "write": "writing files",
}


def doing(stage: str) -> str:
    """What a stage does, in words."""
    return WORDS.get(stage, stage)


def mapped(steps: Steps[Result], transform: Callable[[Progress], Progress], *, keeps: bool = True) -> Steps[Result]:
    """A job as part of another, its progress as ``transform`` makes it.

    Cancelled goes on to ``steps``, which may answer with a value.  Not ``keeps``: they would have nothing to keep, and
    a stop ends them where they are.  Left in any other way than by their end, they are closed.
    """
    stop: Cancelled | None = None
    try:
        while True:
            try:
                step = next(steps) if stop is None else steps.throw(stop)
            except StopIteration as end:
                result: Result = end.value
                return result
            changed, stop = transform(step), None
            try:
                yield changed
            except Cancelled as asked:
                if not keeps:
                    raise
                stop = asked
    finally:
        steps.close()


def retold(steps: Steps[Result], transform: Callable[[Progress], Progress]) -> Steps[Result]:
    """`mapped`, of what has nothing to keep."""
    return mapped(steps, transform, keeps=False)


def share_of(steps: Steps[Result], begin: float, end: float) -> Steps[Result]:
    """A job as that part of the whole."""
    return retold(steps, lambda step: replace(step, fraction=begin + (end - begin) * step.fraction))


def run_to_end(steps: Steps[Result], show: Callable[[Progress], object]) -> Result:
    """A job on the calling thread, its progress shown.  Closed where ``show`` raises."""
    try:
        while True:
            try:
                show(next(steps))
            except StopIteration as end:
                result: Result = end.value
                return result
    finally:
        steps.close()


class Mailbox:
    """What a running job is handed from outside, on any thread: the latest counts."""

    def __init__(self) -> None:
        self._items: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def put(self, item: object) -> None:
        """Hand something in."""
        self._items.put(item)

    def take(self, seconds: float) -> Any | None:
        """The latest that was handed in since the last call, waited for at most so long; None: nothing."""
        item = None
        with suppress(queue.Empty):
            item = self._items.get(timeout=seconds)
            while True:
                item = self._items.get_nowait()
        return item
