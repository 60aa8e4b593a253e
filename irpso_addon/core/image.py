"""Reference images in, maps out, by OpenImageIO.  Files have row 0 at the top, memory at the bottom: turned here."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .colour import known_space, linear_to_srgb, to_linear_rec709
from .data import F32, F64, Bool, RadianceImage, View
from .errors import BadInput
from .image_file import ImageFile, open_image

_STRIP = 16_000_000  # pixels read at a time: 256 MB as RGBA float
_ASPECT = 0.01  # greatest relative difference of aspects
# Negative values up to this share of the image's level (its 99.5 % point) are read noise: five sigma of
# a bad sensor.  They become 0: left out instead, only the upper half of the noise would stay.
_NOISE = 0.01
_HALF_MAX = 65504.0


def read_reference(view: View, max_pixels: int | None = None) -> RadianceImage:
    """Radiance of ``view.image``: linear Rec.709, divided by 2^exposure and gain, alpha divided out.

    With ``max_pixels`` a larger image is reduced by area averages to at most about that many; a reduced
    pixel is valid only if all under it are.  Raises BadInput (one line, naming the file) for a file that
    is missing, damaged, too large, of another aspect than the camera's, that holds NaN, infinite or
    negative radiance where it is covered, or in which nothing can be used.
    """
    file = open_image(view.image)
    aspect = file.width / file.height
    if abs(aspect / view.camera.aspect - 1) > _ASPECT:
        raise BadInput(f"{view.image}: is {file.width} x {file.height} pixels (aspect {aspect:.3f}), but camera "
                       f"'{view.camera.name}' has aspect {view.camera.aspect:.3f}; give the scene's render resolution "
                       "the aspect of the images")
    space, warnings = _space(view, file)
    mask = None if view.mask is None else _read_mask(view.mask, file)
    rows = _Rows(file, mask)
    survey = _survey(rows)
    warnings += file.warnings
    if file.bits <= 8:
        warnings += (f"{view.image.name}: has 8 bits a channel; use EXR or 16 bits for exact maps",)
    scale = 1.0 / (2.0**view.exposure * view.gain)
    shrink = 1.0 if max_pixels is None else max(1.0, (file.width * file.height / max_pixels) ** 0.5)
    width, height = max(1, int(file.width / shrink)), max(1, int(file.height / shrink))
    rgb = np.empty((height, width, 3), np.float32)
    coverage = np.empty((height, width), np.float32)
    valid = np.empty((height, width), np.bool_)
    for out, top, bottom in _bands(file.height, height, file.width):
        pixels = _develop(*rows.read(top, bottom), survey, space, scale)
        if shrink > 1.0:
            edges = np.linspace(0, file.height, height + 1)[out.start:out.stop + 1] - top
            pixels = _reduce(pixels, edges, np.linspace(0, file.width, width + 1))
        rgb[out], coverage[out], valid[out] = pixels
    if not np.any(valid & (coverage > 0)):
        raise BadInput(f"{view.image}: every pixel is clipped; expose less")
    return RadianceImage(rgb=rgb[::-1].copy(), coverage=coverage[::-1].copy(), valid=valid[::-1].copy(),
                         warnings=warnings, clipped_share=survey.clipped)


def _space(view: View, file: ImageFile) -> tuple[str, tuple[str, ...]]:
    """The colour space of the file's values: as the view says, as the file says, or by its type."""
    if view.colorspace is not None:
        space = known_space(view.colorspace)
        if space is None:
            raise BadInput(f"{view.image}: colour space '{view.colorspace}' is not one of linear light; "
                           "save the image as Linear Rec.709, or name its true space")
        return space, ()
    if file.colorspace is not None and (space := known_space(file.colorspace)) is not None:
        return space, ()
    default = "sRGB" if file.integer else "Linear Rec.709"
    if file.colorspace is not None:
        return default, (f"{view.image.name}: says its colour space is '{file.colorspace}', which is not known; "
                         f"read as {default}",)
    return default, ()


def _read_mask(path: Path, image: ImageFile) -> F32:
    """(height, width) of ``image``, 0..1, row 0 at the top: the mask's grey value times its alpha."""
    import OpenImageIO

    file = open_image(path)
    if abs(file.width / file.height * image.height / image.width - 1) > _ASPECT:
        raise BadInput(f"{path}: mask is {file.width} x {file.height} pixels, its image {image.width} x "
                       f"{image.height}; give it the same aspect")
    pixels = file.read(0, file.height)
    mask = pixels[..., :3].mean(-1)
    if pixels.shape[-1] == 4:
        mask = mask * pixels[..., 3] if not file.premultiplied else mask
    if not np.isfinite(mask).all():
        raise BadInput(f"{path}: mask holds NaN or infinite pixels; save it again")
    if mask.shape != (image.height, image.width):
        small = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(file.width, file.height, 1, "float"))
        small.set_pixels(OpenImageIO.ROI(), np.ascontiguousarray(mask[..., None], np.float32))
        roi = OpenImageIO.ROI(0, image.width, 0, image.height, 0, 1, 0, 1)
        sized = OpenImageIO.ImageBufAlgo.resize(small, filtername="triangle", roi=roi)
        mask = np.asarray(sized.get_pixels(OpenImageIO.FLOAT))
    return np.clip(mask.reshape(image.height, image.width), 0, 1).astype(np.float32)


