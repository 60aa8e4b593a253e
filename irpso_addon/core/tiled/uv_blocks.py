"""Large maps in pieces: a fixed lattice of blocks over each UV square, and cameras cropped to what shows one.

A block never depends on how blocks are grouped into tiles, on their order, or on who solves them: so maps are the same,
byte for byte, whatever the tile size.  docs/decisions/0010.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..data import F32, F64, I32, Bool, Camera
from ..errors import BadInput
from ..projection import pixels_of
from ..resampling import linear

ONE_PIECE = 2048  # texels: maps up to this size are solved at once
BLOCK, HALO = 512, 32  # texels: width of a block, and of what is solved around it and thrown away
CELL = 32  # texels: where a block knows nothing nearer, its holes are filled from the plan; divides BLOCK and HALO
PLAN, PLAN_SQUARE = 1024, 512  # texels: width of the plan's map, and of one of several squares on it
FIRST_UDIM, LAST_UDIM = 1001, 1999
MOST_UDIMS = 100
PICTURES = 0.25  # of the memory, for the plan's or a block's pictures; the rest is for maps, tables and shadows
MARGIN = 16  # pixels around what shows a block
FACING = -0.3  # cosine: texels that face away by more are seen by no pixel


@dataclass(frozen=True, order=True)
class UvBlock:
    """A block of a map."""

    udim: int  # 1001 is the UV square from 0 to 1
    y: int  # its first texel; row 0 is the bottom
    x: int
    size: int  # texels of the whole map on a side
    block: int = BLOCK
    halo: int = HALO

    @property
    def key(self) -> str:
        """Its name in files."""
        return f"{self.udim}_y{self.y:05}_x{self.x:05}"

    @property
    def side(self) -> int:
        """Texels on a side of what is solved: the block and its halo."""
        return self.block + 2 * self.halo

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the block; less than `block` at the map's end."""
        return min(self.block, self.size - self.y), min(self.block, self.size - self.x)

    @property
    def core(self) -> tuple[slice, slice]:
        """The block within what is solved."""
        height, width = self.shape
        return slice(self.halo, self.halo + height), slice(self.halo, self.halo + width)

    def grid(self, uvs: F32) -> F32:
        """(..., 2) where UVs lie on the square of texels that is solved, 0..1."""
        first = np.array([self.x, self.y], np.float64) - self.halo
        return np.asarray(((uvs - corner(self.udim)) * self.size - first) / self.side, np.float32)


