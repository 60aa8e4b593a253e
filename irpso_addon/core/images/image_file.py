"""Image files: the header, and the rows of the picture in them.  Row 0 is the top here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..data import F32
from . import decoder_pool, oiio_reader
from .oiio_reader import FORMS, Stored, StoredPicture


@dataclass(frozen=True)
class ImageFile:
    """An opened image: which channels of which part are the picture.  Pixels are not read yet."""

    path: Path
    part: int  # OpenImageIO's subimage
    channels: tuple[int, ...]  # R, G, B and, where there is one, A (a grey image repeats its channel)
    width: int  # of the display window: the whole frame
    height: int
    window: tuple[int, int, int, int]  # x, y, width, height of the stored pixels in that frame
    form: str  # a key of oiio_reader.FORMS: type of what is read
    bits: int  # per channel
    integer: bool
    premultiplied: bool
    colorspace: str | None  # as the file itself names it
    warnings: tuple[str, ...] = ()

    def bands(self, top: int = 0, bottom: int | None = None) -> Iterator[Stored]:
        """Rows ``top`` to ``bottom`` (exclusive) in order, some at a time: (rows, width, 3 or 4) as they are stored.

        0 outside the stored window.  Raises BadInput when the file ends early or is damaged.
        """
        x, y, width, height = self.window
        bottom = self.height if bottom is None else bottom
        first, last = max(top, y), min(bottom, y + height)
        left, right = max(0, x), min(self.width, x + width)
        if first >= last or left >= right:
            yield from self._nothing(bottom - top)
            return
        yield from self._nothing(first - top)
        picture = StoredPicture(self.part, self.channels, self.form, (width, height))
        for block in decoder_pool.bands(self.path, picture, first - y, last - y):
            if (left, right) == (0, self.width) == (x, x + width):
                yield block
            else:
                out: Stored = np.zeros((len(block), self.width, len(self.channels)), FORMS[self.form])
                out[:, left:right] = block[:, left - x:right - x]
                yield out
        yield from self._nothing(bottom - last)

    def read(self, top: int, bottom: int) -> F32:
        """The same rows at once, as `floats`."""
        out = np.empty((bottom - top, self.width, len(self.channels)), np.float32)
        at = 0
        for band in self.bands(top, bottom):
            out[at:at + len(band)] = floats(band)
            at += len(band)
        return out

    def _nothing(self, rows: int) -> Iterator[Stored]:
        step = max(1, oiio_reader.BAND // self.width)
        for at in range(0, rows, step):
            yield np.zeros((min(step, rows - at), self.width, len(self.channels)), FORMS[self.form])


def open_image(path: Path) -> ImageFile:
    """The header of ``path``, checked for size before anything is allocated.  Raises BadInput."""
    return ImageFile(path, **decoder_pool.header(path))


def floats(stored: Stored) -> F32:
    """Integers over 0..1, bit for bit as OpenImageIO converts them; floats as they are."""
    if stored.dtype.kind == "u":
        return np.asarray(stored * np.float32(1 / np.iinfo(stored.dtype).max), np.float32)
    return np.asarray(stored, np.float32)
