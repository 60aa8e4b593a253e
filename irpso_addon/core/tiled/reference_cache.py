"""Developed references as files that are read by windows: pictures too large, or too many, to be held in memory.

A line of JSON, then rows from the top down, each pixel four floats: radiance (W/(m^2 sr)) and coverage, exactly as
`reference_image.read_reference` gives them.  The sign bit of the coverage is set where a pixel is not valid.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..data import F32, RadianceImage, View
from ..errors import BadInput
from ..images.reference_image import Pixels, Reference, reduce
from ..storage.atomic_io import replacing
from ..storage.text_file import first_bytes

MAGIC = b"IRPSO picture 2 "
LONGEST = 1 << 16  # bytes of the first line
PIXEL = 16  # bytes
AT_ONCE = 1 << 18  # pixels that are reduced together


def cache_reference(view: View, path: Path) -> None:
    """Develops ``view.image`` into the file ``path``, whole or not at all, in constant memory.

    Raises BadInput as `reference_image.read_reference`, and when ``path`` cannot be written.
    """
    reference = Reference(view)
    try:
        with replacing(path) as part, part.open("wb") as file:
            file.write(_first_line(reference))
            reference.check(_write(file, reference.bands()))
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror}); check the folder and the free space") from None


def _first_line(reference: Reference) -> bytes:
    known = {"width": reference.width, "height": reference.height, "clipped_share": reference.clipped_share,
             "warnings": reference.warnings}
    return MAGIC + json.dumps(known).encode() + b"\n"


def _write(file: IO[bytes], bands: Iterator[Pixels]) -> bool:
    """Whether some pixel is usable."""
    usable = False
    for rgb, coverage, valid in bands:
        usable = usable or bool(np.any(valid & (coverage > 0)))
        rows = np.empty((*valid.shape, 4), np.float32)
        rows[..., :3] = rgb
        rows[..., 3] = np.where(valid, coverage, -coverage)
        file.write(rows.data)
    return usable


class CachedReference:
    """A file of `cache_reference`.  Holds no pixels and no open file: any thread may read windows of it."""

    def __init__(self, path: Path) -> None:
        """Raises BadInput when ``path`` is no such file, or not whole."""
        self.path = path
        line, end, _ = first_bytes(path, LONGEST).partition(b"\n")
        try:
            known: dict[str, Any] = json.loads(line.removeprefix(MAGIC))
            self.width, self.height = int(known["width"]), int(known["height"])
            self.clipped_share = float(known["clipped_share"])
            self.warnings = tuple(str(text) for text in known["warnings"])
            size = path.stat().st_size
        except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
            raise self._damaged() from None
        self._start = len(line) + len(end)
        if not line.startswith(MAGIC) or min(self.width, self.height) < 1 or (
                size != self._start + PIXEL * self.width * self.height):
            raise self._damaged()

    def window(self, x: int, y: int, w: int, h: int, shrink: int = 1) -> RadianceImage:
        """``w`` x ``h`` pixels whose lower left one is (``x``, ``y``); row 0 of the picture is the bottom.

        What lies outside the picture has no coverage and is not valid.  With ``shrink`` k, which divides both sizes,
        each k x k pixels become their mean; it is valid only if all of them are.  Raises BadInput when the file
        cannot be read.
        """
        if w % shrink or h % shrink:
            raise ValueError(f"a window of {w} x {h} pixels cannot be reduced by {shrink}")
        width, height = w // shrink, h // shrink
        rgb, coverage = np.empty((height, width, 3), np.float32), np.empty((height, width), np.float32)
        valid = np.empty((height, width), np.bool_)
        step = max(1, AT_ONCE // (w * shrink))
        for first in range(0, height, step):
            rows = min(step, height - first)
            pixels = _parted(self._read(x, y + first * shrink, w, rows * shrink))
            if shrink > 1:
                pixels = reduce(pixels, np.arange(rows + 1.0) * shrink, np.arange(width + 1.0) * shrink)
            for out, values in zip((rgb, coverage, valid), pixels, strict=True):
                out[first:first + rows] = values
        return RadianceImage(rgb, coverage, valid, self.warnings, self.clipped_share)

    def _read(self, x: int, y: int, w: int, h: int) -> F32:
        """(h, w, 4) as it is stored, row 0 at the bottom; outside not valid, without coverage."""
        out = np.empty((h, w, 4), np.float32)
        left, right = min(max(x, 0), self.width), min(max(x + w, 0), self.width)
        try:
            with self.path.open("rb", buffering=0) as file:
                for row in range(h):
                    if left >= right or not 0 <= y + row < self.height:
                        out[row] = OUTSIDE
                        continue
                    out[row, :left - x], out[row, right - x:] = OUTSIDE, OUTSIDE
                    inside = out[row, left - x:right - x]
                    file.seek(self._start + PIXEL * ((self.height - 1 - y - row) * self.width + left))
                    if file.readinto(inside.data) != inside.nbytes:
                        raise self._damaged()
        except OSError as error:
            raise BadInput(f"{self.path}: cannot be read ({error.strerror}); start the solve again") from None
        return out

    def _damaged(self) -> BadInput:
        return BadInput(f"{self.path}: is not a developed picture, or is cut short; start the solve in an empty folder")


OUTSIDE = np.array([0.0, 0.0, 0.0, -0.0], np.float32)


def _parted(stored: F32) -> Pixels:
    """What is stored, (h, w, 4), as radiance, coverage and validity."""
    return stored[..., :3], np.abs(stored[..., 3]), ~np.signbit(stored[..., 3])
