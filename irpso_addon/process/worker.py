"""The process in which a window's jobs run: OpenGL, shader compilers and drivers that crash never touch Blender.

It reads orders from standard input (`process/remote.py` writes them), works, and answers on standard output
(`process/messages.py`).  A task is a generator function: a job of the GL thread (core/job.py).  One with a parameter
``mailbox`` is given a Mailbox beside its arguments, and finds there what it is fed.  The end of standard input ends the
process, whatever it is doing.
"""

from __future__ import annotations

import inspect
import os
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from ..core import log
from ..core.child_process import take_stdin, take_stdout
from ..core.errors import BadInput, Cancelled
from ..core.job import Mailbox, Progress, Steps, mapped
from ..core.live_maps import difference
from ..gpu.device import thread
from .channel import Closed, Receiver, Sender, named
from .messages import Answer, Cancel, Configure, Done, Failed, Feed, Logged, Looked, Order, Pause, Reached, Run

NICENESS = 5  # the window goes first
TELL_SECONDS = 0.05  # between two words of progress
LOOK_SECONDS = 0.1  # between two looks

Tell = Callable[[Answer], None]


class _Job:
    """The job that is running, or was last."""

    def __init__(self, order: Run, tell: Tell) -> None:
        self.number, self.mailbox = order.number, Mailbox()
        module, _, name = order.task.partition(":")
        function = getattr(named(module), name)
        feeds = {"mailbox": self.mailbox} if "mailbox" in inspect.signature(function).parameters else {}
        self.thread = thread.Job(lambda: _watched(function(*order.arguments, **feeds), order.number, tell))


def main() -> None:
    """Serve until standard input ends."""
    answers = Sender(take_stdout(buffering=1 << 20))
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    orders = Receiver(take_stdin(buffering=0))
    log.to(partial(_pass_on, answers))
    job: _Job | None = None
    with suppress(Closed):
        while True:
            order: Order = orders.receive()
            match order:
                case Configure(settings):
                    thread.configure(settings)
                case Run():
                    job = _Job(order, answers.send)
                case Feed(number, content) if job is not None and job.number == number:
                    job.mailbox.put(content)
                case Cancel() if job is not None:
                    job.thread.cancel()
                case Pause(on) if job is not None:
                    job.thread.pause(on)
    os._exit(0)  # a driver may be in the middle of something


def _pass_on(answers: Sender, level: str, event: str, fields: dict[str, Any]) -> None:
    with suppress(Closed):
        answers.send(Logged(level, event, fields))


def _watched(job: Steps[Any], number: int, tell: Tell) -> Steps[Any]:
    """The job, its progress and looks reported as it goes, and in the end what came of it."""
    try:
        value = yield from mapped(job, _Watch(number, tell))
        tell(Done(number, value))
    except Closed:
        os._exit(0)
    except BaseException as error:
        tell(Failed(number, _portable(error)))
        raise
    return value


class _Watch:
    """Tells of a job's steps, not too often."""

    def __init__(self, number: int, tell: Tell) -> None:
        self._number, self._tell = number, tell
        self._started = self._reported = self._looked = time.perf_counter()

    def __call__(self, step: Progress) -> Progress:
        now = time.perf_counter()
        if step.look is not None and (step.due or now - self._looked >= LOOK_SECONDS):
            live = step.look()
            live = replace(live, seconds=time.perf_counter() - self._started, error=difference(live.pictures))
            self._tell(Looked(self._number, live))
            self._looked = time.perf_counter()
        if now - self._reported >= TELL_SECONDS:
            self._tell(Reached(self._number, replace(step, look=None)))
            self._reported = now
        return step


def _portable(error: BaseException) -> BaseException:
    """What can be sent to a process that may not know the error's class."""
    if isinstance(error, BadInput):
        return type(error)(str(error))
    if isinstance(error, Cancelled):
        return error
    traceback.print_exception(error, file=sys.stderr)
    return RuntimeError("".join(traceback.format_exception_only(error)).strip())
