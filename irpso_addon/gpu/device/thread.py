"""The one thread that owns OpenGL, and jobs that run on it.

A job is a function returning a generator of Progress (core/job.py); its return value is the result.
The thread starts with the first job and lives until the process ends; it is a daemon (a plain thread
would hang Blender at exit) and is stopped and joined at exit, so that the context is released cleanly.
"""

from __future__ import annotations

import atexit
import queue
import threading
import time
import traceback
from collections.abc import Callable, Generator
from typing import Any

from threadpoolctl import threadpool_limits

from ...core.errors import Cancelled, OutOfDeviceMemory
from ...core.job import Progress
from ...core.params import DeviceSettings
from .context import Device

JobFunction = Callable[[], Generator[Progress, None, Any]]
POLL_SECONDS = 0.05

_device: Device | None = None
_settings = DeviceSettings()
_queue: queue.Queue[Job | None] = queue.Queue()
_thread: threading.Thread | None = None
_start_lock = threading.Lock()


class Job:
    """A job on the GL thread; starts at once, or when the job before it is done."""

    def __init__(self, function: JobFunction) -> None:
        self._function = function
        self._latest: Progress | None = None
        self._finished = threading.Event()
        self._stop = threading.Event()
        self._go = threading.Event()
        self._go.set()
        self._value: Any = None
        self._error: BaseException | None = None
        _ensure_thread()
        _queue.put(self)

    def poll(self) -> Progress | None:
        """The latest progress, None before the first."""
        return self._latest

    @property
    def done(self) -> bool:
        """True once the result (or an error) is there."""
        return self._finished.is_set()

    def wait(self, seconds: float) -> bool:
        """Wait for the end, at most so long; True when done."""
        return self._finished.wait(seconds)

    def cancel(self) -> None:
        """Ask the job to stop at its next step.  It may still return what it has."""
        self._stop.set()
        self._go.set()

    def pause(self, on: bool) -> None:
        """Stop after the present step until it may go on, or cancelled."""
        if on and not self._stop.is_set():
            self._go.clear()
        else:
            self._go.set()

    def result(self) -> Any:
        """The job's value.  Raises what it raised; Cancelled (with ``partial``) if it was stopped."""
        self._finished.wait()
        if self._error is not None:
            raise self._error
        if self._stop.is_set() and getattr(self._value, "cancelled", False):
            raise Cancelled(self._value)
        return self._value

    def _run(self) -> None:
        try:
            if _device is not None and not _device.lost:
                _device.collect()
            # NumPy's linear algebra has a thread for each core.  Matrices here are small: the threads would find
            # nothing to do, and would use the cores up while they wait for more.
            with threadpool_limits(1, "blas"):
                self._work(self._function())
        except BaseException as error:  # whatever it is, it belongs to whoever asks for the result
            traceback.clear_frames(error.__traceback__)  # they hold the job's textures
            if isinstance(error, MemoryError):
                error = OutOfDeviceMemory(f"memory: {error or 'there is not enough'}; lower Memory or Size")
            self._error = error
        finally:
            self._finished.set()

    def _work(self, steps: Generator[Progress, None, Any]) -> None:
        stop_raised = False
        try:
            while True:
                if self._stop.is_set() and not stop_raised:
                    stop_raised = True
                    self._latest = steps.throw(Cancelled())
                else:
                    self._latest = next(steps)
                self._go.wait()
                time.sleep(0)  # lets the window's thread have the interpreter between slices
        except StopIteration as stop:
            self._value = stop.value


def run(
    function: JobFunction, on_progress: Callable[[Progress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Any:
    """Run a job to its end from any other thread; ``on_progress`` is called in the caller's thread.

    Ctrl-C or ``should_stop() -> True`` stops it: raises Cancelled with the partial result, if any.
    """
    job = Job(function)
    shown: Progress | None = None
    while not job.done:
        try:
            job.wait(POLL_SECONDS)
            if on_progress and job.poll() is not shown:
                shown = job.poll()
                if shown is not None:
                    on_progress(shown)
            if should_stop and should_stop():
                job.cancel()
        except KeyboardInterrupt:
            job.cancel()
        except BaseException:  # the caller's own trouble: nobody is left to take the result
            job.cancel()
            raise
    return job.result()


def configure(settings: DeviceSettings) -> None:
    """How the device is used by jobs that ask for it from now on; from any thread."""
    global _settings
    _settings = settings


def settings() -> DeviceSettings:
    """What `configure` was last given."""
    return _settings


def device() -> Device:
    """The Device, made on first use, as `configure` said.  Only callable on the GL thread.

    Raises BadInput where there is none, or it cannot do what is asked of it.
    """
    global _device
    if threading.current_thread() is not _thread:
        raise RuntimeError("OpenGL is used outside its thread: go through gpu.thread.run or Job")
    if _device is None or _device.lost:  # a lost one is left as it is: its driver may be in any state
        _device = Device()
    if _device.settings != _settings:
        _device.configure(_settings)
    return _device


def _loop() -> None:
    global _device
    while (job := _queue.get()) is not None:
        job._run()
        del job  # its result belongs to whoever asked for it
    if _device is not None and not _device.lost:
        _device.release()
    _device = None


def _ensure_thread() -> None:
    global _thread
    with _start_lock:
        if _thread is None or not _thread.is_alive():
            _thread = threading.Thread(target=_loop, name="irpso-gl", daemon=True)
            _thread.start()
            atexit.register(_stop_thread)


def _stop_thread() -> None:
    _queue.put(None)
    if _thread is not None:
        _thread.join(timeout=5.0)
