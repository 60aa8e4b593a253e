"""Jobs in a process of their own, as Blender's window wants them: it never waits, and nothing takes it down.

    job = Remote("solve.pipeline:solve", scene, settings)
    job.poll(), job.looks(), job.done, job.result()

Everything here may be called on Blender's main thread: a thread of our own reads what the worker tells.
"""

from __future__ import annotations

import atexit
import itertools
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from typing import Any

from ..core import child_process, log
from ..core.child_process import NO_CONSOLE
from ..core.errors import BadInput, Cancelled, DeviceLost
from ..core.job import Progress
from ..core.live_maps import Live
from ..core.params import DeviceSettings
from .channel import Closed, Receiver, Sender
from .messages import Answer, Cancel, Configure, Done, Failed, Feed, Logged, Looked, Order, Pause, Reached, Run

# Windows: no console, and the window goes first (elsewhere the worker is nice by itself)
FLAGS = NO_CONSOLE | getattr(subprocess, "BELOW_NORMAL_PRIORITY_CLASS", 0)
DEFAULT = DeviceSettings()
_numbers = itertools.count()


class Worker:
    """One worker process; runs one job at a time, as many as it lives."""

    def __init__(self, settings: DeviceSettings) -> None:
        """Starts it; raises BadInput where that is not possible."""
        self.log = tempfile.TemporaryFile()
        # Its own place for temporary files, because it may be ended at any moment.
        self._folder = tempfile.TemporaryDirectory(prefix="irpso-", ignore_cleanup_errors=True)
        environment = {**os.environ, **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), self._folder.name)}
        try:
            self._process = subprocess.Popen(
                child_process.python(child_process.code("process.worker")), stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=self.log, creationflags=FLAGS, env=environment)
        except OSError as error:
            raise BadInput(f"{sys.executable}: Blender's Python cannot be started ({error.strerror}); "
                           "allow Blender to start it, or solve from the command line") from None
        assert self._process.stdin is not None and self._process.stdout is not None
        self._orders, self._answers = Sender(self._process.stdin), Receiver(self._process.stdout)
        self._outbox: list[Order | None] = []
        self._wake = threading.Condition()
        self.job: Remote | None = None
        for loop in (self._read, self._write):  # a pipe that is full must not hold up the window either
            threading.Thread(target=loop, name="irpso-worker", daemon=True).start()
        atexit.register(self.close)
        self.order(Configure(settings))

    @property
    def alive(self) -> bool:
        """Whether the process runs and can be given a job."""
        return self._process.poll() is None

    def order(self, order: Order) -> None:
        """Send it when the pipe has room for it."""
        with self._wake:
            self._outbox.append(order)
            self._wake.notify()

    def close(self) -> None:
        """End the process, whatever it does."""
        atexit.unregister(self.close)
        self._process.kill()
        with self._wake:
            self._outbox.append(None)
            self._wake.notify()

    def _write(self) -> None:
        while True:
            with self._wake:
                while not self._outbox:
                    self._wake.wait()
                order = self._outbox.pop(0)
            if order is None:
                break
            try:
                self._orders.send(order)
            except Closed:
                break
            except Exception as error:
                self._fail(RuntimeError(f"{type(error).__name__}: {error}"))

    def _read(self) -> None:
        try:
            while True:
                self._take(self._answers.receive())
        except BaseException as error:
            if not isinstance(error, Closed):  # what was sent cannot be taken: memory, most likely
                self._fail(RuntimeError(f"{type(error).__name__}: {error}"))
                self.close()
            code = self._process.wait()
            if self.job is not None:
                log.warning("worker ended", status=code, message=self._last_words())
                self._fail(DeviceLost(
                    f"the worker process ended (status {code}): {self._last_words()}; solve again; lower Memory or "
                    "Size if it happens again"))
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            try:
                stream.close()
            except OSError:  # what was still to be written
                pass
        self.log.close()
        self._folder.cleanup()

    def _take(self, answer: Answer | Logged) -> None:
        """Here, because what a loop has in its hands would live until the next answer: a job with all its maps."""
        if isinstance(answer, Logged):
            log.again(answer.level, answer.event, answer.fields)
        elif (job := self.job) is not None and job.number == answer.number:  # else it was cancelled
            job._hear(answer)

    def _fail(self, error: Exception) -> None:
        """The running job, if there is one, ends so."""
        job = self.job
        if job is not None:
            job._hear(Failed(job.number, error))

    def _last_words(self) -> str:
        self.log.seek(0)
        lines = [line.strip() for line in self.log.read().decode(errors="replace").splitlines() if line.strip()]
        return lines[-1][:200] if lines else "it left no message"


class Remote:
    """A job in a worker.  Has what `gpu.device.thread.Job` has, and looks."""

    def __init__(
        self, task: str, *arguments: object, settings: DeviceSettings = DEFAULT, worker: Worker | None = None,
        prepare: Callable[[Live], Live] | None = None,
    ) -> None:
        """``task``: "module:function" below this package.  ``worker`` None: one of its own, ended with the job.

        ``settings``: of the device, for a worker of its own.

        ``prepare`` is called with each look on the thread that reads: for work that the window must not wait for.
        """
        self._own = worker is None
        self.worker = worker or Worker(settings)
        self._prepare = prepare
        self._latest: Progress | None = None
        self._looks: list[Live] = []
        self._lock = threading.Lock()
        self._finished = threading.Event()
        self._value: Any = None
        self._error: BaseException | None = None
        self.number = next(_numbers)
        self.worker.job = self
        self.worker.order(Run(self.number, task, arguments))

    def poll(self) -> Progress | None:
        """The latest progress, None before the first."""
        return self._latest

    def looks(self) -> list[Live]:
        """What has been looked at since the last call, oldest first; nothing where ``prepare`` takes the looks."""
        with self._lock:
            looks, self._looks = self._looks, []
        return looks

    @property
    def done(self) -> bool:
        """True once the result (or an error) is there."""
        return self._finished.is_set()

    def wait(self, seconds: float) -> bool:
        """Wait for the end, at most so long; True when done."""
        return self._finished.wait(seconds)

    def result(self) -> Any:
        """The job's value.  Raises what it raised; Cancelled when it was."""
        self._finished.wait()
        if self._error is not None:
            raise self._error
        return self._value

    def feed(self, content: object) -> None:
        """Hand something to the running job, into its mailbox."""
        if not self.done:
            self.worker.order(Feed(self.number, content))

    def pause(self, on: bool) -> None:
        """Stop after the present step until it may go on."""
        self.worker.order(Pause(on))

    def cancel(self) -> None:
        """End it now: what it has not sent is lost.  A worker of its own ends too."""
        if not self.done:
            self._hear(Failed(self.number, Cancelled()))
            if not self._own:
                self.worker.order(Cancel())

    def _hear(self, answer: Answer) -> None:
        if self._finished.is_set():
            return
        match answer:
            case Reached():
                self._latest = answer.progress
            case Looked():
                if self._prepare is not None:  # whoever prepares them has them: hundreds of maps in a solve
                    self._prepare(answer.live)
                    return
                with self._lock:
                    self._looks.append(answer.live)
            case Done():
                self._end(answer.value, None)
            case Failed():
                self._end(None, answer.error)

    def _end(self, value: Any, error: BaseException | None) -> None:
        self._value, self._error = value, error
        self._finished.set()
        if self.worker.job is self:
            self.worker.job = None
        if self._own:
            self.worker.close()
