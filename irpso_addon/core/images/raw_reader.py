"""RAW and DNG files by LibRaw (rawpy): the sensor's numbers, black taken off, white 1.  Row 0 is the top here.

Binned, so that each pixel has samples of all colours, or as many pixels as samples, the other colours interpolated.
A DNG whose pixels have all colours already (LinearRaw; DNG 1.7, "PhotometricInterpretation") is read as it is: these
are the camera's own colours too, before any white balance.

It has the interface of oiio_reader.py and runs in the same processes.  LibRaw decodes; what follows is ours, because
LibRaw's own development cuts what lies below black to 0 and does not tell which of a pixel's samples were saturated.
What comes out is the camera's own red, green and blue: `CameraColour` leads to Rec.709.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data import F32, F64
from ..errors import BadInput
from .colour import D65, matrix_to_rec709
from .oiio_reader import BAND, MAX_SIDE, Stored, StoredPicture, check_file
from .shot_settings import iso_number, positive
from .tiff_tags import holds_floats

SUFFIXES = {
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq", ".kdc", ".mef", ".mos", ".mrw",
    ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
}
# Of the range from black to white: from there on a sample counts as saturated.  Sensors do not all end at one number,
# and bend shortly before it.
SATURATED = 0.99
# A file's own limit counts from here on: LibRaw has one white level for a camera, but many end earlier at some ISOs
# (full wells at the lowest one, scaled numbers at those between).  Lower limits are numbers of something else.
_LEAST_LIMIT = 0.5
# Of white, below black: no noise reaches that far, so the sample is dead.  It is left out as saturated ones are.
DEAD = 0.05
_EMBEDDED = 0.125  # least first element of a colour matrix that LibRaw has found in the file
# EXIF's orientation for each of LibRaw's "flip", whose bits are: 1 mirrors x, 2 mirrors y, 4 swaps them
_ORIENTATIONS = (1, 2, 4, 3, 5, 8, 6, 7)


def is_raw(path: Path) -> bool:
    """By its name: most RAW files are TIFF files too, with a small picture in them that other readers would take."""
    return path.suffix.lower() in SUFFIXES


def header(path: Path, full: bool = False) -> dict[str, Any]:
    """As oiio_reader.header, part 0; of the picture with a pixel for each sample if ``full``, part 1.

    Raises BadInput.
    """
    with _Raw(path) as raw:
        sensor = _sensor(path, raw)
        wb, warnings = _white_balance(path, raw)
        orientation = _ORIENTATIONS[raw.sizes.flip & 7]
        width, height = sensor.samples if full else sensor.size
        turned = (height, width) if orientation >= 5 else (width, height)
        return {
            "part": int(full), "channels": (0, 1, 2), "width": turned[0], "height": turned[1],
            "window": (0, 0, width, height), "form": "float", "bits": 16, "integer": False, "premultiplied": False,
            "colorspace": None, "warnings": warnings, "orientation": orientation, "shot": _shot(raw),
            "camera": {"white_balance": wb, "matrix": _matrix(path, raw).tolist()},
        }


def bands(path: Path, picture: StoredPicture, first: int, last: int, at_once: int = BAND) -> Iterator[Stored]:
    """As oiio_reader.bands: (rows, width, 3) floats, black 0 and white 1.

    Where any of a channel's samples is saturated or dead, the channel is 1 and more: 1 plus what is there at least.
    """
    with _Raw(path) as raw:
        sensor = _sensor(path, raw)
        full = picture.part == 1
        if (sensor.samples if full else sensor.size) != picture.size:
            raise BadInput(f"{path}: changed while it was read; try again")
        pixels = raw.raw_image_visible
        if sensor.demosaiced:
            rows = max(1, at_once // sensor.size[0])
            for top in range(first, last, rows):
                yield _finished(pixels[top:min(top + rows, last)], sensor)
            return
        if full:
            rows = max(1, at_once // sensor.samples[0])
            for top in range(first, last, rows):
                yield _interpolated(pixels, top, min(top + rows, last), sensor)
            return
        rows = sensor.phases * max(1, at_once // (sensor.size[0] * sensor.phases))
        for top in range(first - first % rows, last, rows):
            bottom = min(top + rows, sensor.size[1])
            block = _binned(pixels[top * sensor.block:bottom * sensor.block], sensor)
            yield np.ascontiguousarray(block[max(first - top, 0):last - top])


class _Raw:
    """An open file; what LibRaw finds wrong with it becomes a BadInput."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> Any:
        check_file(self.path)
        try:
            import rawpy
        except ImportError:
            raise BadInput(f"{self.path}: cannot be read (the library rawpy is missing); install the extension from "
                           "its zip, pip install rawpy, or develop the file to a 16-bit TIFF of linear light") from None
        self._raw: Any = rawpy.RawPy()
        try:
            self._raw.open_file(str(self.path))
            sizes = self._raw.sizes
            if max(sizes.raw_width, sizes.raw_height) > MAX_SIDE:
                raise BadInput(f"{self.path}: is {sizes.raw_width} x {sizes.raw_height} pixels; develop it to at most "
                               f"{MAX_SIDE} on a side")
            self._raw.unpack()
        except rawpy.LibRawFileUnsupportedError:
            version = ".".join(map(str, rawpy.libraw_version))
            raise BadInput(f"{self.path}: cannot be read (LibRaw {version} knows no camera that writes such files); "
                           "convert it to DNG, or to a 16-bit TIFF of linear light") from None
        except (rawpy.LibRawError, UnicodeError) as error:
            why = error.args[0] if error.args else error
            why = why.decode(errors="replace") if isinstance(why, bytes) else type(error).__name__
            raise BadInput(f"{self.path}: is damaged or cut short ({why}); copy it again from the camera") from None
        return self._raw

    def __exit__(self, *_: object) -> None:
        self._raw.close()


