"""Maps to image files, row by row, by OpenImageIO.  Files have row 0 at the top, memory at the bottom: turned here."""

from __future__ import annotations

import zlib
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from ..data import F32
from ..errors import BadInput
from ..storage.atomic_io import replacing
from .colour import linear_to_srgb
from .oiio_reader import MARK

_FULL = "the disk may be full"
_PNG_END = b"IEND\xaeB`\x82"
CHANNELS = {1: ("Y",), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}
UNASSOCIATED = "oiio:UnassociatedAlpha"
_SLAB = 64  # rows written at a time: the same whoever calls, and whole strips of TIFF and EXR


def write_image(path: Path, array: F32, *, kind: str, color: bool) -> None:
    """Writes ``array`` (h, w), (h, w, 3) or (h, w, 4), row 0 at the bottom, whole or not at all.  See `ImageWriter`."""
    height, width = array.shape[:2]
    channels = array.shape[2] if array.ndim == 3 else 1
    with ImageWriter(path, width, height, channels, kind=kind, color=color) as writer:
        writer.add(array)


class ImageWriter:
    """An image file written from its top to its bottom; it appears, whole, when the block ends without an error.

    ``kind`` "exr": 32-bit float, ZIP, linear.  "png", "tiff": 16 bits, 0..1; "png8": PNG of 8; with ``color`` encoded
    sRGB.  Of four channels the last is alpha, with which the others are not multiplied.
    Raises BadInput when the folder cannot be written or the disk is full; ``path`` is then as before.
    """

    def __init__(self, path: Path, width: int, height: int, channels: int, *, kind: str, color: bool) -> None:
        self.path, self.width, self.height, self.channels = Path(path), width, height, channels
        self.float, self.encoded = kind == "exr", color and kind != "exr"
        self._depth: Any = np.uint8 if kind == "png8" else np.uint16
        self._row = 0  # of the file: how many are written
        self._sum = 0  # of their bytes
        self._file: Any = None
        self._replacing = replacing(self.path)

    def __enter__(self) -> ImageWriter:
        import OpenImageIO

        depth = "float" if self.float else self._depth.__name__
        spec = OpenImageIO.ImageSpec(self.width, self.height, self.channels, depth)
        spec.channelnames = CHANNELS[self.channels]
        if self.channels == 4:
            spec.alpha_channel = 3
            spec.attribute(UNASSOCIATED, 1)  # else the colours are divided by alpha
        spec.attribute("compression", "zip")
        spec.attribute("ImageDescription", MARK)
        spec.attribute("DateTime", "1970:01:01 00:00:00")  # else the time of writing: other bytes each time
        if not self.float:
            spec.attribute("oiio:ColorSpace", "sRGB" if self.encoded else "Raw")
        try:
            self._part = self._replacing.__enter__()
        except OSError as error:
            raise self._failed(error.strerror) from None
        try:
            self._file = OpenImageIO.ImageOutput.create(str(self._part))
            if self._file is None:
                raise self._failed("its ending is not an image format's")
            self._check(self._file.open(str(self._part), spec))
        except BadInput as error:
            self.__exit__(type(error), error, None)
            raise
        return self

    def add(self, array: F32) -> None:
        """The next rows below those written so far: (rows, width, channels), or (rows, width), row 0 at the bottom."""
        pixels = array[::-1] if array.ndim == 3 else array[::-1, :, None]
        for start in range(0, len(pixels), _SLAB):
            slab = self._stored(pixels[start:start + _SLAB])
            self._sum = zlib.crc32(slab, self._sum)
            self._check(self._file.write_scanlines(self._row, self._row + len(slab), 0, slab))
            self._row += len(slab)

    def finish(self) -> None:
        """Close the file and compare what lies there with what was written.  Leaving does so too."""
        if self._file is None:
            return
        assert self._row == self.height, f"{self.path}: {self._row} of {self.height} rows"
        self._check(self._file.close())
        self._file = None
        if self._read_back() != self._sum:  # not every format's writer notices that the disk is full
            raise self._failed(_FULL)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None,
    ) -> None:
        problem = error
        if problem is None:
            try:
                self.finish()
            except BadInput as found:
                problem = found
        if self._file is not None:
            self._file.close()
            self._file = None
        try:
            self._replacing.__exit__(None if problem is None else type(problem), problem, None)
        except OSError as found:
            problem = self._failed(found.strerror)
        if problem is not error:
            assert problem is not None
            raise problem from None

    def _stored(self, rows: F32) -> Any:
        """As the file holds them."""
        if self.float:
            return np.ascontiguousarray(rows, np.float32)
        values = (linear_to_srgb(rows) if self.encoded else rows).clip(0, 1)
        return np.round(values * np.iinfo(self._depth).max).astype(self._depth)

    def _check(self, done: bool) -> None:
        if not done:  # OpenImageIO's words name a file that the user does not know
            self._file.geterror()
            raise self._failed(_FULL)

    def _read_back(self) -> int:
        """The sum of what the file holds; -1 where it cannot be read."""
        import OpenImageIO

        with self._part.open("rb") as content:
            content.seek(-min(len(_PNG_END), content.seek(0, 2)), 2)
            if self._part.suffix == ".png" and content.read() != _PNG_END:  # libpng prints what it thinks of that
                return -1
        as_it_is = OpenImageIO.ImageSpec()
        as_it_is.attribute(UNASSOCIATED, 1)
        file = OpenImageIO.ImageInput.open(str(self._part), as_it_is)
        if file is None:
            OpenImageIO.geterror()
            return -1
        found = 0
        try:
            for row in range(0, self.height, _SLAB):
                last = min(row + _SLAB, self.height)
                slab = file.read_scanlines(row, last, 0, 0, self.channels, file.spec().format)
                if slab is None or file.geterror():
                    return -1
                found = zlib.crc32(np.ascontiguousarray(slab), found)
        finally:
            file.close()
        return found

    def _failed(self, why: str | None) -> BadInput:
        return BadInput(f"{self.path}: cannot be written ({why}); check the folder and the free space")
