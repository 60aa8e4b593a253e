"""Environment pictures in: linear radiance from all directions, reduced, whatever the size of the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..data import F32, F64
from ..errors import BadInput
from ..phrases import percent
from ..resampling import bilinear
from ..shading.environment import texel_directions
from .clipped_lights import BrightestPixels
from .colour import known_space, to_linear_rec709
from .image_file import floats, open_image

WIDTH = 1024  # pixels: larger pictures are reduced
MOST_BROKEN = 0.01  # share of pixels that may be NaN or infinite
SQUARE = 0.02  # relative difference of aspects


def read_environment_image(path: Path, colorspace: str | None, of_world: bool = True) -> tuple[F32, list[str]]:
    """((h, w, 3) linear Rec.709, row 0 at the bottom, at most WIDTH columns; warnings).

    Pixels that are NaN, infinite or negative count as black.  Raises BadInput for a file that cannot be read, for a
    colour space that is not known, and where more than a hundredth is NaN or infinite.  ``of_world``: not of a mesh
    that glows, which may be evenly bright.
    """
    file = open_image(path)
    space = known_space(colorspace) if colorspace else None
    if colorspace and space is None:
        raise BadInput(f"{path}: {unknown_space(colorspace)}")
    if space is None:
        space = "sRGB" if file.integer else "Linear Rec.709"
    width, height = min(file.width, WIDTH), max(1, round(file.height * min(1.0, WIDTH / file.width)))
    columns = (np.arange(file.width) * width) // file.width
    starts = np.searchsorted(columns, np.arange(width))
    total, count = np.zeros((height, width, 3)), np.bincount(columns, minlength=width).astype(np.float64)
    lines = np.zeros(height)
    top = broken = negative = 0
    brightest = BrightestPixels()
    for rows in file.bands():
        with np.errstate(all="ignore"):
            rgb = to_linear_rec709(floats(rows[..., :3]), space)
        finite = np.isfinite(rgb).all(-1)
        broken += int((~finite).sum())
        negative += int((rgb[finite] < 0).any(-1).sum())
        rgb = np.where(finite[..., None], np.maximum(rgb, 0), np.float32(0)).astype(np.float64)
        brightest.add(rgb)
        at = (np.arange(top, top + len(rgb)) * height) // file.height
        np.add.at(total, at, np.add.reduceat(rgb, starts, 1))
        lines += np.bincount(at, minlength=height)
        top += len(rgb)
    pixels = file.width * file.height
    if broken > MOST_BROKEN * pixels:
        raise BadInput(f"{path}: {percent(broken / pixels)} of its pixels are NaN or infinite; render the environment "
                       "again")
    return (np.asarray((total / (lines[:, None] * count)[..., None])[::-1], np.float32),
            _warnings(path.name, file.bits, (broken, negative, pixels), brightest if of_world else None))


def _warnings(name: str, bits: int, counts: tuple[int, int, int], brightest: BrightestPixels | None) -> list[str]:
    broken, negative, pixels = counts
    found = []
    if broken:
        found.append(f"{name}: {broken} pixels are NaN or infinite; they are treated as black")
    if negative > 0.001 * pixels:
        found.append(f"{name}: {percent(negative / pixels, 1)} of its pixels are negative; they are treated as black")
    if bits <= 8:
        found.append(eight_bits(name))
    elif brightest is not None:
        found.extend(clipped_lights(name, brightest))
    return found


def unknown_space(name: str) -> str:
    """What to do about a colour space that is not known."""
    return f"colour space '{name}' is not known; name the picture's true space, or save it as Linear Rec.709"


def eight_bits(name: str) -> str:
    """The warning of a picture that clips lights."""
    return f"{name}: has 8 bits per channel, so lights in it are clipped; use an HDR or EXR file"


def clipped_lights(name: str, brightest: BrightestPixels) -> list[str]:
    """The warning of a picture of high range whose lights end below what they were."""
    pixels = brightest.clipped()
    return [f"{name}: {pixels} pixels have its highest value, {brightest.top:.4g}, so lights in it seem to be clipped; "
            "merge it again with darker exposures"] if pixels else []


def aspect_warning(name: str, picture: F32) -> list[str]:
    """Of an equirectangular picture that is not twice as wide as high."""
    height, width = picture.shape[:2]
    if abs(width / (2 * height) - 1) < max(SQUARE, 1.5 / height):
        return []
    return [f"{name}: is not twice as wide as high; IRPSO stretches it over all directions, as Blender does"]


def from_mirror_ball(picture: F32, height: int = 512) -> F32:
    """(height, 2 height, 3) equirectangular, of a picture of a mirror ball as Blender maps it.

    The ball is seen along +Y: a direction d shows at (d - Y) / (2 sqrt((1 - d.Y) / 2)) (Cycles,
    direction_to_mirrorball).
    """
    toward, _ = texel_directions(height, 2 * height)
    off = toward - np.array([0.0, 1.0, 0.0])
    length = 2 * np.sqrt(np.maximum(-0.5 * off[..., 1], 0))
    at = 0.5 * (np.where(length[..., None] > 0, off / np.maximum(length, 1e-12)[..., None], 0) + 1)
    return np.asarray(bilinear(picture, at[..., ::2].reshape(-1, 2)).reshape(*toward.shape[:2], 3), np.float32)


def seen_from(picture: F32, rotation: F64, height: int = 512) -> F64:
    """(height, 2 height, 3) of the world's own axes, of a picture turned by ``rotation`` (world to picture)."""
    toward, _ = texel_directions(height, 2 * height)
    d = toward @ rotation.T
    uv = np.stack([0.5 - np.arctan2(d[..., 1], d[..., 0]) / (2 * np.pi),
                   0.5 + np.arcsin(np.clip(d[..., 2], -1, 1)) / np.pi], -1)
    wrapped = np.concatenate([picture[:, -1:], picture, picture[:, :1]], 1)
    columns = picture.shape[1]
    uv[..., 0] = (uv[..., 0] * columns + 1) / (columns + 2)
    return np.asarray(bilinear(wrapped, uv.reshape(-1, 2)).reshape(*toward.shape[:2], 3), np.float64)
