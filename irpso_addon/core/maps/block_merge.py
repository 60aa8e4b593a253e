"""Blocks of a large solve to the files of its maps, a row of blocks at a time: no whole map is ever in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from itertools import groupby
from pathlib import Path

import numpy as np

from ..data import F32
from ..errors import BadInput
from ..images.image_writer import ImageWriter
from ..storage.atomic_io import remove_leftovers
from ..tiled.uv_blocks import UvBlock
from .export import as_stored, check_kind, file_name

ReadBlock = Callable[[str], dict[str, F32]]


def merge(
    read_block: ReadBlock, windows: Sequence[UvBlock], stem: str, folder: Path, kind: str, layers: Sequence[str], *,
    tiled: bool = False,
) -> list[Path]:
    """Write the maps that ``windows`` make up, those of one UDIM or more; the files' paths.

    ``read_block`` gives a block's layers by `UvBlock.key`; ``layers`` says which are written; ``tiled``: names hold the
    UDIM, ``<object>_<layer>.1001.exr``.  The bytes are those of `export.write_maps`.  Each file appears whole or not at
    all, under a name of its writer's own until then: several may merge into a folder, even the same maps.
    Raises BadInput for what cannot be written.
    """
    for _ in steps(read_block, windows, stem, folder, kind, layers, tiled=tiled):
        pass
    return [Path(folder) / name for name in names(windows, stem, kind, layers, tiled=tiled)]


def names(windows: Sequence[UvBlock], stem: str, kind: str, layers: Sequence[str], *, tiled: bool = False) -> list[str]:
    """The files that `merge` writes."""
    udims = sorted({window.udim for window in windows})
    assert tiled or len(udims) == 1, "maps of several UDIMs need several names"
    return [file_name(stem, layer, kind, udim if tiled else None) for udim in udims for layer in layers]


def steps(
    read_block: ReadBlock, windows: Sequence[UvBlock], stem: str, folder: Path, kind: str, layers: Sequence[str], *,
    tiled: bool = False,
) -> Iterator[float]:
    """`merge` in steps of a row of blocks; gives the share that is done."""
    check_kind(kind)
    remove_leftovers(Path(folder))
    ordered = sorted(windows, key=lambda w: (w.udim, -w.y, w.x))  # as files are written: the top first
    done = 0
    for udim, those in groupby(ordered, key=lambda w: w.udim):
        targets = [Path(folder) / name for name in
                   names([w for w in ordered if w.udim == udim], stem, kind, layers, tiled=tiled)]
        with ExitStack() as files:
            writers: list[ImageWriter] = []
            for _, row in groupby(those, key=lambda w: w.y):
                blocks = list(row)
                bands = _band(read_block, blocks, layers)
                if not writers:
                    size = blocks[0].size
                    writers = [files.enter_context(ImageWriter(path, size, size, band.shape[2], kind=kind,
                                                               color=layer == "basecolor"))
                               for path, layer, band in zip(targets, layers, bands.values(), strict=True)]
                for writer, band in zip(writers, bands.values(), strict=True):
                    writer.add(band)
                done += len(blocks)
                yield done / len(ordered)
            for writer in writers:  # all are known to be whole before the first appears
                writer.finish()


def _band(read_block: ReadBlock, blocks: Sequence[UvBlock], layers: Sequence[str]) -> dict[str, F32]:
    """A row of blocks as (rows, size, channels) for each layer."""
    size, rows = blocks[0].size, blocks[0].shape[0]
    bands: dict[str, F32] = {}
    for window in blocks:
        block = read_block(window.key)
        for layer in layers:
            values = as_stored(layer, block[layer]) if layer in block else None
            if values is None or values.shape[:2] != window.shape:
                raise BadInput(f"{window.key}: this block does not hold '{layer}'; remove the work folder, run again")
            band = bands.setdefault(layer, np.empty((rows, size, values.shape[2]), np.float32))
            if band.shape[2] != values.shape[2]:
                raise BadInput(f"{window.key}: '{layer}' has other channels; remove the work folder, run again")
            band[:, window.x:window.x + window.shape[1]] = values
    return bands