def _bands(height: int, out_height: int, width: int) -> Iterator[tuple[slice, int, int]]:
    """Output rows with the input rows that lie under them, at most _STRIP pixels at a time."""
    step = max(1, int(_STRIP / width * out_height / height))
    edges = np.linspace(0, height, out_height + 1)
    for first in range(0, out_height, step):
        last = min(first + step, out_height)
        yield slice(first, last), int(np.floor(edges[first] + 1e-6)), int(np.ceil(edges[last] - 1e-6))


class _Rows:
    """Stored colours with alpha divided out, and coverage: alpha times mask.  Keeps what it read last."""

    def __init__(self, file: ImageFile, mask: F32 | None) -> None:
        self.file, self.mask = file, mask
        self._last: tuple[tuple[int, int], tuple[F32, F32]] | None = None

    def read(self, top: int, bottom: int) -> tuple[F32, F32]:
        """(rows, width, 3) and (rows, width) of rows ``top`` to ``bottom``, exclusive."""
        if self._last is None or self._last[0] != (top, bottom):
            self._last = None  # let go of it before the next is read
            self._last = (top, bottom), self._read(top, bottom)
        return self._last[1]

    def _read(self, top: int, bottom: int) -> tuple[F32, F32]:
        pixels = self.file.read(top, bottom)
        rgb = pixels[..., :3]
        coverage = np.ones(rgb.shape[:2], np.float32) if self.mask is None else self.mask[top:bottom]
        if pixels.shape[-1] == 4:
            alpha = pixels[..., 3]
            if not np.isfinite(alpha).all():
                raise BadInput(f"{self.file.path}: its alpha holds NaN or is infinite; render it again")
            alpha = np.clip(alpha, 0, 1)
            coverage = coverage * alpha
            if self.file.premultiplied:
                with np.errstate(invalid="ignore", over="ignore"):  # the survey finds what is infinite
                    rgb = rgb * np.divide(1, alpha, out=np.zeros_like(alpha), where=alpha > 1e-6)[..., None]
        return rgb, coverage


@dataclass(frozen=True)
class _Survey:
    """What one look at the whole image says."""

    ceiling: F64  # (3,) stored values from which on a channel is clipped
    clipped: float  # share of covered pixels that are


