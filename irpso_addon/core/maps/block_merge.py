"""Blocks of a large solve to the files of its maps, a row of blocks at a time: no whole map is ever in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Target:
    """The files that blocks are merged into."""

    folder: Path
    stem: str  # the object's name
    kind: str  # of KINDS in export.py
    layers: Sequence[str]  # which are written
    tiled: bool = False  # the names hold the UDIM, ``<object>_<layer>.1001.exr``

    def names(self, blocks: Sequence[UvBlock]) -> list[str]:
        """Of all files, those of one UDIM after those of another."""
        udims = sorted({block.udim for block in blocks})
        assert self.tiled or len(udims) == 1, "maps of several UDIMs need several names"
        return [file_name(self.stem, layer, self.kind, udim if self.tiled else None)
                for udim in udims for layer in self.layers]


def merge(read_block: ReadBlock, windows: Sequence[UvBlock], target: Target) -> list[Path]:
    """Write the maps that ``windows`` make up, those of one UDIM or more; the files' paths.

    ``read_block`` gives a block's layers by `UvBlock.key`.  The bytes are those of `export.write_maps`.  Each file
    appears whole or not at all, under a name of its writer's own until then: several may merge into a folder, even the
    same maps.  Raises BadInput for what cannot be written.
    """
    for _ in steps(read_block, windows, target):
        pass
    return [target.folder / name for name in target.names(windows)]


def steps(read_block: ReadBlock, windows: Sequence[UvBlock], target: Target) -> Iterator[float]:
    """`merge` in steps of a row of blocks; gives the share that is done."""
    check_kind(target.kind)
    remove_leftovers(target.folder)
    ordered = sorted(windows, key=lambda w: (w.udim, -w.y, w.x))  # as files are written: the top first
    done = 0
    for udim, those in groupby(ordered, key=lambda w: w.udim):
        paths = [target.folder / name for name in target.names([w for w in ordered if w.udim == udim])]
        with ExitStack() as files:
            writers: list[ImageWriter] = []
            for _, row in groupby(those, key=lambda w: w.y):
                blocks = list(row)
                bands = _band(read_block, blocks, target.layers)
                if not writers:
                    size = blocks[0].size
                    writers = [files.enter_context(ImageWriter(path, size, size, band.shape[2], kind=target.kind,
                                                               color=layer == "basecolor"))
                               for path, (layer, band) in zip(paths, bands.items(), strict=True)]
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
