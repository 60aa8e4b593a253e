"""Masks of reference images, band by band, at the image's size."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..data import F32, F64, I32
from ..errors import BadInput
from .image_file import ImageFile, floats, open_image

ASPECT = 0.01  # greatest relative difference of the aspects of mask and image


def read_mask(path: Path) -> F32:
    """(h, w), row 0 at the bottom: the grey value times the alpha of an image.  Raises BadInput."""
    return np.ascontiguousarray(np.concatenate(list(_grey(open_image(path))))[::-1])


class Mask:
    """A mask of any size with its image's aspect: its grey value times its alpha."""

    def __init__(self, path: Path, image: ImageFile) -> None:
        """Raises BadInput."""
        self.file, self.image = open_image(path), image
        if abs(self.file.width / self.file.height * image.height / image.width - 1) > ASPECT:
            raise BadInput(f"{path}: mask is {self.file.width} x {self.file.height} pixels, its image {image.width} x "
                           f"{image.height}; give it the same aspect")

    def rows(self) -> Rows:
        """Its rows from the top down."""
        return Rows(self.file, self.image.width, self.image.height)


class Rows:
    """Rows of a mask at (height, width) by a triangle filter, as wide as a pixel of the coarser of the two."""

    def __init__(self, file: ImageFile, width: int, height: int) -> None:
        self._bands = _grey(file)
        self._across = None if file.width == width else _taps(file.width, width, 0, width)
        self._file, self._height = file, height
        self._held = np.empty((0, width), np.float32)
        self._top = 0  # row of the file that the first one held is
        self._next = 0

    def take(self, count: int) -> F32:
        """(count, width), 0..1: the next rows.  Raises BadInput."""
        where, share = _taps(self._file.height, self._height, self._next, self._next + count)
        self._next += count
        first, last = int(where.min()), int(where.max())
        parts, self._top = [self._held[first - self._top:]], first
        have = first + len(parts[0])
        while have <= last:
            band = next(self._bands)
            have += len(band)
            parts.append(band if self._across is None else _weighed(band.T, *self._across).T)
        self._held = np.concatenate(parts)
        if self._file.height == self._height:
            return np.clip(self._held[where[:, 0] - self._top], 0, 1)
        return np.clip(_weighed(self._held, where - self._top, share), 0, 1)


def _grey(file: ImageFile) -> Iterator[F32]:
    """(rows, width) of the file, whole bands."""
    for band in file.bands():
        pixels = floats(band)
        grey = pixels[..., :3].mean(-1)
        if pixels.shape[-1] == 4 and not file.premultiplied:
            grey = grey * pixels[..., 3]
        if not np.isfinite(grey).all():
            raise BadInput(f"{file.path}: mask has NaN or infinite pixels; save it again")
        yield grey


def _taps(size: int, wanted: int, first: int, last: int) -> tuple[I32, F64]:
    """Pixels ``first`` to ``last`` of ``wanted``: of which of ``size`` pixels they are made, (n, taps), and shares."""
    if size == wanted:
        return np.arange(first, last, dtype=np.int32)[:, None], np.ones((last - first, 1))
    centre = (np.arange(first, last) + 0.5) * size / wanted - 0.5
    radius = max(1.0, size / wanted)
    at = np.floor(centre)[:, None] + np.arange(-int(radius), int(radius) + 2)
    share = np.maximum(0.0, 1 - np.abs(at - centre[:, None]) / radius)
    return at.clip(0, size - 1).astype(np.int32), share / share.sum(1, keepdims=True)


def _weighed(values: F32, where: I32, share: F64) -> F32:
    """(n, ...): for each row of ``where`` (n, taps) the weighed sum of rows of ``values``."""
    total = np.zeros((len(where), *values.shape[1:]), np.float32)
    for tap in range(where.shape[1]):
        total += share[:, tap, None].astype(np.float32) * values[where[:, tap]]
    return total
