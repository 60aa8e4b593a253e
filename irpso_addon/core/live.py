"""What a running solve shows of itself: the maps so far, and pictures of the views beside what the maps predict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .data import F32

F16 = NDArray[np.float16]
ROLES = ("base_color", "roughness", "confidence", "error")  # of maps, as blender/material.py names them


@dataclass(frozen=True)
class ViewPicture:
    """A view's reference and what the maps predict, in the part of the picture that shows the object; row 0 bottom.

    Both are radiance over ``scale``; pixels that the model says nothing of are NaN.
    """

    view: str  # file name of the reference
    camera: str
    lights: tuple[str, ...]
    reference: F16  # (h, w, 3)
    predicted: F16  # (h, w, 3)
    scale: float  # W/(m^2 sr) of the value 1


@dataclass(frozen=True)
class Live:
    """One look at a running solve."""

    seconds: float  # since it began
    error: float  # relative difference between pictures and prediction, RMS over texels; NaN: not known yet
    stage: str  # as Progress.stage, or "preview"
    maps: Mapping[str, F32]  # some of ROLES -> (n, n, 3) linear or (n, n); row 0 bottom; n may differ between looks
    pictures: tuple[ViewPicture, ...] = ()
    known: Mapping[str, float] = field(default_factory=dict)  # role -> share of the covered texels that is solved
