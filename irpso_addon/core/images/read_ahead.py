"""Pictures read by other threads, ahead of the one that is looked at: large ones take seconds each."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Generic, TypeVar

from ..job import Progress, Steps
from . import decoder_pool

READERS = 2  # pictures that are read at a time
WAIT = 0.1  # seconds between two steps of who waits for one

Item = TypeVar("Item")
Read = TypeVar("Read")


class ReadAhead(Generic[Item, Read]):
    """What ``read`` makes of ``items``, in order.  Leaving it ends what is still to be read."""

    def __init__(self, read: Callable[[Item], Read], items: Iterable[Item], readers: int = READERS) -> None:
        self._read, self._left, self._readers = read, iter(items), readers
        self._waiting: deque[Future[Read]] = deque()
        self._stop = threading.Event()
        self._threads = ThreadPoolExecutor(readers, "irpso-pictures")

    def __enter__(self) -> ReadAhead[Item, Read]:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._threads.shutdown(wait=True, cancel_futures=True)

    def next(self, step: Progress) -> Steps[Read]:
        """The next one; gives ``step`` again and again while it waits.  Raises what ``read`` has raised of it."""
        for item in self._left:
            self._waiting.append(self._threads.submit(self._one, item))
            if len(self._waiting) > self._readers:
                break
        job = self._waiting.popleft()
        while not job.done():
            with suppress(TimeoutError):
                return job.result(WAIT)
            yield step
        return job.result()

    def _one(self, item: Item) -> Read:
        with decoder_pool.until(self._stop):
            return self._read(item)
