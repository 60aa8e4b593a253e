"""The lens and the axes of a picture as it is read, from those that a project gives it.

Pictures are read upright, as their orientation tag (EXIF) says, and RAW files whole.  Photogrammetry programs may have
read them as they are stored, and may have used what the camera developed of the RAW file, a few pixels smaller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..data import F64
from ..errors import BadInput
from ..images.image_file import ImageFile
from ..images.mask import ASPECT
from ..images.raw_reader import is_raw
from ..lens import Lens
from .project import ProjectCamera

BORDER = 0.03  # share of a sensor's side that the developed picture may lack
BLOCKS = (2, 3)  # samples along a side of a RAW file's pixel: Bayer, X-Trans
# Upright x, y (x right, y down) of stored x, y, by EXIF's orientation.  Mirrored ones (2, 4, 5, 7) are no photograph's.
UPRIGHT = {1: ((1, 0), (0, 1)), 3: ((-1, 0), (0, -1)), 6: ((0, -1), (1, 0)), 8: ((0, 1), (-1, 0))}


@dataclass(frozen=True)
class PictureCamera:
    """A camera of the project as its picture is read."""

    name: str
    lens: Lens
    world_from_camera: F64  # (4, 4) as of ProjectCamera, upright
    upright_from_body: F64  # (2, 2) turns right and down of the camera's body into the picture's
    turned: bool = False  # the project had the picture as it is stored
    cropped: bool = False  # the project had less of it than the RAW file holds


def read_as_stored(camera: ProjectCamera, file: ImageFile) -> bool | None:
    """Whether the project's program left the orientation tag alone; None: the picture does not tell.

    Raises BadInput where the picture's aspect is not the lens's, turned or not.
    """
    upright, stored = (_fits(camera.lens, *size) for size in (
        (file.width, file.height), (file.height, file.width) if file.orientation >= 5 else (file.width, file.height)))
    if not upright and not (stored and file.orientation in UPRIGHT):
        raise BadInput(f"{file.path}: is {file.width} x {file.height} pixels, but the project's camera '{camera.name}' "
                       f"is {camera.lens.width} x {camera.lens.height}; choose the pictures that the project was made "
                       "from")
    return None if upright == stored else stored


def picture_camera(camera: ProjectCamera, file: ImageFile, as_stored: bool) -> PictureCamera:
    """``camera`` for its picture.  ``as_stored``: the project's program left the orientation tag alone."""
    turn = np.array(UPRIGHT.get(file.orientation, UPRIGHT[1]), np.float64)
    size = (file.height, file.width) if as_stored and file.orientation >= 5 else (file.width, file.height)
    lens = _whole(camera.lens, *size) if is_raw(file.path) else camera.lens
    cropped = lens is not camera.lens
    if not as_stored or file.orientation == 1 or file.orientation not in UPRIGHT:
        return PictureCamera(camera.name, lens, camera.world_from_camera, turn, cropped=cropped)
    lens, axes = turned_lens(lens, turn)
    pose = camera.world_from_camera.copy()
    pose[:3, :2] = pose[:3, :2] @ axes.T
    return PictureCamera(camera.name, lens, pose, axes, True, cropped)


def turned_lens(lens: Lens, turn: F64) -> tuple[Lens, F64]:
    """The lens of its pictures turned by ``turn``, and the rotation (2, 2) of camera axes x, y that belongs to it.

    With pixels K x + c of distorted x, the turned ones are A K R^T (R x) + c'.  R is that which makes A K R^T upper
    triangular; it is ``turn`` itself where there is no skew.  A rotation of the axes leaves the radial terms alone and
    turns (p2, p1) along, because the tangential terms are t r^2 + 2 (t x) x with t = (p2, p1).
    """
    matrix = turn @ np.array([[lens.fx, lens.skew], [0.0, lens.fy]])
    lower = matrix[1] / math.hypot(*matrix[1])  # the second row of R
    axes = np.array([[lower[1], -lower[0]], lower])
    k = matrix @ axes.T
    middle = np.array([lens.width, lens.height]) / 2
    size = np.abs(turn @ (lens.width, lens.height))
    centre = turn @ (np.array([lens.cx, lens.cy]) - middle) + size / 2
    p2, p1 = axes @ (lens.tangential[1], lens.tangential[0])
    return replace(
        lens, width=round(size[0]), height=round(size[1]), fx=float(k[0, 0]), fy=float(k[1, 1]), skew=float(k[0, 1]),
        cx=float(centre[0]), cy=float(centre[1]), tangential=(float(p1), float(p2))), axes


def _fits(lens: Lens, width: int, height: int) -> bool:
    return abs(width / height / (lens.width / lens.height) - 1) <= ASPECT


def _whole(lens: Lens, width: int, height: int) -> Lens:
    """The lens for all of a RAW file of ``width`` x ``height`` pixels, of which the project's pictures are the middle.

    Where the file's samples are as many as the project's pixels, or a border more: a developed picture of a camera is
    not scaled.
    """
    for block in BLOCKS:
        wide, high = width * block, height * block
        if all(0 <= more <= BORDER * side + block for more, side in (
                (wide - lens.width, lens.width), (high - lens.height, lens.height))) and (
                wide - lens.width >= block or high - lens.height >= block):
            return lens.part((lens.width - wide) / 2, (lens.height - high) / 2, wide, high)
    return lens
