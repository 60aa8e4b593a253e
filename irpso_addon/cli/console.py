"""What the user sees: results on stdout, progress and warnings on stderr.

With rich and a terminal, progress is a bar; else (a log, or Blender, which ships no rich) one line per stage.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from ..core.errors import printable
from ..core.job import Progress, doing
from ..core.phrases import percent

PATIENCE = 60.0  # seconds between two lines of a stage


def say(text: str) -> None:
    """A line of the result."""
    print("\n".join(map(printable, text.split("\n"))), flush=True)


def warn(text: str) -> None:
    """A line that the user should read, beside the result."""
    print(f"irpso: {printable(text)}", file=sys.stderr, flush=True)


def expect(text: str) -> None:
    """What a job will need, as the first line of its progress."""
    print(f"irpso: {percent(0.0):>5} {text}", file=sys.stderr, flush=True)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Aligned columns, the first to the left, the others to the right."""
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    for row in (header, ["-" * width for width in widths], *rows):
        first, *others = (cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        say("  ".join([first.lstrip().ljust(widths[0]), *others]).rstrip())


@contextmanager
def quiet() -> Iterator[None]:
    """Keeps what Blender and Cycles print themselves off stdout: they write to the descriptor, past Python."""
    sys.stdout.flush()
    stdout = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(stdout, 1)
        os.close(stdout)
        os.close(nowhere)


@contextmanager
def progress() -> Iterator[Callable[[Progress], None]]:
    """Yields what shows a job's progress."""
    bar = _rich_bar() if sys.stderr.isatty() else None
    if bar is None:
        yield _stage_lines()
        return
    with bar:
        task = bar.add_task("start", total=1.0)
        yield lambda p: bar.update(task, completed=p.fraction, description=_said(p))


def _rich_bar() -> Any:
    try:
        from rich import progress as rich_progress
        from rich.console import Console
    except ImportError:
        return None
    return rich_progress.Progress(
        rich_progress.BarColumn(), rich_progress.TaskProgressColumn(), rich_progress.TimeElapsedColumn(),
        rich_progress.TextColumn("{task.description}"), console=Console(stderr=True), transient=True)


def _said(p: Progress) -> str:
    """What is done, once: the message alone where that says it."""
    stage = doing(p.stage)
    return ": ".join(filter(None, ["" if p.message.startswith(stage.split()[0]) else stage, p.message]))


def _stage_lines() -> Callable[[Progress], None]:
    """A line whenever the stage changes, and one now and then."""
    last, shown = "", 0.0

    def show(p: Progress) -> None:
        nonlocal last, shown
        now = time.monotonic()
        if p.stage != last or now - shown > PATIENCE:
            last, shown = p.stage, now
            print(f"irpso: {percent(p.fraction):>5} {_said(p)}", file=sys.stderr, flush=True)

    return show
