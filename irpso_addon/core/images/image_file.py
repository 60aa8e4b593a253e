"""Image files: the header, and the rows of the picture in them.  Row 0 is the top here."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..data import F32
from . import decoder_pool, oiio_reader
from .colour import CameraColour
from .oiio_reader import FORMS, Stored, StoredPicture
from .shot_settings import NOTHING_SAID, ShotSettings

HEADERS = 2048  # of files that are remembered, each of about a kilobyte
TURNED = 128_000_000  # bytes of a turned picture that are held at a time
# Of stored rows and columns, by EXIF's orientation (CIPA DC-008, 4.6.4): reverse rows, reverse columns, then swap both
_TURNS = {1: (False, False, False), 2: (False, True, False), 3: (True, True, False), 4: (True, False, False),
          5: (False, False, True), 6: (True, False, True), 7: (True, True, True), 8: (False, True, True)}


@dataclass(frozen=True)
class ImageFile:
    """An opened image: which channels of which part are the picture.  Pixels are not read yet."""

    path: Path
    part: int  # OpenImageIO's subimage; of a RAW file 1 if it is read in full
    channels: tuple[int, ...]  # R, G, B and, where there is one, A (a grey image repeats its channel)
    width: int  # of the display window, the whole frame, upright
    height: int
    window: tuple[int, int, int, int]  # x, y, width, height of the stored pixels in that frame, before it is turned
    form: str  # a key of oiio_reader.FORMS: type of what is read
    bits: int  # per channel
    integer: bool
    premultiplied: bool
    colorspace: str | None  # as the file itself names it
    warnings: tuple[str, ...] = ()
    orientation: int = 1  # EXIF's: how the frame is turned
    shot: ShotSettings = NOTHING_SAID
    own: bool = False  # a map that image_writer.py has written
    camera: CameraColour | None = None  # of a RAW file, whose values are the camera's own, white 1

    def bands(self, top: int = 0, bottom: int | None = None) -> Iterator[Stored]:
        """Rows ``top`` to ``bottom`` (exclusive) of the upright picture in order: (rows, width, 3 or 4), as stored.

        Some at a time; 0 outside the stored window.  Raises BadInput when the file ends early or is damaged.
        """
        bottom = self.height if bottom is None else bottom
        if self.orientation == 1:
            yield from self._lying(top, bottom, self.width, self.height)
        else:
            yield from self._turned(top, bottom)

    def _turned(self, top: int, bottom: int) -> Iterator[Stored]:
        """As `bands`.  The file is read once for each TURNED bytes: no more of it is held."""
        up, left, swap = _TURNS[self.orientation]
        width, height = (self.height, self.width) if swap else (self.width, self.height)
        row = self.width * len(self.channels) * np.dtype(FORMS[self.form]).itemsize
        for first in range(top, bottom, step := max(1, TURNED // row)):
            last = min(first + step, bottom)
            # The stored rows, or where the two are swapped the stored columns, that these upright rows are.
            size, reverse = (width, left) if swap else (height, up)
            start, stop = (size - last, size - first) if reverse else (first, last)
            rows = (0, height) if swap else (start, stop)
            columns = slice(start, stop) if swap else slice(None)
            held: Stored = np.concatenate([  # (a view would hold the whole band)
                np.ascontiguousarray(band[:, columns]) for band in self._lying(*rows, width, height)])
            held = held[::-1 if up else 1, ::-1 if left else 1]
            yield np.ascontiguousarray(held.swapaxes(0, 1) if swap else held)

    def _lying(self, top: int, bottom: int, width: int, height: int) -> Iterator[Stored]:
        """Rows of the frame as it is stored, of that size."""
        x, y, w, h = self.window
        first, last = max(top, y), min(bottom, y + h)
        left, right = max(0, x), min(width, x + w)
        if first >= last or left >= right:
            yield from self._nothing(bottom - top, width)
            return
        yield from self._nothing(first - top, width)
        picture = StoredPicture(self.part, self.channels, self.form, (w, h))
        for block in decoder_pool.bands(self.path, picture, first - y, last - y):
            if (left, right) == (0, width) == (x, x + w):
                yield block
            else:
                out: Stored = np.zeros((len(block), width, len(self.channels)), FORMS[self.form])
                out[:, left:right] = block[:, left - x:right - x]
                yield out
        yield from self._nothing(bottom - last, width)

    def read(self, top: int, bottom: int) -> F32:
        """The same rows at once, as `floats`."""
        out = np.empty((bottom - top, self.width, len(self.channels)), np.float32)
        at = 0
        for band in self.bands(top, bottom):
            out[at:at + len(band)] = floats(band)
            at += len(band)
        return out

    def _nothing(self, rows: int, width: int) -> Iterator[Stored]:
        step = max(1, oiio_reader.BAND // width)
        for at in range(0, rows, step):
            yield np.zeros((min(step, rows - at), width, len(self.channels)), FORMS[self.form])


def open_image(path: Path, full: bool = False) -> ImageFile:
    """The header of ``path``, checked for size before anything is allocated.  Raises BadInput.

    ``full``: of a RAW file with a pixel for each sample.  It is read once until the file changes: LibRaw unpacks all of
    a RAW file for it.
    """
    try:
        now = os.stat(path)
    except (OSError, ValueError):  # the decoder states what is wrong
        return ImageFile(path, **decoder_pool.header(path, full))
    return _opened(path, full, (now.st_mtime_ns, now.st_size, now.st_ino, now.st_dev))


@lru_cache(HEADERS)
def _opened(path: Path, full: bool, _stamp: tuple[int, ...]) -> ImageFile:
    """The header of a file as it was at that time."""
    return ImageFile(path, **decoder_pool.header(path, full))


def floats(stored: Stored) -> F32:
    """Integers over 0..1, bit for bit as OpenImageIO converts them; floats as they are."""
    if stored.dtype.kind == "u":
        return np.asarray(stored * np.float32(1 / np.iinfo(stored.dtype).max), np.float32)
    return np.asarray(stored, np.float32)
