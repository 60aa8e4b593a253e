"""The ball of tests/support/make_scenes.py: what it is painted with, and how the files of its maps are read."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

BASE, ROUGH = (0.6, 0.3, 0.1), 0.45  # as in tests/support/make_scenes.py
ROLES = ("basecolor", "roughness", "confidence", "error", "filled", "roughness_sigma", "basecolor_sigma")
FILES = {*(f"Ball_{role}.exr" for role in ROLES), "report.json", "scene_irpso.blend"}  # of a solve by the command line


def read(path: Path) -> np.ndarray:
    """(h, w, channels) float32, row 0 at the top."""
    buffer = oiio.ImageBuf(str(path))
    assert not buffer.has_error, buffer.geterror()
    return np.asarray(buffer.get_pixels(oiio.FLOAT)).reshape(buffer.spec().height, buffer.spec().width, -1)


def fingerprint(folder: Path) -> dict[str, str]:
    """Every file below a folder, by its content."""
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
            for p in sorted(folder.rglob("*")) if p.is_file()}
