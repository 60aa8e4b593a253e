"""Reference images in: of any file that image_file.py opens.  Files have row 0 at the top, memory at the bottom."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..data import F32, F64, Bool, RadianceImage, SceneData, View
from ..errors import BadInput
from ..params import SolveSettings
from ..phrases import percent
from ..vignetting import brightened
from . import oiio_reader
from .colour import SPACES, known_space, to_linear_rec709
from .image_file import ImageFile, open_image
from .mask import ASPECT, Mask
from .oiio_reader import JPEG, TIFF
from .picture_survey import Rows, Survey, all_channels, survey
from .raw_reader import is_raw
from .response import as_read, file_scale, straightened
from .shot_settings import brighter_by

_EVEN = 0.99  # quantile of a flat field that counts as 1: a speck may be brighter
_MOST_BLACK = 0.6  # share of a flat field: around the circle of a fisheye it is about half
_DIM = 0.02  # of that: where a flat field is darker, nothing can be divided by it

_STEP = np.float32(0.1)  # of white: clipped values are lowered by it to see which channels of Rec.709 rise with them
# Radiance (rows, width, 3), as of `RadianceImage.rgb`; coverage and validity (rows, width).
Pixels = tuple[F32, F32, Bool]


def read_reference(view: View, max_pixels: int | None = None) -> RadianceImage:
    """Radiance of ``view.image``: linear Rec.709, divided by 2^exposure, gain and tint, alpha divided out, upright.

    ``view.black_level`` and ``view.response`` are undone, also of ambient picture and flat field; then ``view.ambient``
    is subtracted, and ``view.flat`` and ``view.vignetting`` are divided out.

    With ``max_pixels`` a larger image is reduced by area averages to at most about that many; a reduced
    pixel is valid only if all under it are.  Beside the result it takes about 250 MB, however large the image is, and
    as much again for each of ambient and flat field.
    Raises BadInput (one line, naming the file) for a file that is missing, damaged, too large, of another aspect
    than the camera's, that holds NaN, infinite or clearly negative values where it is covered, that is darker than its
    ambient picture, or in which nothing can be used.
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
    return RadianceImage(
        rgb=brightened(straightened(rgb, view), view.camera, view.vignetting), coverage=coverage, valid=valid,
        warnings=reference.warnings, clipped_share=reference.clipped_share)