def corner(udim: int) -> F64:
    """(2,) lower left corner of a UDIM's square."""
    return np.array([(udim - FIRST_UDIM) % 10, (udim - FIRST_UDIM) // 10], np.float64)


def udim_of_each(uvs: F32) -> I32:
    """(T,) the number of the square that holds a triangle's middle, 0: none has one; uvs: (T, 3, 2)."""
    squares = _squares(uvs)
    numbers = FIRST_UDIM + squares @ np.array([1, 10])
    inside = (squares >= 0).all(axis=1) & (squares[:, 0] < 10) & (numbers <= LAST_UDIM)
    return np.where(inside, numbers, 0).astype(np.int32)


def udims_of(uvs: F32) -> tuple[int, ...]:
    """The UDIMs of the squares that hold triangles (by their middle), ascending; uvs: (T, 3, 2).

    Raises BadInput where there are too many for them to be meant.
    """
    found = tuple(int(u) for u in np.unique(udim_of_each(uvs)) if u)
    if len(found) > MOST_UDIMS:
        raise BadInput(f"UV map: its faces lie in {len(found)} UDIM squares, at most {MOST_UDIMS} can be solved; "
                       "lay the islands out in fewer, or solve the square from 0 to 1 alone")
    return found


def solved_udims(udim: str, uvs: F32) -> tuple[int, ...]:
    """The UDIMs that a solve with this setting fills; none where no face lies in a square."""
    return udims_of(uvs) if udim == "all" else (FIRST_UDIM,)


def is_large(size: int, udims: tuple[int, ...]) -> bool:
    """Whether maps are solved in blocks, and kept in files."""
    return size > ONE_PIECE or udims != (FIRST_UDIM,)


def all_blocks(size: int, udims: Iterable[int], block: int = BLOCK, halo: int = HALO) -> list[UvBlock]:
    """All blocks of maps of ``size``, by UDIM, from the bottom row by row."""
    block = min(block, -(-size // CELL) * CELL)
    return [UvBlock(udim, y, x, size, block, halo)
            for udim in udims for y in range(0, size, block) for x in range(0, size, block)]


# ---- the plan's map: all squares side by side


@dataclass(frozen=True)
class Layout:
    """Where the plan's map holds each UDIM's square."""

    udims: tuple[int, ...]
    square: int  # texels of one on a side

    @property
    def columns(self) -> int:
        """Squares beside each other, and above each other."""
        return int(np.ceil(np.sqrt(len(self.udims))))

    @property
    def size(self) -> int:
        """Texels of the map on a side."""
        return self.columns * self.square

    def grid(self, uvs: F32) -> F32:
        """(T, 3, 2) where triangles lie on it, 0..1; those of other squares lie outside."""
        numbers = udim_of_each(uvs)
        place = np.searchsorted(self.udims, numbers).clip(0, len(self.udims) - 1)
        known = np.array(self.udims)[place] == numbers
        at = np.stack([place % self.columns, place // self.columns], -1)
        moved = (uvs - _squares(uvs)[:, None] + at[:, None]) / self.columns
        return np.where(known[:, None, None], moved, -2.0).astype(np.float32)

    def square_of(self, values: F32, udim: int) -> F32:
        """The part of a map of the plan, of any size, that is one UDIM's; to the nearest texel."""
        edges = np.rint(np.linspace(0, len(values), self.columns + 1)).astype(int)
        rows, columns = (slice(edges[n], edges[n + 1]) for n in divmod(self.udims.index(udim), self.columns))
        return values[rows, columns]

    def sampled(self, values: F32, window: UvBlock, count: int) -> F32:
        """(count, count, ...) of a map of the plan, of any size, at the middles of ``count`` x ``count`` cells."""
        place, square = self.udims.index(window.udim), len(values) / self.columns
        first = square * np.array([place % self.columns, place // self.columns])
        middles = (np.arange(count) + 0.5) * (window.side / count) - window.halo
        x, y = (np.clip((start + middles) / window.size * square - 0.5, 0, square - 1) + base
              for start, base in ((window.x, first[0]), (window.y, first[1])))
        return linear(linear(values, x, axis=1), y, axis=0).astype(np.float32)


def layout(size: int, udims: tuple[int, ...]) -> Layout:
    """Of the plan for maps of ``size``."""
    columns = int(np.ceil(np.sqrt(len(udims))))
    whole = min(ONE_PIECE, max(PLAN, PLAN_SQUARE * columns))
    return Layout(udims, min(size, whole // columns))


def _squares(uvs: F32) -> F64:
    """(T, 2) column and row of the square that holds each triangle's middle; -1 for what is no number."""
    middle = uvs.astype(np.float64).mean(axis=1)
    return np.floor(np.where(np.isfinite(middle).all(axis=1, keepdims=True), middle, -1.0))


# ---- cameras


@dataclass(frozen=True)
class Crop:
    """A part of a picture: first pixel, width and height, and how many pixels of it become one."""

    x: int
    y: int
    width: int
    height: int
    shrink: int = 1

    @property
    def pixels(self) -> int:
        """Of the part once it is shrunk."""
        return (self.width // self.shrink) * (self.height // self.shrink)


def crop_of(camera: Camera, width: int, height: int, position: F32, normal: F32, covered: Bool) -> Crop:
    """The part of a picture of ``width`` x ``height`` that shows a block's texels; a corner of it where none does.

    position, normal: (n, n, 3) world; covered: (n, n).
    """
    points, normals = position[covered].astype(np.float64), normal[covered].astype(np.float64)
    toward = -camera.forward if camera.orthographic else camera.position - points
    facing = (normals * toward).sum(axis=1) > FACING * np.linalg.norm(toward, axis=-1)
    at = pixels_of(camera, points, (width, height))
    seen = facing & np.isfinite(at).all(axis=1)
    if not seen.any():
        return Crop(0, 0, min(8, width), min(8, height))
    at = at[seen]
    low = np.clip(np.floor(at.min(axis=0)) - MARGIN, 0, [width - 1, height - 1]).astype(int)
    high = np.clip(np.ceil(at.max(axis=0)) + MARGIN, low + 1, [width, height]).astype(int)
    return Crop(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


def shrunk(crop: Crop, shrink: int, width: int, height: int) -> Crop:
    """Whole cells of ``shrink`` x ``shrink`` pixels that hold the crop, as far as the picture has whole cells."""
    x, columns = _cells(crop.x, crop.width, shrink, width)
    y, rows = _cells(crop.y, crop.height, shrink, height)
    return Crop(x, y, columns, rows, shrink)


def _cells(first: int, count: int, shrink: int, whole: int) -> tuple[int, int]:
    """First pixel and number of pixels of the cells that hold ``count`` pixels, of ``whole``."""
    most = max(whole // shrink, 1)
    low = min(first // shrink, most - 1)
    high = max(min(-(-(first + count) // shrink), most), low + 1)
    return low * shrink, (high - low) * shrink


def cropped(camera: Camera, width: int, height: int, crop: Crop) -> Camera:
    """The camera as if its picture were that part of ``width`` x ``height``."""
    if camera.lens is not None:
        lens = camera.lens.resized(width, height).part(crop.x, height - crop.y - crop.height, crop.width, crop.height)
        part = replace(camera, lens=lens, projection=lens.matrix)
    else:
        projection = camera.projection.copy()
        for row, (first, count, whole) in enumerate(((crop.x, crop.width, width), (crop.y, crop.height, height))):
            projection[row] = projection[row] * (whole / count) + projection[3] * ((whole - 2.0 * first) / count - 1.0)
        part = replace(camera, projection=projection)
    return replace(part, name=f"{camera.name} {width}x{height}", aspect=crop.width / crop.height, whole=camera,
                   part=(crop.x / width, crop.y / height, crop.width / width, crop.height / height))
