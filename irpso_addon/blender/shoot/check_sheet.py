"""The picture of a check before a solve: views with the mesh's edges over them, their figures, and what is wrong."""

from __future__ import annotations

import tempfile
import textwrap
from pathlib import Path

import bpy
import numpy as np

from ...core.checks.check_tile import HEIGHT, WIDTH
from ...core.checks.shoot_check import ShootCheck
from ...core.errors import BadInput
from ...core.storage.atomic_io import replacing
from ..sample.contact_sheet import BACKGROUND, MARGIN, save_png, write_labels
from .still_image import load_still, still_image

NAME = "IRPSO Check"  # of the image
COLUMNS, LINE, LETTER = 4, 24, 8.2  # of tiles; pixels
LEGEND = "blue: edges of the mesh; yellow circles: predicted highlights; pink cross: brightest place; red: clipped"


def save(check: ShootCheck, path: Path) -> None:
    """As a PNG.  Raises BadInput where it cannot be written."""
    with tempfile.TemporaryDirectory() as folder:
        labelled = _made(check, Path(folder))
        try:
            with replacing(path) as part:
                part.write_bytes(labelled.read_bytes())
        except OSError as error:
            raise BadInput(f"{path}: cannot be written ({error.strerror}); choose another place") from None


def last_image() -> bpy.types.Image | None:
    """The image that the last check has left."""
    return still_image(NAME)


def to_image(check: ShootCheck) -> bpy.types.Image:
    """As Blender's image of that name, which no file keeps."""
    with tempfile.TemporaryDirectory() as folder:
        return load_still(NAME, _made(check, Path(folder)))


def _made(check: ShootCheck, folder: Path) -> Path:
    """The sheet, in a file in ``folder``."""
    columns = max(1, min(COLUMNS, len(check.pictures)))
    width = columns * (WIDTH + MARGIN) + MARGIN
    head = _head(check, max(2, columns))
    below = LINE * max((len(picture.lines) for picture in check.pictures), default=0) + MARGIN
    rows = -(-len(check.pictures) // columns)
    width = max(width, 2 * (WIDTH + MARGIN) + MARGIN)
    height = rows * (HEIGHT + below) + LINE * len(head) + 2 * MARGIN
    canvas = np.full((height, width, 4), BACKGROUND, np.float32)
    canvas[..., 3] = 1
    labels = [(text, MARGIN, height - LINE * (n + 1) - MARGIN // 2) for n, text in enumerate(head)]
    for number, picture in enumerate(check.pictures):
        row, column = divmod(number, columns)
        x, y = MARGIN + column * (WIDTH + MARGIN), (rows - 1 - row) * (HEIGHT + below) + below
        canvas[y:y + HEIGHT, x:x + WIDTH, :3] = picture.pixels / np.float32(255)
        labels += [(text, x, y - LINE * (n + 1) + 4) for n, text in enumerate(picture.lines)]
    save_png(folder / "tiles.png", canvas)
    write_labels(folder / "tiles.png", folder / "labelled.png", labels)
    return folder / "labelled.png"


def _head(check: ShootCheck, columns: int) -> list[str]:
    """Summary, what is wrong, legend."""
    letters = int(columns * (WIDTH + MARGIN) / LETTER)
    wrong = [f"- {finding}" for finding in check.findings] or ["the checked views show no problem"]
    return [line for text in (check.summary, *wrong, LEGEND) for line in textwrap.wrap(text, letters)]
