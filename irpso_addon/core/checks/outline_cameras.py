"""The outlines of an object in each camera's pictures, and what they say of cameras together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..check_records import CERTAIN, LEAST_SHIFT
from ..data import F32, Camera, View
from ..projection import lens_for
from .outline_fit import BEND, Optics, Outline, silhouette

ALIKE = 0.05  # relative: focal lengths of cameras that have one lens


def optics_of(camera: Camera, corner: tuple[int, int], image: tuple[int, int]) -> Optics | None:
    """In the pixels of a part of its pictures, whose first is at ``corner``; ``image``: their width and height.

    None where a bend would not be one of k1's, or a lens with more terms was measured.
    """
    lens = camera.lens
    if camera.orthographic or (lens is not None and (lens.fisheye or any(lens.radial[1:]) or any(lens.tangential))):
        return None
    lens = lens_for(camera, image)
    return Optics((lens.cx - corner[0], image[1] - lens.cy - corner[1]), lens.fx)


@dataclass(frozen=True)
class OutlinedCamera:
    """One camera's V views, in a part of its pictures."""

    views: list[View]
    corner: tuple[int, int]  # x, y of the part's first pixel
    image: tuple[int, int]  # width and height of the pictures
    outlines: list[Outline | None]  # of each view; None: no outline can be seen

    @property
    def optics(self) -> Optics | None:
        """As of `optics_of`."""
        return optics_of(self.views[0].camera, self.corner, self.image)

    def bend(self) -> tuple[float, float] | None:
        """What its lens's k1 lacks, and its standard error; None: no outline shows it."""
        drawn = [o for o in self.outlines if o is not None and o.optics is not None]
        if not drawn:
            return None
        return (float(np.mean([o.values[BEND] for o in drawn])),
                float(np.mean([o.covariance[BEND, BEND] for o in drawn])) ** 0.5)


class Silhouettes:
    """The outlines of a camera's views, one by one; those with one coverage are looked at once."""

    def __init__(self, drawn: F32, corner: tuple[int, int], image: tuple[int, int]) -> None:
        self._drawn, self._place = drawn, (corner, image)  # (h, w) 0..1: what share of each pixel the object covers
        self._coverage: F32 | None = None
        self._outline: Outline | None = None

    def of(self, camera: Camera, coverage: F32) -> Outline | None:
        """That of a picture with this coverage (h, w), 0..1; None where none can be seen."""
        if self._coverage is None or not np.array_equal(self._coverage, coverage):
            self._coverage = coverage
            self._outline = silhouette(self._drawn, coverage, optics_of(camera, *self._place))
        return self._outline


def of_one_shape(outlines: list[Outline], value: int) -> tuple[float, float]:
    """One of several outlines' values, and its standard error: they are of one shape, so errors do not average out."""
    if not outlines:
        return 0.0, 0.0
    return (float(np.mean([o.values[value] for o in outlines])),
            float(np.mean([o.covariance[value, value] for o in outlines])) ** 0.5)


def bends(cameras: Sequence[OutlinedCamera]) -> list[tuple[float, float]]:
    """What each camera's k1 lacks, and its standard error; 0 unless it is beyond doubt, and worth mending.

    Cameras with one focal length and one size of pictures are taken to have one lens.
    """
    found = [(0.0, 0.0)] * len(cameras)
    left = {n: optics for n, camera in enumerate(cameras) if (optics := camera.optics) is not None}
    while left:
        first = min(left)
        size, focal = cameras[first].image, left[first].focal
        alike = [n for n, optics in left.items()
                 if cameras[n].image == size and abs(np.log(optics.focal / focal)) < ALIKE]
        left = {n: optics for n, optics in left.items() if n not in alike}
        each = np.array([bend for n in alike if (bend := cameras[n].bend()) is not None])
        if not len(each):
            continue
        weights = 1 / np.maximum(each[:, 1], 1e-9) ** 2
        lacks, error = float(weights @ each[:, 0] / weights.sum()), float(weights.sum() ** -0.5)
        corner = 0.5 * float(np.hypot(*size))
        beyond = abs(lacks) > max(LEAST_SHIFT / (corner * (corner / focal) ** 2), CERTAIN * error)
        for n in alike:
            found[n] = lacks if beyond else 0.0, error
    return found
