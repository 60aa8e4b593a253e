"""The ball of tests/support/make_scenes.py: what it is painted with, and how the files of its maps are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio

BASE, ROUGH = (0.6, 0.3, 0.1), 0.45  # as in tests/support/make_scenes.py
ROLES = ("basecolor", "roughness", "confidence", "error", "filled", "roughness_sigma", "basecolor_sigma")


def read(path: Path) -> np.ndarray:
    """(h, w, channels) float32, row 0 at the top."""
    buffer = oiio.ImageBuf(str(path))
    assert not buffer.has_error, buffer.geterror()
    return np.asarray(buffer.get_pixels(oiio.FLOAT)).reshape(buffer.spec().height, buffer.spec().width, -1)
