"""What a list of pictures shows of a file: its size and kind, a thumbnail, what is wrong with it.

A `Watcher` looks in a thread of its own: disks may be slow, and pictures large.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

import numpy as np

from ..data import F32
from ..errors import BadInput
from ..images.colour import known_space
from ..images.image_file import ImageFile, floats, open_image
from ..images.shot_settings import NOTHING_SAID, ShotSettings
from .captures import CaptureView, read_captures

SIDE = 64  # pixels of a thumbnail's longer side
SAMPLES = 4  # pixels read for each of a thumbnail's, along either side
HALF_MOST = 65504.0  # what a thumbnail shows of anything brighter
MISSING = "File missing"
AGAIN = 1.0  # seconds until a file is looked at again

Stamp = tuple[int, int]  # time of change, bytes


@dataclass(frozen=True)
class FilePreview:
    """A file as it was when it was last looked at."""

    stamp: Stamp | None = None  # None: there is no such file
    problem: str = ""  # why it cannot be used


@dataclass(frozen=True)
class CapturesPreview(FilePreview):
    """A capture file."""

    views: tuple[CaptureView, ...] = ()


@dataclass(frozen=True)
class ImagePreview(FilePreview):
    """An image."""

    width: int = 0  # pixels
    height: int = 0
    bits: int = 0  # per channel
    integer: bool = False
    colorspace: str | None = None  # as the file itself says, in our spelling
    shot: ShotSettings = NOTHING_SAID
    thumbnail: F32 | None = None  # (h, w, 4) stored values (of RAW: linear Rec.709), premultiplied; row 0 bottom


def preview_image(path: Path) -> ImagePreview:
    """One look at an image; whatever is wrong is in the answer."""
    if os.path.isdir(path):  # (unlike pathlib, it takes any name)
        return ImagePreview(problem="Is a folder, not an image")
    try:
        file = open_image(path)
        thumbnail = _thumbnail(file)
    except BadInput as error:
        return ImagePreview(problem=_short(str(error), path))
    except (OSError, MemoryError) as error:
        return ImagePreview(problem=f"Cannot be read ({type(error).__name__})")
    space = known_space(file.colorspace) if file.colorspace else None
    return ImagePreview(None, "", file.width, file.height, file.bits, file.integer, space, file.shot, thumbnail)


def preview_captures(path: Path) -> CapturesPreview:
    """One look at a capture file."""
    try:
        return CapturesPreview(views=tuple(read_captures(path)))
    except BadInput as error:
        return CapturesPreview(problem=_short(str(error), path))


def _stamp(path: Path) -> Stamp | None:
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_mtime_ns, found.st_size


def _short(message: str, path: Path) -> str:
    """What is wrong, without the path that stands before it, and the details and advice after."""
    text = message.removeprefix(f"{path}: ").split(";")[0].split(" (")[0]
    return text[:1].upper() + text[1:]


def _thumbnail(file: ImageFile) -> F32:
    """(h, w, 4): means over SAMPLES x SAMPLES pixels spread over each of its own.  Raises BadInput."""
    scale = max(file.width, file.height) / SIDE
    width, height = max(1, round(file.width / scale)), max(1, round(file.height / scale))
    rows, columns = (np.minimum(((np.arange(n * SAMPLES) + 0.5) * size / (n * SAMPLES)).astype(int), size - 1)
                     for n, size in ((height, file.height), (width, file.width)))
    samples = np.empty((len(rows), len(columns), len(file.channels)), np.float32)
    top = 0
    for band in file.bands():
        inside = (rows >= top) & (rows < top + len(band))
        samples[inside] = floats(band[rows[inside] - top][:, columns])
        top += len(band)
    if file.camera is not None:
        samples = file.camera.to_linear_rec709(samples)
    if samples.shape[2] == 3:
        samples = np.concatenate([samples, np.ones_like(samples[..., :1])], 2)
    elif not file.premultiplied:
        samples[..., :3] *= samples[..., 3:]
    samples = np.nan_to_num(samples).clip(-HALF_MOST, HALF_MOST)
    small = samples.reshape(height, SAMPLES, width, SAMPLES, 4).mean((1, 3), dtype=np.float32)
    return np.ascontiguousarray(small[::-1])


Kind = TypeVar("Kind", bound=FilePreview)


class Watcher(Generic[Kind]):
    """Looks at files in a thread; whoever asks gets at once what is known."""

    def __init__(self, look: Callable[[Path], Kind], missing: Kind) -> None:
        """``look`` reads a file, in the thread; ``missing``: what is said of one that is not there."""
        self.look, self.missing = look, missing
        self.changes = 0  # grows whenever a file turns out to be other than it was known
        self._known: dict[str, Kind] = {}
        self._asked: dict[str, float] = {}  # when a look was last asked for
        self._wanted: SimpleQueue[str | None] = SimpleQueue()
        self._waiting: set[str] = set()
        self._thread: threading.Thread | None = None

    def of(self, path: str) -> Kind | None:
        """What is known of a file; None: nothing yet.  Never touches the disk."""
        now = time.monotonic()
        if path not in self._waiting and now - self._asked.get(path, -AGAIN) >= AGAIN:
            self._asked[path] = now
            self._waiting.add(path)
            self._wanted.put(path)
            if self._thread is None:
                self._thread = threading.Thread(
                    target=self._work, args=(self._wanted,), name="irpso-file-preview", daemon=True)
                self._thread.start()
        return self._known.get(path)

    @property
    def busy(self) -> bool:
        """Whether some file is still to be looked at."""
        return bool(self._waiting)

    def stop(self) -> None:
        """Ends the thread after the file that it is at, and forgets everything."""
        thread, self._thread = self._thread, None
        wanted, self._wanted = self._wanted, SimpleQueue()  # a thread that a disk holds up must not get the next's
        if thread is not None:
            with contextlib.suppress(Empty):
                while True:
                    wanted.get_nowait()
            wanted.put(None)
            thread.join(timeout=1.0)
        self._known.clear()
        self._asked.clear()
        self._waiting.clear()

    def _work(self, wanted: SimpleQueue[str | None]) -> None:
        while (path := wanted.get()) is not None:
            before, stamp = self._known.get(path), _stamp(Path(path))
            if before is None or before.stamp != stamp:
                try:
                    found = self.missing if stamp is None else replace(self.look(Path(path)), stamp=stamp)
                except Exception as error:  # the thread must outlive any file
                    found = replace(self.missing, stamp=stamp, problem=f"Cannot be read ({type(error).__name__})")
                self._known[path] = found
                self.changes += 1
            self._waiting.discard(path)


def same_file(path: str) -> str:
    """A path in the spelling by which two of them are compared; touches no disk."""
    return os.path.normcase(os.path.normpath(path))