class Reference:
    """A view's reference image, surveyed; its pixels are developed band by band."""

    def __init__(self, view: View, of: Reference | None = None) -> None:
        """Raises BadInput as `read_reference`.  ``of``: the picture whose ambient or flat field this one is."""
        file = open_image(view.image, view.full_raw)
        self.width, self.height, self.file = file.width, file.height, file
        if of is not None and (file.width, file.height) != (of.width, of.height):
            raise BadInput(f"{view.image}: is {file.width} x {file.height} pixels, {of.file.path.name} {of.width} x "
                           f"{of.height}; take both with the same camera and settings")
        aspect = file.width / file.height
        if abs(aspect / view.camera.aspect - 1) > ASPECT:
            raise BadInput(f"{view.image}: is {file.width} x {file.height} pixels (aspect {aspect:.3f}), but camera "
                           f"'{view.camera.name}' has aspect {view.camera.aspect:.3f}; give the scene's render "
                           "resolution the aspect of the images")
        self._view = view
        self._develop, warnings = _development(view, file)
        self._rows = Rows(file, None if view.mask is None else Mask(view.mask, file))
        self._survey: Survey = survey(self._rows, 0.0 if of is None else of._survey.level)
        if view.image.suffix.lower() in JPEG:
            warnings += (f"{view.image.name}: is a JPEG file (8 bits per channel, and a tone curve if a camera wrote "
                         "it, which IRPSO undoes in part); use RAW files, or EXR or 16 bits of linear light",)
        elif file.bits <= 8:
            warnings += (f"{view.image.name}: has 8 bits per channel; use EXR, RAW or 16 bits for exact maps",)
        self.warnings: tuple[str, ...] = warnings + file.warnings
        self.clipped_share = self._survey.clipped
        self._left = np.zeros(3)  # of what ambient light leaves: pixels, those below 0, sum
        alone = replace(view, mask=None, ambient=None, flat=None)
        self._ambient = self._flat = None
        if view.ambient is not None:
            self._ambient = Reference(_alike(replace(alone, image=view.ambient), file), self)
        if view.flat is not None:
            self._flat = Reference(replace(alone, image=view.flat, exposure=0.0, gain=1.0, tint=(1.0, 1.0, 1.0)), self)
        for other in (self._ambient, self._flat):
            self.warnings += () if other is None else other.warnings

    def bands(self) -> Iterator[Pixels]:
        """Radiance (rows, width, 3), coverage and validity (rows, width), row 0 at the top.  Once only.

        It is as from a file that holds it by the view's response and black level, which `straightened` undoes.
        """
        ambient, flat = (None if other is None else _Taker(other.bands()) for other in (self._ambient, self._flat))
        even = None if self._flat is None else self._flat._even()
        for rgb, coverage in self._rows.bands(last=True):
            radiance, valid = self._developed(rgb)
            if ambient is not None or flat is not None:
                radiance = straightened(radiance, self._view)
            if ambient is not None and self._ambient is not None:
                light, _, known = ambient.take(len(radiance))
                radiance = _where(known, radiance - straightened(light, self._ambient._view))
                valid = valid & known
                self._left += _signs(radiance[valid & (coverage > 0)])
            if flat is not None and self._flat is not None:
                light, _, known = flat.take(len(radiance))
                light = straightened(light, self._flat._view)
                share = light.mean(-1) / np.float32(even)  # of all channels: a lens falls off alike in them
                known = known & (share > _DIM)
                valid = valid & known
                even_light = np.asarray(np.where(known, share, np.float32(1)), np.float32)
                radiance = _where(known, radiance / even_light[..., None])
            if ambient is not None or flat is not None:
                radiance = np.where(valid[..., None], radiance, np.maximum(radiance, np.float32(0)))
                radiance = as_read(radiance, self._view)
            yield radiance, coverage, valid

    def _developed(self, rgb: F32) -> tuple[F32, Bool]:
        """Stored colours to radiance, as of `Pixels`; which pixels are valid."""
        valid = all_channels(np.isfinite(rgb) & (rgb < self._survey.ceiling.astype(np.float32)))
        clipped = ~valid
        lost = rgb[clipped]
        if len(lost):
            rgb = _where(valid, rgb)
        with np.errstate(all="ignore"):
            radiance = self._develop(rgb)
            if not np.isfinite(radiance.sum()):  # beyond float32
                valid = valid & all_channels(np.isfinite(radiance))
                radiance = _where(valid, radiance)
            if len(lost):
                radiance[clipped] = self._at_least(lost)
        return radiance, valid

    def _at_least(self, rgb: F32) -> F32:
        """(n, 3) radiance that pixels have at least, of which some channel is clipped; 0: unknown.

        In other colour spaces a channel of Rec.709 may fall where a clipped one, whose true value is higher, rises.
        """
        ceiling = self._survey.ceiling.astype(np.float32)
        clipped, step, camera = rgb >= ceiling, _STEP * ceiling, self.file.camera
        if camera is None:
            rgb = np.minimum(rgb, ceiling)
        else:
            factors = np.array(self._view.white_balance or camera.white_balance, np.float32)
            rgb, step = _even_white(rgb, clipped, factors), _STEP / factors
        least = self._develop(rgb)
        less = self._develop(np.where(clipped, rgb - step, rgb))
        known = np.isfinite(least) & (least >= less)
        return np.asarray(np.where(known, np.maximum(least, np.float32(0)), np.float32(0)))

    def _even(self) -> float:
        """The level of a flat field that counts as 1.  Raises BadInput."""
        radiance, valid = self._developed(self._survey.sample)
        grey = straightened(radiance, self._view).mean(-1)[valid]
        level = float(np.quantile(grey, _EVEN)) if valid.any() else 0.0
        if not level > 0:
            raise BadInput(f"{self.file.path}: is not a flat field (black, or every pixel is clipped); take a picture "
                           "of an evenly lit surface")
        black = float(np.mean(grey <= _DIM * level))
        if black > _MOST_BLACK:
            raise BadInput(f"{self.file.path}: is not a flat field ({percent(black)} of it is black); take a picture "
                           "of an evenly lit surface")
        return level

    def check(self, usable: bool) -> None:
        """Once all bands are read: raises BadInput unless some pixel was ``usable``, covered and valid.

        Raises BadInput, too, where ambient light leaves less than nothing: of most pixels and of their sum.
        """
        if not usable:
            raise BadInput(f"{self.file.path}: every pixel is clipped; expose less")
        count, below, total = self._left
        if self._ambient is not None and below > count / 2 and total < 0:
            raise BadInput(f"{self._ambient.file.path}: is brighter than {self.file.path.name}, from which it is to be "
                           "subtracted; check which of the two is the ambient picture")


