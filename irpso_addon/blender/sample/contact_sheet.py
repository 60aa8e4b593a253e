"""A labelled picture out of tiles.  Blender draws the letters: its own OpenImageIO is built without fonts."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import blf
import bpy
import imbuf
import numpy as np
import OpenImageIO as oiio

from ...core.data import F32
from ...core.errors import BadInput
from ...core.storage.atomic_io import replacing

FONT = 0  # Blender's interface font
MARGIN, HEADER, TEXT = 12, 34, 17  # pixels
BACKGROUND, INK = 0.11, 0.92


def save(path: Path, rows: Sequence[Sequence[tuple[str, F32]]], *, quality: int = 90) -> None:
    """Write tiles as one JPEG, each under its label.

    A tile is (h, w, 3), display-encoded 0..1, row 0 at the bottom; all of them of one size.
    """
    height, width = rows[0][0][1].shape[:2]
    step_y, step_x = height + HEADER + MARGIN, width + MARGIN
    canvas = np.full((len(rows) * step_y, len(rows[0]) * step_x + MARGIN, 4), BACKGROUND, np.float32)
    canvas[..., 3] = 1
    labels = []
    for r, row in enumerate(reversed(rows)):  # row 0 is the bottom
        for c, (label, tile) in enumerate(row):
            y, x = MARGIN + r * step_y, MARGIN + c * step_x
            canvas[y:y + height, x:x + width, :3] = np.clip(tile, 0, 1)
            labels.append((label, x, y + height + 10))
    with tempfile.TemporaryDirectory() as folder:
        blank, labelled = Path(folder) / "tiles.png", Path(folder) / "labelled.png"
        save_png(blank, canvas)
        write_labels(blank, labelled, labels)
        _save_jpeg(labelled, path, quality)


def save_png(path: Path, canvas: F32) -> None:
    """A canvas (h, w, 4), display-encoded 0..1, row 0 at the bottom, as a PNG."""
    image = bpy.data.images.new(path.name, canvas.shape[1], canvas.shape[0])
    image.pixels.foreach_set(canvas.ravel())
    image.file_format, image.filepath_raw = "PNG", str(path)
    image.save()
    bpy.data.images.remove(image)


def write_labels(source: Path, target: Path, labels: Sequence[tuple[str, int, int]]) -> None:
    """The picture with texts in it, each at its place: pixels from the left and from the bottom."""
    picture = imbuf.load(str(source))
    blf.size(FONT, TEXT)
    blf.color(FONT, INK, INK, INK, 1.0)
    with blf.bind_imbuf(FONT, picture):
        for text, x, y in labels:
            blf.position(FONT, x, y, 0)
            blf.draw_buffer(FONT, text)
    imbuf.write(picture, filepath=str(target))
    picture.free()


def _save_jpeg(source: Path, target: Path, quality: int) -> None:
    """Full colour resolution: the errors shown must be ours, not JPEG's."""
    picture = oiio.ImageBufAlgo.channels(oiio.ImageBuf(str(source)), (0, 1, 2))
    picture.specmod().attribute("Compression", f"jpeg:{quality}")
    picture.specmod().attribute("jpeg:subsampling", "4:4:4")
    try:
        with replacing(target) as part:
            if not picture.write(str(part)):
                raise OSError(None, picture.geterror().strip())
    except OSError as error:
        raise BadInput(f"{target}: cannot be written ({error.strerror}); choose another folder") from None