@dataclass(frozen=True)
class _Sensor:
    """How a sensor's samples become pixels."""

    size: tuple[int, int]  # width and height when binned
    block: int  # samples along a side of a pixel
    colours: NDArray[np.int64]  # (n, n) 0, 1, 2 of each sample of the pattern; (0, 0): each pixel has all three
    black: F64  # (n, n), or (3,)
    white: float  # above black
    saturated: float  # of white: from there on a sample counts as saturated

    @property
    def samples(self) -> tuple[int, int]:
        """Width and height of a picture with a pixel for each sample."""
        return self.size[0] * self.block, self.size[1] * self.block

    @property
    def demosaiced(self) -> bool:
        """Whether there is no pattern left."""
        return not self.colours.size

    @property
    def phases(self) -> int:
        """Pixels after which the pattern starts again."""
        return len(self.colours) // self.block


def _sensor(path: Path, raw: Any) -> _Sensor:
    """Of a Bayer sensor 2 x 2 samples make a pixel, of Fujifilm's X-Trans 3 x 3: each has all colours."""
    dng = path.suffix.lower() == ".dng"
    if dng and holds_floats(path):
        raise BadInput(f"{path}: is a DNG of floats, whose scale LibRaw does not keep; save it as a DNG of integers, "
                       "or as a TIFF of linear light")
    period = dimensions = 0
    try:
        dimensions = raw.raw_image.ndim
        period = len(raw.raw_pattern) if dimensions == 2 else 0
    except (NotImplementedError, RuntimeError):  # stranger patterns
        pass
    if dng and dimensions == 3 and raw.num_colors == 3 and raw.color_desc == b"RGBG":
        return _demosaiced(path, raw)
    block, top, left = {2: 2, 6: 3}.get(period, 0), raw.sizes.top_margin, raw.sizes.left_margin
    pattern = np.array([[raw.raw_color(top + y, left + x) for x in range(period)] for y in range(period)])
    names = raw.color_desc.decode("ascii", "replace")
    colours = np.array([["RGB".find(names[c]) for c in row] for row in pattern.tolist()])
    starts = range(0, period, block or 1)
    blocks = [set(colours[y:y + block, x:x + block].ravel().tolist()) for y in starts for x in starts]
    if not block or any(found != {0, 1, 2} for found in blocks):
        raise _no_pattern(path)
    levels = np.array(raw.black_level_per_channel, np.float64)
    height, width = (n // block for n in raw.raw_image_visible.shape)
    white = _white(path, raw, levels[np.unique(pattern)], min(width, height))
    return _Sensor((width, height), block, colours, levels[pattern], white, _saturated(raw, white))


def _demosaiced(path: Path, raw: Any) -> _Sensor:
    """Of a LinearRaw DNG.  Other files of three colours a pixel (Foveon, small RAW files) have colours of their own."""
    levels = np.array(raw.black_level_per_channel[:3], np.float64)
    height, width = raw.raw_image_visible.shape[:2]
    white = _white(path, raw, levels, min(width, height))
    return _Sensor((width, height), 1, np.zeros((0, 0), np.int64), levels, white, _saturated(raw, white))


def _white(path: Path, raw: Any, levels: F64, side: int) -> float:
    """Above black.  Raises BadInput."""
    white = float(raw.white_level) - float(levels.min())
    if white <= 0 or side < 1:
        raise BadInput(f"{path}: is damaged (its white level is not above black); copy it again from the camera")
    return white


def _saturated(raw: Any, white: float) -> float:
    """Of ``white``, above black: SATURATED, or where the file states that samples end or bend earlier."""
    stated = raw.camera_white_level_per_channel
    limit = (min(stated) - float(raw.white_level)) / white + 1 if stated else 1.0
    return min(SATURATED, limit) if limit >= _LEAST_LIMIT else SATURATED


def _no_pattern(path: Path) -> BadInput:
    return BadInput(f"{path}: is of a sensor without a Bayer or X-Trans pattern of red, green and blue, which is not "
                    "read; develop it to a 16-bit TIFF of linear light")


def _finished(pixels: NDArray[np.uint16], sensor: _Sensor) -> F32:
    """(rows, width, 3) of pixels that have all colours."""
    values = (pixels[..., :3] - sensor.black.astype(np.float32)) * np.float32(1 / sensor.white)
    return _marked(values, _lost(values, sensor), sensor)


def _lost(values: F32, sensor: _Sensor) -> NDArray[np.bool_]:
    return np.asarray((values >= np.float32(sensor.saturated)) | (values < np.float32(-DEAD)))


def _marked(values: F32, lost: NDArray[np.bool_], sensor: _Sensor) -> F32:
    """``values``, the ``lost`` ones as 1 plus what is there at least: a dead sample counts as little as it shows."""
    values[lost] = 1 + values[lost].clip(0, np.float32(sensor.saturated))
    return values


def _binned(samples: NDArray[np.uint16], sensor: _Sensor) -> F32:
    """(rows, width, 3) means of each colour's samples, from rows that begin with the pattern."""
    n, block, step = len(sensor.colours), sensor.block, sensor.phases
    height, width = len(samples) // block, sensor.size[0]
    samples = samples[:height * block, :width * block]
    out = np.zeros((height, width, 3), np.float32)
    full = np.zeros((height, width, 3), np.bool_)
    for y, x in np.ndindex(n, n):
        top, left, colour = y // block, x // block, sensor.colours[y, x]
        together = sensor.colours[top * block:(top + 1) * block, left * block:(left + 1) * block]
        part, black = samples[y::n, x::n], sensor.black[y, x]
        out[top::step, left::step, colour] += (part - np.float32(black)) * np.float32(
            1 / (sensor.white * np.count_nonzero(together == colour)))
        full[top::step, left::step, colour] |= (part >= black + sensor.saturated * sensor.white) | (
            part < black - DEAD * sensor.white)
    return _marked(out, full, sensor)


def _interpolated(pixels: NDArray[np.uint16], top: int, bottom: int, sensor: _Sensor) -> F32:
    """(rows, width, 3) of the rows ``top`` to ``bottom``: the pixel's own sample, and the others' weighted means.

    Of a Bayer sensor that is bilinear interpolation; weights fall linearly with the distance in rows and in columns.
    Beyond the edges lies what lies a period of the pattern farther in.
    """
    n, reach, (width, height) = len(sensor.colours), sensor.block - 1, sensor.samples
    rows, columns = np.arange(top - reach, bottom + reach), np.arange(-reach, width + reach)
    samples = pixels[_inside(rows, height, n)].take(_inside(columns, width, n), axis=1)
    values = np.empty(samples.shape, np.float32)
    for y, x in np.ndindex(n, n):
        part = samples[y::n, x::n] - np.float32(sensor.black[(top - reach + y) % n, (x - reach) % n])
        values[y::n, x::n] = part * np.float32(1 / sensor.white)
    lost = _lost(values, sensor)
    out = np.zeros((bottom - top, width, 3), np.float32)
    share = np.zeros((bottom - top, width, 3), np.float32)  # of what is lost
    for y, x in np.ndindex(n, n):
        for colour in range(3):
            for dy, dx, weight in _taps(sensor, (top + y) % n, x, colour):
                at = slice(reach + y + dy, reach + dy + bottom - top, n), slice(reach + x + dx, reach + dx + width, n)
                out[y::n, x::n, colour] += values[at] * np.float32(weight)
                share[y::n, x::n, colour] += lost[at] * np.float32(weight)
    out[(share > 0) & (share < 0.99)] = 0.0  # an edge of a highlight: its colours are of different places
    return _marked(out, share > 0, sensor)


def _inside(numbers: NDArray[np.int64], count: int, period: int) -> NDArray[np.int64]:
    """Numbers of rows or columns, those beyond the edges replaced by others of their colours."""
    return np.where(numbers < 0, numbers + period, np.where(numbers >= count, numbers - period, numbers))


def _taps(sensor: _Sensor, y: int, x: int, colour: int) -> list[tuple[int, int, float]]:
    """Samples that tell a colour at a place of the pattern: how far away in rows and columns, and their weights."""
    n, reach = len(sensor.colours), sensor.block - 1
    if sensor.colours[y, x] == colour:
        return [(0, 0, 1.0)]
    steps = range(-reach, reach + 1)
    found = [(dy, dx, float((reach + 1 - abs(dy)) * (reach + 1 - abs(dx)))) for dy in steps for dx in steps
             if sensor.colours[(y + dy) % n, (x + dx) % n] == colour]
    total = sum(weight for _, _, weight in found)
    return [(dy, dx, weight / total) for dy, dx, weight in found]


def _white_balance(path: Path, raw: Any) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    """Factors of red, green and blue as shot, green 1; else those of daylight, with a warning."""
    daylight = (f"{path.name}: has no white balance; daylight is used",)
    for factors, warnings in ((raw.camera_whitebalance, ()), (raw.daylight_whitebalance, daylight)):
        red, green, blue = (positive(float(value)) for value in factors[:3])
        if red and green and blue:
            return (red / green, 1.0, blue / green), warnings
    raise _no_colours(path)


def _matrix(path: Path, raw: Any) -> F64:
    """(3, 3): balanced camera colours to linear Rec.709; white stays white.

    The file's own as LibRaw has found it (of a DNG: from its ColorMatrix), else by LibRaw's table of cameras.
    """
    embedded = np.asarray(raw.color_matrix[:, :3], np.float64)
    if embedded[0, 0] > _EMBEDDED:
        matrix = embedded
    else:
        from_rec709 = np.asarray(raw.rgb_xyz_matrix[:3], np.float64) @ np.linalg.inv(matrix_to_rec709("xyz", D65))
        white = from_rec709.sum(1, keepdims=True)
        if not (white > 0).all() or not abs(np.linalg.det(from_rec709 / white)) > 1e-6:
            raise _no_colours(path)
        matrix = np.linalg.inv(from_rec709 / white)
    if not np.isfinite(matrix).all():
        raise _no_colours(path)
    return matrix


def _no_colours(path: Path) -> BadInput:
    return BadInput(f"{path}: LibRaw does not know the colours of its camera; convert it to DNG with Adobe's "
                    "converter, or develop it to a 16-bit TIFF of linear light")


def _shot(raw: Any) -> dict[str, Any]:
    """The fields of ShotSettings."""
    try:
        other = raw.other
    except (ValueError, OverflowError, OSError):  # a date that is none
        return {}
    return {"time": positive(other.shutter_speed), "f_number": positive(other.aperture),
            "iso": iso_number(other.iso_speed)}
