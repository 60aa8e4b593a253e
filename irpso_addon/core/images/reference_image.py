"""Reference images in, by OpenImageIO.  Files have row 0 at the top, memory at the bottom: turned here."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..data import F32, F64, Bool, RadianceImage, View
from ..errors import BadInput
from . import oiio_reader
from .colour import known_space, to_linear_rec709
from .image_file import ImageFile, floats, open_image
from .mask import Mask
from .oiio_reader import FORMS, Stored

KEEP = 128_000_000  # bytes of a decoded image that are held instead of being decoded again
_ASPECT = 0.01  # greatest relative difference of aspects
# Negative values up to this share of the image's level (its 99.5 % point) are read noise: five sigma of
# a bad sensor.  They become 0: left out instead, only the upper half of the noise would stay.
_NOISE = 0.01
_HALF_MAX = 65504.0

Pixels = tuple[F32, F32, Bool]  # radiance (rows, width, 3), coverage and validity (rows, width)


def read_reference(view: View, max_pixels: int | None = None) -> RadianceImage:
    """Radiance of ``view.image``: linear Rec.709, divided by 2^exposure and gain, alpha divided out.

    With ``max_pixels`` a larger image is reduced by area averages to at most about that many; a reduced
    pixel is valid only if all under it are.  Beside the result it takes about 250 MB, however large the image is.
    Raises BadInput (one line, naming the file) for a file that is missing, damaged, too large, of another aspect
    than the camera's, that holds NaN, infinite or negative radiance where it is covered, or in which nothing can
    be used.
    """
    reference = Reference(view)
    shrink = 1.0 if max_pixels is None else max(1.0, (reference.width * reference.height / max_pixels) ** 0.5)
    width, height = max(1, int(reference.width / shrink)), max(1, int(reference.height / shrink))
    rgb = np.empty((height, width, 3), np.float32)
    coverage = np.empty((height, width), np.float32)
    valid = np.empty((height, width), np.bool_)
    bottom = height
    for pixels in reference.bands() if shrink == 1.0 else _reduced(reference, width, height):
        rows = slice(bottom - len(pixels[0]), bottom)
        for out, values in zip((rgb, coverage, valid), pixels, strict=True):
            out[rows] = values[::-1]
        bottom = rows.start
    reference.check(bool(np.any(valid & (coverage > 0))))
    return RadianceImage(rgb=rgb, coverage=coverage, valid=valid, warnings=reference.warnings,
                         clipped_share=reference.clipped_share)


class Reference:
    """A view's reference image, surveyed; its pixels are developed band by band."""

    def __init__(self, view: View) -> None:
        """Raises BadInput as `read_reference`."""
        file = open_image(view.image)
        aspect = file.width / file.height
        if abs(aspect / view.camera.aspect - 1) > _ASPECT:
            raise BadInput(f"{view.image}: is {file.width} x {file.height} pixels (aspect {aspect:.3f}), but camera "
                           f"'{view.camera.name}' has aspect {view.camera.aspect:.3f}; give the scene's render "
                           "resolution the aspect of the images")
        self.width, self.height = file.width, file.height
        self._space, warnings = _space(view, file)
        self._rows = _Rows(file, None if view.mask is None else Mask(view.mask, file))
        self._survey = _survey(self._rows)
        self._scale = 1.0 / (2.0**view.exposure * view.gain)
        if file.bits <= 8:
            warnings += (f"{view.image.name}: has 8 bits a channel; use EXR or 16 bits for exact maps",)
        self.warnings: tuple[str, ...] = warnings + file.warnings
        self.clipped_share = self._survey.clipped

    def bands(self) -> Iterator[Pixels]:
        """Radiance (rows, width, 3), coverage and validity (rows, width), row 0 at the top.  Once only."""
        for rgb, coverage in self._rows.bands(last=True):
            yield _develop(rgb, coverage, self._survey, self._space, self._scale)

    def check(self, usable: bool) -> None:
        """Raises BadInput unless some pixel was ``usable``: covered and valid."""
        if not usable:
            raise BadInput(f"{self._rows.file.path}: every pixel is clipped; expose less")


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


def _reduced(reference: Reference, width: int, height: int) -> Iterator[Pixels]:
    """The reference's bands at another size, by area averages."""
    rows, columns = (np.linspace(0, n, m + 1) for n, m in ((reference.height, height), (reference.width, width)))
    step = max(1, int(oiio_reader.BAND / 4 / reference.width * height / reference.height))  # in double precision
    bands, held, top = reference.bands(), list[Pixels](), 0  # ``held``: rows from ``top`` on
    for first in range(0, height, step):
        edges = rows[first:first + step + 1]
        start, stop = int(np.floor(edges[0] + 1e-6)), int(np.ceil(edges[-1] - 1e-6))
        while top + sum(len(part[0]) for part in held) < stop:
            held.append(next(bands))
        together = _joined(held)
        yield reduce(_part(together, start - top, stop - top), edges - start, columns)
        top, held = stop - 1, [_part(together, stop - 1 - top, None)]  # the next may begin within a row


def _joined(parts: list[Pixels]) -> Pixels:
    rgb, coverage, valid = zip(*parts, strict=True)
    return np.concatenate(rgb), np.concatenate(coverage), np.concatenate(valid)


def _part(pixels: Pixels, first: int, last: int | None) -> Pixels:
    rgb, coverage, valid = pixels
    return rgb[first:last], coverage[first:last], valid[first:last]


class _Rows:
    """Stored colours with alpha divided out, and coverage: alpha times mask."""

    def __init__(self, file: ImageFile, mask: Mask | None) -> None:
        self.file, self.mask = file, mask
        size = file.width * file.height * len(file.channels) * np.dtype(FORMS[file.form]).itemsize
        self._keep = size <= KEEP  # then it is decoded once
        self._decoded: deque[Stored] = deque()

    def bands(self, last: bool = False) -> Iterator[tuple[F32, F32]]:
        """(rows, width, 3) and (rows, width) from the top down; ``last``: nobody will ask again."""
        masks = None if self.mask is None else self.mask.rows()
        for band in self._stored(last):
            coverage = np.ones(band.shape[:2], np.float32) if masks is None else masks.take(len(band))
            yield self._straight(floats(band), coverage)

    def _stored(self, last: bool) -> Iterator[Stored]:
        if self._decoded:
            for _ in range(len(self._decoded)):
                band = self._decoded.popleft()
                yield band
                if not last:
                    self._decoded.append(band)
            return
        for band in self.file.bands():
            if self._keep and not last:
                self._decoded.append(band)
            yield band

    def _straight(self, pixels: F32, coverage: F32) -> tuple[F32, F32]:
        rgb = pixels[..., :3]
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
    covered = odd = seen = 0
    lowest, highest = np.inf, np.zeros(3)
    samples = []
    for rgb, coverage in rows.bands():
        pixels = rgb[coverage > 0]
        covered += len(pixels)
        finite = _all_channels(np.isfinite(pixels))
        odd += int(np.sum(~finite))
        if finite.any():
            pixels = pixels if finite.all() else pixels[finite]
            lowest = min(lowest, float(pixels.min()))
            highest = np.maximum(highest, [pixels[:, c].max() for c in range(3)])
            samples.append(pixels[-seen % stride::stride].copy())  # every so many of them all
            seen += len(pixels)
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


def _develop(rgb: F32, coverage: F32, survey: _Survey, space: str, scale: float) -> Pixels:
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


def reduce(pixels: Pixels, rows: F64, columns: F64) -> Pixels:
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
