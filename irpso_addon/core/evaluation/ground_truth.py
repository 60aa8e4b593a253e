"""Maps with known truth, from files such as `irpso solve` and `irpso demo` write."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..data import F32, F64
from ..errors import BadInput
from ..images.colour import known_space, to_linear_rec709
from ..images.image_file import open_image
from ..maps.export import KINDS, safe_stem
from ..phrases import percent
from ..resampling import at_size


def read_truth(folder: Path, name: str) -> tuple[F64, F64]:
    """(base colour (n, n, 3) linear, roughness (n, n)) of object ``name``, n the larger width of the two.

    Reads ``<name>_basecolor`` and ``<name>_roughness`` (.exr, .png or .tiff), as they are exported: sRGB base colour in
    integer files.  Raises BadInput.
    """
    base, rough = (_read(folder, f"{safe_stem(name)}_{role}", color=role == "basecolor")
                   for role in ("basecolor", "roughness"))
    size = max(base.shape[1], rough.shape[1])
    return at_size(base, size), at_size(rough, size)[..., 0]


def _read(folder: Path, stem: str, *, color: bool) -> F32:
    """(h, w, 3), row 0 at the bottom."""
    for kind in KINDS:
        path = folder / f"{stem}.{kind}"
        if os.path.isfile(path):
            break
    else:
        raise BadInput(f"{folder}: has no {stem}.exr (nor .png, .tiff); give the folder of the true maps")
    file = open_image(path)
    values = file.read(0, file.height)[..., :3]
    unusable = float(np.mean(~np.isfinite(values)))
    if unusable > 0:
        raise BadInput(f"{path}: {percent(unusable, 2)} of its values are not numbers; replace them, or save the map "
                       "again")
    if color and file.integer:
        space = known_space(file.colorspace) if file.colorspace else None
        values = to_linear_rec709(values, space or "sRGB")
    return np.ascontiguousarray(values[::-1], np.float32)
