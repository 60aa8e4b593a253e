"""The process in which a window's jobs run: OpenGL, shader compilers and drivers that crash never touch Blender.

It reads messages from standard input (`process/remote.py` writes them), works, and answers on standard output:

    ("run", number, task, arguments)   task is "module:function" below this package
    ("configure", DeviceSettings)      before it
    ("feed", thing)                    for a job that asks `fed` for it
    ("cancel",)  ("pause", on)         the running job

    (number, "progress", Progress)  (number, "look", Live)  (number, "done", value)  (number, "error", exception)
    (None, "log", (level, event, fields))   at any time

A task is a generator function: a job of the GL thread (core/job.py).  The end of standard input ends the process,
whatever it is doing.
"""

from __future__ import annotations

import os
import queue
import sys
import time
import traceback
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from ..core import log
from ..core.child_process import take_stdin, take_stdout
from ..core.errors import BadInput, Cancelled
from ..core.job import Progress
from ..core.live_maps import difference
from ..gpu.device import thread
from .channel import Closed, Receiver, Sender, named

NICENESS = 5  # the window goes first
TELL_SECONDS = 0.05  # between two words of progress
LOOK_SECONDS = 0.1  # between two looks

Tell = Callable[[str, object], None]
_fed: queue.SimpleQueue[Any] = queue.SimpleQueue()


def fed(seconds: float) -> Any:
    """The latest thing that the other side has fed, waited for at most so long; None: nothing."""
    thing = None
    with suppress(queue.Empty):
        thing = _fed.get(timeout=seconds)
        while True:
            thing = _fed.get_nowait()
    return thing


def main() -> None:
    """Serve until standard input ends."""
    answers = Sender(take_stdout(buffering=1 << 20))
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    orders = Receiver(take_stdin(buffering=0))
    log.to(partial(_pass_on, answers))
    job: thread.Job | None = None
    with suppress(Closed):
        while True:
            order, *rest = orders.receive()
            if order == "run":
                number, task, arguments = rest
                fed(0.0)  # what was meant for the job before
                job = _start(task, arguments, partial(_tell, answers, number))
            elif order == "configure":
                thread.configure(rest[0])
            elif order == "feed":
                _fed.put(rest[0])
            elif job is not None and order == "cancel":
                job.cancel()
            elif job is not None and order == "pause":
                job.pause(rest[0])
    os._exit(0)  # a driver may be in the middle of something


def _pass_on(answers: Sender, *record: object) -> None:
    with suppress(Closed):
        answers.send((None, "log", record))


def _tell(answers: Sender, number: int, kind: str, thing: object) -> None:
    answers.send((number, kind, thing))


def _start(task: str, arguments: tuple[Any, ...], tell: Tell) -> thread.Job:
    """The job, on the GL thread."""
    module, _, name = task.partition(":")
    function = getattr(named(module), name)
    return thread.Job(lambda: _watched(function(*arguments), tell))


def _watched(job: Generator[Progress, None, Any], tell: Tell) -> Generator[Progress, None, Any]:
    """The job, its progress and looks told as it goes."""
    started = told = looked = time.perf_counter()
    try:
        stop_now: Cancelled | None = None
        while True:
            step = job.throw(stop_now) if stop_now else next(job)
            stop_now, now = None, time.perf_counter()
            if step.look is not None and (step.due or now - looked >= LOOK_SECONDS):
                live = step.look()
                live = replace(live, seconds=time.perf_counter() - started, error=difference(live.pictures))
                tell("look", live)
                looked = time.perf_counter()
            if now - told >= TELL_SECONDS:
                tell("progress", replace(step, look=None))
                told = now
            try:
                yield step
            except Cancelled as stop:
                stop_now = stop
    except StopIteration as stop:
        value = stop.value
    except Closed:
        os._exit(0)
    except BaseException as error:
        tell("error", _portable(error))
        raise
    try:
        tell("done", value)
    except Closed:
        os._exit(0)
    except BaseException as error:
        tell("error", _portable(error))
        raise
    return value


def _portable(error: BaseException) -> BaseException:
    """What can be told to a process that may not know the error's class."""
    if isinstance(error, BadInput):
        return type(error)(str(error))
    if isinstance(error, Cancelled):
        return Cancelled(error.partial)
    traceback.print_exception(error, file=sys.stderr)
    return RuntimeError("".join(traceback.format_exception_only(error)).strip())
