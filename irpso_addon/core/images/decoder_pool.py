"""Image files decoded in processes of their own: a file that crashes or stalls a decoder harms nobody else.

`header` and `bands` are those of oiio_reader.py and, for RAW files, raw_reader.py, through a pipe.  What comes back is
not trusted: JSON, and arrays of the sizes that were asked for.  A process is kept for the next file, replaced when it
has died, and ended when unused.
"""

from __future__ import annotations

import atexit
import json
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

from .. import child_process
from ..child_process import NO_CONSOLE
from ..errors import BadInput, Cancelled
from . import oiio_reader
from .colour import CameraColour
from .oiio_reader import FORMS, MAX_SIDE, Stored, StoredPicture
from .shot_settings import ShotSettings, positive

PATIENCE = 10.0  # seconds without a word from a process that decodes
START = 60.0  # and from one that starts: libraries may have to come from a slow disk
UNUSED = 30.0  # seconds after which a process is ended
MOST = min(4, max(2, (os.cpu_count() or 2) // 2))  # processes at a time, while nobody waits longer for one than ...
TURN = 1.0  # seconds
LAST = 0.5  # that one which says no more may take to end: its own status is told
WATCH = 0.25  # seconds between two looks at them
MEMORY = 1 << 30  # bytes that a process may hold, where the system can limit it
LINE = 1 << 20  # bytes of a message, at most
FEW = 1 << 20  # pixels: rather thrown away than a process ended
PIPE = 1 << 20  # bytes of the pipe, where that can be chosen


def program() -> str:
    """What a decoder process runs."""
    return child_process.code("core.images.decoder_worker", MEMORY)


def header(path: Path, full: bool = False) -> dict[str, Any]:
    """As oiio_reader.header, of RAW files as raw_reader.header.  Raises BadInput."""
    with _borrowed(path) as process:
        process.order("header", str(path), full)
        message = process.answer()
        return _header(message["header"])


def bands(path: Path, picture: StoredPicture, first: int, last: int) -> Iterator[Stored]:
    """As oiio_reader.bands.  Raises BadInput, and Cancelled as `until` says."""
    left, width = last - first, picture.size[0]
    with _borrowed(path) as process:
        process.order("bands", str(path), astuple(picture), first, last, oiio_reader.BAND)
        try:
            while left:
                if (stop := getattr(_thread, "stop", None)) is not None and stop.is_set():
                    raise Cancelled
                band = process.band(left, width, len(picture.channels), picture.form)
                left -= len(band)
                yield band
        except GeneratorExit:  # nobody wants the rest
            if left * width < FEW:
                with suppress(Exception):
                    while left:
                        left -= len(process.band(left, width, len(picture.channels), picture.form))
                    process.answer()
            raise
        process.answer()  # the end, or what has gone wrong since


@contextmanager
def until(stop: threading.Event) -> Iterator[None]:
    """What this thread reads inside ends soon after ``stop`` is set: `bands` raise Cancelled."""
    _thread.stop = stop
    try:
        yield
    finally:
        _thread.stop = None


def warm_up() -> None:
    """Start processes, for who must not wait for them later, and keep them.  Raises BadInput."""
    pool = _pool
    for process in [pool.take() for _ in range(MOST)]:
        process.keep = True
        pool.give_back(process)


def _header(message: dict[str, Any]) -> dict[str, Any]:
    """What a process says of a file, as far as anything relies on it."""
    shot, camera = dict(message["shot"]), message["camera"]
    channels, window = (tuple(int(n) for n in message[key]) for key in ("channels", "window"))
    known: dict[str, Any] = {
        "part": int(message["part"]), "channels": channels, "window": window,
        "width": int(message["width"]), "height": int(message["height"]), "form": str(message["form"]),
        "bits": int(message["bits"]), "integer": bool(message["integer"]),
        "premultiplied": bool(message["premultiplied"]),
        "colorspace": None if message["colorspace"] is None else str(message["colorspace"]),
        "own": bool(message.get("own", False)),
        "warnings": tuple(str(text) for text in message["warnings"]), "orientation": int(message["orientation"]),
        "shot": ShotSettings(
            time=positive(shot.get("time")), f_number=positive(shot.get("f_number")), iso=positive(shot.get("iso"))),
        "camera": None if camera is None else CameraColour.of(camera["white_balance"], camera["matrix"]),
    }
    sizes = (known["width"], known["height"], *window[2:])
    if len(channels) not in (3, 4) or len(window) != 4 or min(sizes) < 1 or max(sizes) > MAX_SIDE or (
            known["form"] not in FORMS) or not 1 <= known["orientation"] <= 8:
        raise ValueError(f"a header of {sizes}")
    return known


class _Process:
    """One that decodes."""

    def __init__(self) -> None:
        """Starts it; raises BadInput where that is not possible."""
        try:
            self._popen = subprocess.Popen(
                child_process.python(program()), stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, pipesize=PIPE, creationflags=NO_CONSOLE)
        except OSError as error:
            raise BadInput(f"{sys.executable}: Blender's Python cannot be started to read images ({error.strerror}); "
                           "allow Blender to start it") from None
        assert self._popen.stdin is not None and self._popen.stdout is not None
        self._orders, self._answers = self._popen.stdin, self._popen.stdout
        self.number = self._popen.pid
        self.since = time.monotonic()  # when it was last given back
        self.deadline = math.inf  # of a word that somebody waits for
        self.ready = self.stalled = self.keep = False
        self.owner = 0  # thread
        self.clean = True  # whether it waits for orders

    @property
    def alive(self) -> bool:
        return self._popen.poll() is None

    def order(self, *words: object) -> None:
        self.clean = False
        with suppress(OSError):  # then there will be no answer
            self._orders.write(json.dumps(words).encode() + b"\n")
            self._orders.flush()

    def answer(self) -> dict[str, Any]:
        """The next message.  Raises BadInput of what the decoder found wrong, EOFError when it died."""
        if not self.ready:
            self.ready = self._message(START) == {"ready": True}
        return self._message(PATIENCE)

    def _message(self, patience: float) -> dict[str, Any]:
        with self._watched(patience):
            line = self._answers.readline(LINE)
        if not line.endswith(b"\n"):
            raise EOFError
        message: dict[str, Any] = json.loads(line)
        self.clean = "rows" not in message and "failed" not in message
        if "wrong" in message:
            raise BadInput(str(message["wrong"]))
        if "failed" in message:
            raise BadInput(f"images: cannot be read ({message['failed']}); use Blender 4.5 or later, which has it, or "
                           "pip install OpenImageIO")
        return message

    def band(self, most: int, width: int, channels: int, form: str) -> Stored:
        """The next rows, ``most`` at most."""
        rows = int(self.answer()["rows"])
        if not 0 < rows <= most:
            raise ValueError(f"a band of {rows} rows, {most} wanted")
        values = np.empty((rows, width, channels), FORMS[form])
        with self._watched(PATIENCE):
            if self._answers.readinto(memoryview(values).cast("B")) != values.nbytes:  # type: ignore[attr-defined]
                raise EOFError
        return values

    @contextmanager
    def _watched(self, patience: float) -> Iterator[None]:
        self.deadline = time.monotonic() + patience
        try:
            yield
        finally:
            self.deadline = math.inf

    def kill(self) -> None:
        self._popen.kill()

    def close(self, patience: float = 0.0) -> int:
        """End it, after so many seconds if it has not by itself; its exit status."""
        with suppress(subprocess.TimeoutExpired):
            self._popen.wait(patience)
        self.kill()
        for stream in (self._orders, self._answers):
            with suppress(OSError):
                stream.close()
        try:
            return self._popen.wait(1.0)
        except subprocess.TimeoutExpired:  # held up by a disk, which no signal reaches
            return 0


class _Pool:
    """The processes of this one."""

    def __init__(self) -> None:
        self.lock = threading.Condition()
        self.idle: list[_Process] = []
        self.busy: list[_Process] = []
        self.watcher: threading.Thread | None = None

    def take(self) -> _Process:
        with self.lock:
            # Rather one that is warm and soon free; but who holds one (of an image, and now wants its mask) must not
            # wait for another who does, and somebody may hold one and not go on.
            self.lock.wait_for(lambda: self.idle or len(self.busy) < MOST or self._mine(), timeout=TURN)
            while self.idle:
                process = self.idle.pop()
                if process.alive:
                    break
                process.close()
            else:
                process = _Process()
            process.owner = threading.get_ident()
            self.busy.append(process)
            if self.watcher is None:
                self.watcher = threading.Thread(target=self._watch, name="irpso-decoders", daemon=True)
                self.watcher.start()
        return process

    def _mine(self) -> bool:
        return any(process.owner == threading.get_ident() for process in self.busy)

    def give_back(self, process: _Process) -> None:
        with self.lock:
            if process in self.busy:
                self.busy.remove(process)
            self.lock.notify_all()
            if process.clean and process.alive:
                process.since = time.monotonic()
                self.idle.append(process)
                return
        process.close()

    def close(self) -> None:
        with self.lock:
            for process in (*self.idle, *self.busy):
                process.close()
            self.idle.clear()

    def _watch(self) -> None:
        while True:
            time.sleep(WATCH)
            with self.lock:
                now = time.monotonic()
                for process in self.busy:
                    if now > process.deadline:
                        process.stalled = True
                        process.kill()
                for process in [p for p in self.idle if not p.keep and now - p.since > UNUSED]:
                    self.idle.remove(process)
                    process.close()
                if not self.busy and all(process.keep for process in self.idle):
                    self.watcher = None
                    return


_thread = threading.local()  # ``stop``, as of `until`
_pool = _Pool()
atexit.register(lambda: _pool.close())


def _forget() -> None:
    """A forked process must not talk to those of the process that it was forked from."""
    global _pool
    _pool = _Pool()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


@contextmanager
def _borrowed(path: Path) -> Generator[_Process, None, None]:
    """A process for one file.  What it does wrong becomes a BadInput that names the file."""
    pool = _pool
    process = pool.take()
    try:
        yield process
    except (EOFError, OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        ended = process.close(LAST if isinstance(error, EOFError) else 0.0)
        if process.stalled:
            raise BadInput(f"{path}: cannot be read (decoding it stalled for {PATIENCE:.0f} s); "
                           "save it again, or copy it to a faster disk") from None
        why = f"ended with status {ended}" if isinstance(error, EOFError) else f"sent invalid data, {error!r}"
        raise BadInput(f"{path}: cannot be read (its decoder {why}); save it again: it is damaged, or needs more "
                       "memory "
                       "than an image may") from None
    finally:
        pool.give_back(process)