def _even_white(rgb: F32, clipped: Bool, factors: F32) -> F32:
    """(n, 3) of a RAW file: ``clipped`` channels as low as the lowest of them, once they are balanced by ``factors``.

    A sensor's channels end alike, and green, the brightest of white things, does so first.  Where all are clipped,
    their ends would be magenta, and that is no bound of a channel of Rec.709 that falls where green rises.
    """
    rgb = np.where(rgb >= 1, rgb - 1, rgb)  # of samples that are lost: see raw_reader.bands
    lowest = np.where(clipped, rgb * factors, np.float32(np.inf)).min(-1, keepdims=True)
    return np.asarray(np.where(clipped, lowest / factors, rgb), np.float32)


def _where(known: Bool, radiance: F32) -> F32:
    """0 elsewhere."""
    return np.asarray(np.where(known[..., None], radiance, np.float32(0)), np.float32)


def _signs(radiance: F32) -> F64:
    """(3,) of (N, 3): pixels, those below 0, and their sum."""
    grey = radiance.mean(-1, dtype=np.float64)
    return np.array([len(grey), np.count_nonzero(grey < 0), grey.sum()])


def _development(view: View, file: ImageFile) -> tuple[Callable[[F32], F32], tuple[str, ...]]:
    """What makes linear Rec.709, exposed as the view says, of stored colours; warnings."""
    camera, scale = file.camera, (1.0 / file_scale(view)).astype(np.float32)
    if camera is not None:
        return lambda rgb: camera.to_linear_rec709(rgb, view.white_balance) * scale, ()
    space, warnings = _space(view, file)
    plain = bool((scale == 1).all())
    return lambda rgb: to_linear_rec709(rgb, space) if plain else to_linear_rec709(rgb, space) * scale, warnings


def _alike(ambient: View, file: ImageFile) -> View:
    """A picture without flash, balanced like ``file``, and exposed like it where EXIF says that of both."""
    if ambient.white_balance is None and file.camera is not None:
        ambient = replace(ambient, white_balance=file.camera.white_balance)
    difference = brighter_by(open_image(ambient.image).shot, file.shot)
    return ambient if difference is None else replace(ambient, exposure=ambient.exposure + difference)


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
        return default, (f"{view.image.name}: states the colour space '{file.colorspace}', which is unknown; it is "
                         f"read as {default}: set the colour space of the views if it is another",)
    if file.integer and file.bits > 8 and view.image.suffix.lower() in TIFF:
        return default, (f"{view.image.name}: TIFF of {file.bits} bits without a colour space, which is read as sRGB: "
                         "set the colour space of the views ('Linear Rec.709' where RAW files were developed to "
                         "linear light)",)
    return default, ()


def with_one_white_balance(views: Sequence[View]) -> tuple[View, ...]:
    """The views, whose RAW files all have the first one's white balance.  Raises BadInput."""
    raw = [view.image for view in views if is_raw(view.image)]
    camera = open_image(raw[0]).camera if raw else None
    if camera is None:
        return tuple(views)
    return tuple(replace(view, white_balance=camera.white_balance) if is_raw(view.image) else view for view in views)