def _survey(rows: _Rows) -> _Survey:
    """Finds what is not radiance and where the image clips.  Raises BadInput."""
    file = rows.file
    stride = max(1, file.width * file.height // 300_000)
    covered = odd = 0
    lowest, highest = np.inf, np.zeros(3)
    samples = []
    for _, top, bottom in _bands(file.height, file.height, file.width):
        rgb, coverage = rows.read(top, bottom)
        pixels = rgb[coverage > 0]
        covered += len(pixels)
        finite = _all_channels(np.isfinite(pixels))
        odd += int(np.sum(~finite))
        if finite.any():
            pixels = pixels if finite.all() else pixels[finite]
            lowest = min(lowest, float(pixels.min()))
            highest = np.maximum(highest, [pixels[:, c].max() for c in range(3)])
            samples.append(pixels[::stride])
    if not covered:
        raise BadInput(f"{file.path}: no pixel is covered (alpha or mask is 0 everywhere); check both")
    if odd:
        raise BadInput(f"{file.path}: {odd} of {covered} pixels are NaN or infinite; render it again or mask them out")
    sample = np.concatenate(samples)
    level = float(np.quantile(sample.max(-1), 0.995))
    if lowest < -_NOISE * max(level, 0.0):
        raise BadInput(f"{file.path}: holds negative radiance (down to {lowest:.3g}); render it again or mask it out")
    ceiling = np.ones(3) if file.integer else _plateaus(sample, highest)
    return _Survey(ceiling, float(np.mean((sample >= ceiling).any(-1))))


def _plateaus(sample: F32, highest: F64) -> F64:
    """(3,) value at which each channel of a float image was cut off, infinity where it was not.

    A cut leaves many pixels at exactly the highest value.  A flat surface under a flat light does so
    too; there other values are as common, or it is most of the picture.
    """
    ceiling = np.full(3, _HALF_MAX)
    for channel in range(3):
        values, counts = np.unique(sample[:, channel], return_counts=True)
        top = counts[-1] if values[-1] == highest[channel] > 0 else 0
        others = counts[:-1][values[:-1] > 0]
        if len(others) and 0.001 * len(sample) < top < 0.5 * len(sample) and top > 10 * others.max():
            ceiling[channel] = min(ceiling[channel], highest[channel])
    return ceiling


def _develop(rgb: F32, coverage: F32, survey: _Survey, space: str, scale: float) -> tuple[F32, F32, Bool]:
    """Stored colours to radiance; which pixels are valid."""
    valid = _all_channels(np.isfinite(rgb) & (rgb < survey.ceiling.astype(np.float32)))
    if not valid.all():
        rgb = np.where(valid[..., None], rgb, np.float32(0))
    with np.errstate(all="ignore"):
        radiance = np.maximum(to_linear_rec709(rgb, space), np.float32(0))
        radiance = radiance if scale == 1.0 else radiance * np.float32(scale)
        if not np.isfinite(radiance.sum()):  # beyond float32
            valid = valid & _all_channels(np.isfinite(radiance))
            radiance = np.where(valid[..., None], radiance, np.float32(0))
    return radiance, coverage, valid


def _all_channels(values: Bool) -> Bool:
    """``values.all(-1)`` of (..., 3), several times as fast."""
    return np.asarray(values[..., 0] & values[..., 1] & values[..., 2])


def _reduce(pixels: tuple[F32, F32, Bool], rows: F64, columns: F64) -> tuple[F32, F32, Bool]:
    """Area averages over the grid of cell edges ``rows`` x ``columns`` (in pixels, ascending)."""
    rgb, coverage, valid = pixels
    weighted = np.concatenate([rgb * coverage[..., None], coverage[..., None], ~valid[..., None]], -1)
    small = _cell_means(_cell_means(weighted, rows).swapaxes(0, 1), columns).swapaxes(0, 1)
    cover = small[..., 3]
    ok = small[..., 4] < 1e-6
    colour = np.where((ok & (cover > 0))[..., None], small[..., :3] / np.maximum(cover, 1e-12)[..., None], 0)
    return colour.astype(np.float32), cover.astype(np.float32), ok


def _cell_means(values: F32 | F64, edges: F64) -> F64:
    """Means over [edges[i], edges[i+1]) of piecewise constant ``values`` (n, ...), along the first axis."""
    whole = np.minimum(np.floor(edges + 1e-6).astype(int), len(values) - 1)
    part = (edges - whole).reshape(-1, *[1] * (values.ndim - 1))
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, 0, dtype=np.float64)])
    at = total[whole] + part * values[whole]
    return np.asarray(np.diff(at, axis=0) / np.diff(edges).reshape(-1, *[1] * (values.ndim - 1)))


def write_image(path: Path, array: F32, *, kind: str, color: bool) -> None:
    """Writes ``array`` (h, w, 3 or 1), row 0 at the bottom, whole or not at all.

    ``kind`` "exr": 32-bit float, ZIP, linear.  "png", "tiff": 16 bits, 0..1; with ``color`` encoded sRGB.
    Raises BadInput when the folder cannot be written or the disk is full; ``path`` is then as before.
    """
    import OpenImageIO

    pixels = array[::-1] if array.ndim == 3 else array[::-1, :, None]
    height, width, channels = pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, "float" if kind == "exr" else "uint16")
    spec.channelnames = ("R", "G", "B") if channels == 3 else ("Y",)
    spec.attribute("compression", "zip")
    spec.attribute("DateTime", "1970:01:01 00:00:00")  # else the time of writing: other bytes each time
    if kind != "exr":
        pixels = np.round((linear_to_srgb(pixels) if color else pixels).clip(0, 1) * 65535).astype(np.uint16)
        spec.attribute("oiio:ColorSpace", "sRGB" if color else "Raw")
    part = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        file = OpenImageIO.ImageOutput.create(str(part))
        if file is None:
            raise OSError(None, "its ending is no image format's")
        done = file.open(str(part), spec) and file.write_image(np.ascontiguousarray(pixels)) and file.close()
        if not done:
            raise OSError(None, (file.geterror() or "the disk may be full").strip().splitlines()[0])
        with part.open("rb") as handle:
            os.fsync(handle.fileno())
        open_image(part).read(0, height)  # not every format's writer notices that the disk is full
        os.replace(part, path)
    except (OSError, BadInput) as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        why = error.strerror if isinstance(error, OSError) else "the disk may be full"
        raise BadInput(f"{path}: cannot be written ({why}); check the folder and the free space") from None
