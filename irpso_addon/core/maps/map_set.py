"""Maps that are files, one for each UDIM where there are several, and copies of them in other formats."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..data import F32
from ..errors import BadInput
from ..images.colour import srgb_to_linear
from ..images.image_file import ImageFile, open_image
from ..storage.output_transaction import OutputTransaction
from ..tiled import uv_blocks
from ..tiled.uv_blocks import FIRST_UDIM, UvBlock
from . import block_merge
from .export import check_kind

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


def export(files: MapFiles, stem: str, out: Path, kind: str) -> list[Path]:
    """Copies in the folder ``out`` (made if missing), as `export.write_maps` names them; all or none.

    Never is a whole map in memory.  Raises BadInput for a file that is missing or damaged, or cannot be written.
    """
    check_kind(kind)
    layers = list(files.paths)
    udims = files.udims if files.tiled else (FIRST_UDIM,)
    opened = {(layer, udim): open_image(files.of(layer, udim)) for layer in layers for udim in udims}
    sizes = {(file.width, file.height) for file in opened.values()}
    size = min(width for width, _ in sizes)
    if sizes != {(size, size)}:
        raise BadInput(f"{files.of(layers[0], udims[0])}: this map and the others are not squares of one size; "
                       "solve again")
    windows = uv_blocks.all_blocks(size, udims)
    bands = _Bands(opened, layers, {window.key: window for window in windows})

    with OutputTransaction(Path(out)) as staging:
        target = block_merge.Target(staging.folder, stem, kind, layers, files.tiled)
        names = target.names(windows)
        if files.kind == kind:
            for name, source in zip(names, (opened[layer, udim] for udim in udims for layer in layers), strict=True):
                shutil.copyfile(source.path, staging.folder / name)
        else:
            block_merge.merge(bands.read, windows, target)
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
    colours = layer in ("basecolor", "roughness")
    return np.ascontiguousarray(stored if colours else stored[..., 0])
