"""What a farm hears of a task: lines that the Open Job Description's runtime reads on stdout."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ..core.errors import BadInput
from ..core.job import Progress


@contextmanager
def percent_lines() -> Iterator[Callable[[Progress], None]]:
    """Yields what tells a job's progress; a BadInput within is told as the reason of the failure, and raised."""
    percent = -1

    def show(progress: Progress) -> None:
        nonlocal percent
        if (now := int(100 * progress.fraction)) > percent:
            percent = now
            print(f"openjd_progress: {percent}", flush=True)

    try:
        yield show
    except BadInput as error:
        print(f"openjd_fail: {error}", flush=True)
        raise
    show(Progress(1.0, "done"))


def status(text: str) -> None:
    """What the task has done, in a line."""
    print(f"openjd_status: {text}", flush=True)
