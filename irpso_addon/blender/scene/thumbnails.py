"""What the panels show of files: looked at in a thread, drawn from memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypeVar

import bpy
import bpy.utils.previews  # Blender does not import it by itself
import numpy as np

from ...core.capture.file_preview import (
    MISSING,
    SIDE,
    CapturesPreview,
    ImagePreview,
    Watcher,
    preview_captures,
    preview_image,
    same_file,
)
from ...core.data import F32
from ...core.images.colour import known_space, linear_to_srgb, to_linear_rec709
from ..panel_common import redraw_sidebars

POLL = 0.2  # seconds between two looks whether the thread has found something
MOST = 2000  # previews kept at a time

_images = Watcher(preview_image, ImagePreview(problem=MISSING))
_captures = Watcher(preview_captures, CapturesPreview(problem=MISSING))
Known = TypeVar("Known")


@dataclass
class _Shown:
    """What Blender shows of it."""

    previews: Any = None  # Blender's collection, where there is one
    stamps: dict[str, Any] = field(default_factory=dict)  # key of a preview -> stamp of the file that it shows
    changes: int = 0  # of the watchers, that the sidebars show


_shown = _Shown()


def image(path: str) -> ImagePreview | None:
    """What is known of the image at an absolute path; None: nothing yet, and a redraw follows when there is."""
    return _asked(_images.of(same_file(path)))


def captures(path: str) -> CapturesPreview | None:
    """What is known of the capture file at an absolute path, likewise."""
    return _asked(_captures.of(same_file(path)))


def _asked(found: Known) -> Known:
    if not (bpy.app.background or bpy.app.timers.is_registered(_poll)) and (_images.busy or _captures.busy):
        bpy.app.timers.register(_poll, first_interval=POLL)
    return found


def icon(path: str, exposure: float, colorspace: str) -> int:
    """Icon of a picture, 0 where there is none yet; ``exposure`` in EV is taken out, ``colorspace`` as a view says."""
    found = image(path)
    if found is None or found.thumbnail is None or bpy.app.background:
        return 0
    if _shown.previews is None:
        _shown.previews = bpy.utils.previews.new()
    elif len(_shown.previews) > MOST:
        _shown.previews.clear()
        _shown.stamps.clear()
    space = known_space(colorspace) or found.colorspace or ("sRGB" if found.integer else "Linear Rec.709")
    key = f"{same_file(path)} {exposure:.1f} {space}"
    preview = _shown.previews[key] if key in _shown.previews else _shown.previews.new(key)
    if _shown.stamps.get(key) != found.stamp:
        pixels = _developed(found.thumbnail, exposure, space)
        for size, target in (("icon_size", "icon_pixels"), ("image_size", "image_pixels")):
            setattr(preview, size, (SIDE, SIDE))
            getattr(preview, target).foreach_set(pixels)
        _shown.stamps[key] = found.stamp
    return int(preview.icon_id)


def _developed(thumbnail: F32, exposure: float, space: str) -> Any:
    """(SIDE * SIDE) int32 RGBA, the picture in the middle of nothing."""
    alpha = thumbnail[..., 3:].clip(0, 1)
    straight = np.divide(thumbnail[..., :3], alpha, out=np.zeros_like(thumbnail[..., :3]), where=alpha > 0)
    rgb = linear_to_srgb(to_linear_rec709(straight, space) * np.float32(2.0**-exposure)).clip(0, 1)
    (h, w), square = thumbnail.shape[:2], np.zeros((SIDE, SIDE, 4), np.uint8)
    y, x = (SIDE - h) // 2, (SIDE - w) // 2
    square[y:y + h, x:x + w] = np.round(np.concatenate([rgb, alpha], 2) * 255)
    return square.view(np.int32).ravel()


def _poll() -> float | None:
    """Timer: shows what the thread has found, until it has no more to look at."""
    changes = _images.changes + _captures.changes
    if changes != _shown.changes:
        _shown.changes = changes
        redraw_sidebars()
    return POLL if _images.busy or _captures.busy else None


def release() -> None:
    """Ends the thread and frees the icons."""
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)
    _images.stop()
    _captures.stop()
    _shown.stamps.clear()
    if _shown.previews is not None:
        bpy.utils.previews.remove(_shown.previews)
        _shown.previews = None
