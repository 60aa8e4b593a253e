"""One look at a whole picture before its pixels are used: what is no radiance in it, and where it clips."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..data import F32, F64, SOLID, Bool
from ..errors import BadInput
from .image_file import ImageFile, floats
from .mask import Mask
from .oiio_reader import FORMS, Stored

KEEP = 128_000_000  # bytes of a decoded image that are held instead of being decoded again
# Negative values up to this share of the image's level (its 99.5 % point, or white where that is known and brighter)
# are data: read noise about a black level that was taken off, or a sharp colour in a small gamut.  Cut to 0, only the
# upper half of the noise would stay.  Lower values are data too where they are noise about 0 or more.
_NEGATIVE = 0.05
_BLOCK = 4  # pixels along a side: the noise of their mean is a quarter of a pixel's
_NOISY = 10  # blocks with negative values at least, or these are no noise but bad pixels
_NOISE_Z = 8.0  # no noise of a pixel, or of a block's mean, is so many times its deviation
_LOW, _LOW_Z = 0.1, 4.0  # a share of the blocks, and how low that share of noise about 0 is not (it is at -1.3)
_HALF_MAX = 65504.0
_STANDS_OUT = 10  # times as many pixels as have any other value
_BRIGHT, _WHITE, _CROWDED = 0.95, 0.99, 3.0  # of white, in linear light; density from there on, beside that below
_MANY = 30  # pixels


class Rows:
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
                raise BadInput(f"{self.file.path}: its alpha has NaN or infinite pixels; render it again")
            alpha = np.clip(alpha, 0, 1)
            coverage = coverage * alpha
            if self.file.premultiplied:
                with np.errstate(invalid="ignore", over="ignore"):  # the survey finds what is infinite
                    rgb = rgb * np.divide(1, alpha, out=np.zeros_like(alpha), where=alpha > 1e-6)[..., None]
        return rgb, coverage


@dataclass(frozen=True)
class Survey:
    """What one look at the whole image says."""

    ceiling: F64  # (3,) stored values from which on a channel is clipped
    clipped: float  # share of covered pixels that are
    level: float  # stored value that nearly all lie below: the 99.5 % point, or white
    sample: F32  # (n, 3) of the covered pixels, those of edges times their coverage


def survey(rows: Rows, least_level: float) -> Survey:
    """Finds what is not radiance and where the image clips.  Raises BadInput.

    ``least_level``: of another picture, beside which this one may be all dark.
    """
    file = rows.file
    stride = max(1, file.width * file.height // 300_000)
    covered = odd = seen = 0
    lowest, highest = np.inf, np.zeros(3)
    samples = []
    for rgb, coverage in rows.bands():
        pixels = _counting(rgb, coverage)
        covered += len(pixels)
        finite = all_channels(np.isfinite(pixels))
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
    white = 1.0 if file.integer or file.camera is not None else 0.0
    level = max(white or float(np.quantile(sample.max(-1), 0.995)), least_level)  # no value known exceeds white
    if lowest < -_NEGATIVE * level and not _only_noise(rows, lowest):
        raise BadInput(f"{file.path}: has negative radiance (down to {lowest:.3g}, where bright pixels have "
                       f"{level:.3g}); check the black level that was subtracted, or mask it out")
    # Numbers of 16 bits may end earlier than their type: many cameras write 12 bits.
    ceiling = np.ones(3) if file.integer and file.bits <= 8 else _plateaus(sample, highest)
    if white:
        ceiling = np.minimum(ceiling, 1.0)
    return Survey(ceiling, float(np.mean((sample >= ceiling).any(-1))), level, sample)


def _only_noise(rows: Rows, lowest: float) -> bool:
    """Whether values down to ``lowest`` are noise about radiances of 0 and more, as where a lamp lights nothing.

    Noise differs from pixel to pixel, so that means of blocks show little of it.  A black level that was subtracted
    twice, or a sharp colour in a small gamut, makes whole blocks negative.
    """
    means, variances = [], []
    for rgb, coverage in rows.bands():
        high, wide = (length // _BLOCK for length in coverage.shape)
        if not high or not wide:
            continue
        shape = high, _BLOCK, wide, _BLOCK
        rgb, coverage = (part[:high * _BLOCK, :wide * _BLOCK] for part in (rgb, coverage))
        blocks = rgb.reshape(*shape, 3).swapaxes(1, 2).reshape(-1, _BLOCK * _BLOCK, 3)
        whole = (coverage.reshape(shape).min((1, 3)) > SOLID).ravel()
        blocks = blocks[whole & (blocks.min((1, 2)) < 0)].astype(np.float64)
        means.append(blocks.mean(1))
        variances.append(blocks.var(1, ddof=1))
    if sum(map(len, means)) < _NOISY:
        return False
    deviation = np.sqrt(np.median(np.concatenate(variances), 0))
    if not deviation.all():
        return False
    off = np.concatenate(means) * _BLOCK / deviation  # of each block's mean, in deviations of its own
    deep = lowest < -_NOISE_Z * deviation.max() or off.min() < -_NOISE_Z
    return not deep and bool((np.quantile(off, _LOW, axis=0) > -_LOW_Z).all())


def _counting(rgb: F32, coverage: F32) -> F32:
    """(n, 3) of the covered pixels; those of edges, which are no observations, count by their coverage.

    Divided by an alpha of almost 0, the noise of a pixel outside the object would exceed the whole picture.
    """
    if coverage.min() > SOLID:
        return rgb.reshape(-1, 3)
    covered = coverage > 0
    pixels, share = rgb[covered], coverage[covered]
    edge = share <= SOLID
    pixels[edge] *= share[edge, None]
    return pixels


def _plateaus(sample: F32, highest: F64) -> F64:
    """(3,) value at which each channel of an image of fine steps was cut off, infinity where it was not.

    A cut leaves many pixels at exactly the highest value.  A flat surface under a flat light does so
    too; there other values are as common, or it is most of the picture.  A picture of 8 bits that was made linear has
    few values, so that many are common.  It ends at 1, and where it was scaled or straightened since, white is mixed
    with what was beside it.
    """
    ceiling = np.full(3, _HALF_MAX)
    for channel in range(3):
        column = sample[:, channel]
        top = np.count_nonzero(column == highest[channel]) if highest[channel] > 0 else 0
        if not 0.001 * len(sample) < top < 0.5 * len(sample):
            continue
        _, others = np.unique(column[(column > 0) & (column < highest[channel])], return_counts=True)
        if len(others) and top > _STANDS_OUT * others.max():
            ceiling[channel] = min(ceiling[channel], highest[channel])
        elif highest[channel] == 1 and _crowded_at_white(column):
            ceiling[channel] = _WHITE
    return ceiling


def _crowded_at_white(column: F32) -> bool:
    """Whether far more pixels are white, or almost, than are a little darker."""
    white, below = np.count_nonzero(column >= _WHITE), np.count_nonzero((column >= _BRIGHT) & (column < _WHITE))
    return bool(white >= _MANY and white * (_WHITE - _BRIGHT) > _CROWDED * below * (1 - _WHITE))


def all_channels(values: Bool) -> Bool:
    """``values.all(-1)`` of (..., 3), several times as fast."""
    return np.asarray(values[..., 0] & values[..., 1] & values[..., 2])
