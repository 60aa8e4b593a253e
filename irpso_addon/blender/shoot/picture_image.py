"""A view's picture as an image that the Image Editor shows, for the user to click in."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from ...core.data import F32
from ...core.evaluation.display import reduced
from ...core.images.colour import linear_to_srgb
from ...core.images.image_file import open_image
from ...core.images.reference_image import read_reference
from ..sample.contact_sheet import save_png
from .still_image import load_still, still_image
from .view_pictures import ListedView

NAME = "IRPSO Picture"
MOST = 4_000_000  # pixels; a larger picture is shown reduced
BRIGHT = 0.998  # of the pixels are shown darker than white: the highlights on chrome balls are not
BLENDED = 3  # pictures beside the first: each takes its time to be read
_FILE, _SIZE, _STAMP = "irpso_picture", "irpso_picture_size", "irpso_picture_stamp"  # custom properties of the image


def picture_image(shown: ListedView, others: Sequence[ListedView] = ()) -> bpy.types.Image:
    """The view's picture, upright, as bright as a screen can show it.  Raises BadInput.

    ``others`` of the same camera, lit by other lamps, are blended in, some of them: together they show an outline that
    one of them leaves in the dark.  What was made of the same files before is taken again.
    """
    rest = [view for view in others if view.view.image != shown.view.image]
    views = [shown, *rest[::max(1, -(-len(rest) // BLENDED))]]
    found, path, stamp = still_image(NAME), str(shown.view.image), " ".join(map(_stamp, views))
    if found is not None and shown_picture(found) is not None and found.get(_STAMP) == stamp:
        return found
    file = open_image(shown.view.image)
    total = _display(shown)
    for view in views[1:]:
        more = _display(view)
        if more.shape == total.shape:
            total = np.maximum(total, more)
    shown_as = linear_to_srgb(total)
    canvas = np.concatenate([shown_as, np.ones_like(shown_as[..., :1])], -1)
    with tempfile.TemporaryDirectory() as folder:
        save_png(Path(folder) / "picture.png", canvas)
        image = load_still(NAME, Path(folder) / "picture.png")
    image[_FILE], image[_SIZE], image[_STAMP] = path, [file.width, file.height], stamp
    return image


def _display(shown: ListedView) -> F32:
    """(h, w, 3) linear, 0 to 1, row 0 at the bottom.  Raises BadInput."""
    picture = read_reference(replace(shown.view, mask=None), MOST)
    bright = np.where(picture.valid[..., None], picture.rgb, np.inf)
    known = reduced(picture.rgb, 512).max(-1)
    return np.clip(bright / np.float32(max(np.quantile(known, BRIGHT), 1e-6)), 0, 1).astype(np.float32)


def shown_picture(image: bpy.types.Image | None) -> tuple[str, tuple[int, int]] | None:
    """The file that the image shows, and its width and height in pixels as it is read; None: it is no such image."""
    if image is None or not image.is_runtime_data or _FILE not in image:
        return None
    width, height = image[_SIZE]
    return image[_FILE], (width, height)


def _stamp(shown: ListedView) -> str:
    """What the picture is made of."""
    view = shown.view
    changed = view.image.stat().st_mtime_ns if view.image.exists() else 0
    return f"{view.image} {changed} {view.colorspace} {view.white_balance}"
