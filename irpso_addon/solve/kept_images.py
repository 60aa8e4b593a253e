"""Reference images of views: what tells two apart, and those that are kept for a second look."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace
from threading import Lock
from typing import Any

import numpy as np

from ..core.data import F32, RadianceImage, View
from ..core.images.response import as_read, straightened
from ..core.reporting.estimates import KEPT_BYTES
from ..core.vignetting import brightened

ReadImage = Callable[[View], RadianceImage]
# What a solve may find of a picture, as if nothing of it were so:
PLAIN: dict[str, Any] = {"gain": 1.0, "tint": (1.0, 1.0, 1.0), "response": 1.0, "shoulder": 1.0, "vignetting": 0.0,
                         "black_level": (0.0, 0.0, 0.0)}


def reference_key(view: View) -> Hashable:
    """All that the radiance of a view's reference image follows from: what differs in nothing of it is read once."""
    files = view.image, view.mask, view.ambient, view.flat
    dark = (view.vignetting, view.camera.name) if view.vignetting else ()
    shown = view.exposure, view.gain, view.tint, view.response, view.shoulder, view.black_level, view.white_balance
    return *files, view.colorspace, *shown, *dark


def _again(rgb: F32, first: View, view: View) -> F32:
    """Radiance of a view's picture, which was read as of ``first``, another opinion of the same view."""
    gain: F32 = (first.gain / view.gain * np.array(first.tint) / np.array(view.tint)).astype(np.float32)
    if (first.response, first.shoulder, first.black_level) == (view.response, view.shoulder, view.black_level):
        return np.asarray(brightened(rgb, view.camera, view.vignetting - first.vignetting) * gain)
    read = as_read(brightened(rgb, first.camera, -first.vignetting), first) * gain
    return brightened(straightened(read, view), view.camera, view.vignetting)


class KeptImages:
    """References as they were read, as many as KEPT_BYTES hold, for a second look under other exposures."""

    def __init__(self, read_image: ReadImage) -> None:
        self._read = read_image
        self._kept: dict[Hashable, tuple[View, RadianceImage]] = {}  # as it was first read
        self._lock, self._bytes = Lock(), 0

    def __call__(self, view: View) -> RadianceImage:
        """A view's radiance."""
        key = reference_key(replace(view, **PLAIN))
        kept = self._kept.get(key)
        if kept is not None:
            first, image = kept
            if all(getattr(first, name) == getattr(view, name) for name in PLAIN):
                return image
            return replace(image, rgb=_again(image.rgb, first, view))
        image = self._read(view)
        with self._lock:  # references are read ahead by threads
            self._bytes += image.rgb.nbytes + image.coverage.nbytes + image.valid.nbytes
            if self._bytes <= KEPT_BYTES:
                self._kept[key] = view, image
        return image
