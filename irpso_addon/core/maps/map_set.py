"""Maps that are files, one for each UDIM where there are several, and copies of them in other formats."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..data import F32, Maps
from ..errors import BadInput
from ..images.colour import srgb_to_linear
from ..images.image_file import ImageFile, open_image
from ..storage.output_transaction import OutputTransaction
from ..tiled import uv_blocks
from ..tiled.uv_blocks import FIRST_UDIM, UvBlock
from . import block_merge
from .export import check_kind
from .export import layers as layers_of

UDIM = "<UDIM>"  # stands for its number in a path, for Blender too


@dataclass(frozen=True)
class MapFiles:
    """The files of an object's maps."""

    paths: Mapping[str, Path]  # layer, as export.py names it -> file; `UDIM` in it stands for each of the numbers
    udims: tuple[int, ...]

    @property
    def tiled(self) -> bool:
        """Whether each UDIM has a file of its own."""
        return UDIM in next(iter(self.paths.values())).name

    @property
    def kind(self) -> str:
        """Of the files, as in core/maps/export.py."""
        return next(iter(self.paths.values())).suffix[1:]

    def of(self, layer: str, udim: int) -> Path:
        """One file."""
        path = self.paths[layer]
        return path.with_name(path.name.replace(UDIM, str(udim)))


@dataclass(frozen=True)
class MapReader:
    """Maps that are read block by block, from files or from memory."""

    windows: Sequence[UvBlock]
    read: block_merge.ReadBlock  # layers of a block by its key, row 0 at the bottom
    layers: frozenset[str]  # as export.py names them
    tiled: bool = False  # whether files of them are named by their UDIM
    paths: tuple[Path, ...] = ()  # the files that are read

    @classmethod
    def of_maps(cls, maps: Maps) -> MapReader:
        """Of maps in memory."""
        arrays = layers_of(maps)
        windows = uv_blocks.all_blocks(len(maps.roughness), (FIRST_UDIM,))
        places = {window.key: tuple(slice(first, first + length) for first, length in zip(
            (window.y, window.x), window.shape, strict=True)) for window in windows}
        return cls(windows, lambda key: {layer: array[places[key]] for layer, array in arrays.items()},
                   frozenset(arrays))

    @classmethod
    def of_files(cls, files: MapFiles, layers: Sequence[str]) -> MapReader:
        """Of ``layers`` of files, never whole in memory.  Raises BadInput for one that is missing or damaged."""
        udims = files.udims if files.tiled else (FIRST_UDIM,)
        opened = {(layer, udim): open_image(files.of(layer, udim)) for udim in udims for layer in layers}
        sizes = {(file.width, file.height) for file in opened.values()}
        size = min(width for width, _ in sizes)
        if sizes != {(size, size)}:
            raise BadInput(f"{files.of(layers[0], udims[0])}: this map and the others are not squares of one size; "
                           "solve again")
        windows = uv_blocks.all_blocks(size, udims)
        bands = _Bands(opened, list(layers), {window.key: window for window in windows})
        return cls(windows, bands.read, frozenset(layers), files.tiled, tuple(file.path for file in opened.values()))


def export(files: MapFiles, stem: str, out: Path, kind: str) -> list[Path]:
    """Copies in the folder ``out`` (made if missing), as `export.write_maps` names them; all or none.

    Never is a whole map in memory.  Raises BadInput for a file that is missing or damaged, or cannot be written.
    """
    check_kind(kind)
    layers = list(files.paths)
    reader = MapReader.of_files(files, layers)
    with OutputTransaction(Path(out)) as staging:
        target = block_merge.Target(staging.folder, stem, kind, layers, files.tiled)
        names = target.names(reader.windows)
        if files.kind == kind:
            for name, path in zip(names, reader.paths, strict=True):
                shutil.copyfile(path, staging.folder / name)
        else:
            block_merge.merge(reader.read, reader.windows, target)
        staging.publish()
        return [staging.out / name for name in names]


class _Bands:
    """Blocks of maps' files; `block_merge.merge` asks for those of a row together, so that each file is read once."""

    def __init__(
        self, files: Mapping[tuple[str, int], ImageFile], layers: list[str], windows: Mapping[str, UvBlock],
    ) -> None:
        self._files, self._layers, self._windows = files, layers, windows
        self._row: tuple[int, int] | None = None  # UDIM, first texel
        self._bands: dict[str, F32] = {}

    def read(self, key: str) -> dict[str, F32]:
        """The layers of a block, row 0 at the bottom."""
        window = self._windows[key]
        if self._row != (window.udim, window.y):
            self._bands.clear()
            self._bands = {layer: _band(self._files[layer, window.udim], window, layer) for layer in self._layers}
            self._row = window.udim, window.y
        columns = slice(window.x, window.x + window.shape[1])
        return {layer: band[:, columns] for layer, band in self._bands.items()}


def _band(file: ImageFile, window: UvBlock, layer: str) -> F32:
    """(h, size) or (h, size, 3): the rows that a block has, of the whole map."""
    stored = file.read(file.height - window.y - window.shape[0], file.height - window.y)[::-1, :, :3]
    if layer == "basecolor" and file.integer:
        return np.asarray(srgb_to_linear(stored), np.float32)
    colours = layer in ("basecolor", "roughness", "normal")
    return np.ascontiguousarray(stored if colours else stored[..., 0])