def with_raw_size(scene: SceneData, settings: SolveSettings) -> SceneData:
    """The scene, its RAW files to be read as ``settings`` say."""
    full = settings.raw_size == "full"
    return replace(scene, views=tuple(replace(view, full_raw=full and is_raw(view.image)) for view in scene.views))


def read_by_curve(view: View) -> bool:
    """Whether the picture's values are not taken for linear ones, by the view's colour space or the file's.

    Raises BadInput as `read_reference`.
    """
    file = open_image(view.image)
    return file.camera is None and SPACES[_space(view, file)[0]][2] != "linear"


class _Taker:
    """Bands as others want them: so many rows at a time."""

    def __init__(self, bands: Iterator[Pixels]) -> None:
        self._bands = bands
        self._held: list[Pixels] = []

    def take(self, count: int) -> Pixels:
        """The next ``count`` rows."""
        while sum(len(part[0]) for part in self._held) < count:
            self._held.append(next(self._bands))
        together = _joined(self._held)
        self._held = [_part(together, count, None)]
        return _part(together, 0, count)


def _reduced(reference: Reference, width: int, height: int) -> Iterator[Pixels]:
    """The reference's bands at another size, by area averages."""
    rows, columns = (np.linspace(0, n, m + 1) for n, m in ((reference.height, height), (reference.width, width)))
    step = max(1, int(oiio_reader.BAND / 4 / reference.width * height / reference.height))  # held beside the band
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


def reduce(pixels: Pixels, rows: F64, columns: F64) -> Pixels:
    """Area averages over the grid of cell edges ``rows`` x ``columns`` (in pixels, ascending).

    One that is not valid for clipped pixels under it has the mean of what those, and the others, show at least.
    """
    rgb, coverage, valid = pixels
    weighted = rgb if coverage.min() == 1 == coverage.max() else rgb * coverage[..., None]
    parts = weighted, coverage[..., None], (~valid[..., None]).astype(np.float32)
    few = np.concatenate([_row_means(part, rows) for part in parts], -1)
    small = _cell_means(few.swapaxes(0, 1), columns).swapaxes(0, 1)
    cover = small[..., 3]
    ok = small[..., 4] < 1e-6
    colour = np.where((cover > 0)[..., None], small[..., :3] / np.maximum(cover, 1e-12)[..., None], 0)
    return colour.astype(np.float32), cover.astype(np.float32), ok


def _row_means(values: F32, edges: F64) -> F64:
    """As `_cell_means`, of whole rows, of which only those of one mean are held in double precision."""
    flat = values.reshape(len(values), -1)
    out = np.empty((len(edges) - 1, flat.shape[1]))
    first = np.minimum(np.floor(edges[:-1] + 1e-6).astype(int), len(values) - 1)
    last = np.maximum(np.ceil(edges[1:] - 1e-6).astype(int), first + 1)
    for row, low, high, top, bottom in zip(out, edges[:-1], edges[1:], first, last, strict=True):
        at = np.arange(top, bottom)
        share = np.clip(np.minimum(high, at + 1) - np.maximum(low, at), 0, None)
        np.dot(share / share.sum(), flat[top:bottom].astype(np.float64), out=row)
    return out.reshape(-1, *values.shape[1:])


def _cell_means(values: F64, edges: F64) -> F64:
    """Means over [edges[i], edges[i+1]) of piecewise constant ``values`` (n, ...), along the first axis."""
    whole = np.minimum(np.floor(edges + 1e-6).astype(int), len(values) - 1)
    part = (edges - whole).reshape(-1, *[1] * (values.ndim - 1))
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, 0, dtype=np.float64)])
    at = total[whole] + part * values[whole]
    return np.asarray(np.diff(at, axis=0) / np.diff(edges).reshape(-1, *[1] * (values.ndim - 1)))
