"""Grey patches of known reflectance in a picture: the scale of the lamps' powers, and whether the picture is linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ..data import F64
from ..errors import BadInput
from ..images.response import LEAST_RESPONSE, straight
from ..phrases import percent

# The six greys of the usual chart of 24 patches, white to black: Y of the maker's reference values (GretagMacbeth 2005;
# D50, 2 degrees), which follow from its published L*.  As designed (McCamy, Marcus and Davidson 1976) they were .900,
# .591, .362, .198, .090 and .031; real charts are within some 3 % of either.
CHART_GREYS = (0.9131, 0.5894, 0.3632, 0.1915, 0.0883, 0.0311)

GREY_NAMES = ("white", "lightest grey", "light grey", "grey", "dark grey", "black")  # as users are told of them

CLIPPED_VALUE = 0.995  # of the clip level
MOST_CLIPPED = 0.002  # share of a patch's pixels
MOST_SPREAD = 0.25  # of the mean: a square with more holds more than one patch
# So does one whose blocks differ by more from a plane.  Light that falls off leaves less, but for a lamp nearer than
# five times the square's side; an edge that leaves less shifts the mean by 15 % at most.
MOST_UNEVEN = 0.03
BLOCKS, LEAST_BLOCK = 5, 3  # blocks along a side, and pixels of one
LEAST_PIXELS = 16
LEAST_GREYS = 3  # of a chart that tell its response
LINEAR = 0.02  # how far the exponent of a linear picture may be from 1
NEARLY = 0.1  # and where stray light is likelier than a curve: 1 % of white on the black patch moves it by 0.08
LEAST_OF_CURVE = 5  # greys that tell a tone curve of two numbers, beside their scale
CURVE_FITS = 0.05  # of the values that a curve may leave
STEEPEST, SHOULDERS = 20.0, 200  # shoulders that are tried, up to: cameras have 5 to 15
SIDE = 0.5  # of the spacing of a chart's patches: a square of it stays inside a patch, however the chart is turned


class UnusablePatch(BadInput):
    """A patch that is clipped or black: others of its chart may do."""


class UnevenPatch(BadInput):
    """A square over an edge or a shine: the click was wrong, unless it is the only one of a chart."""


@dataclass(frozen=True)
class Patch:
    """What a picture shows in a square that the user has clicked."""

    mean: F64  # (3,) linear RGB
    spread: float  # standard deviation about a plane, of the mean of the channels, relative
    unevenness: float  # from the plane's least to its greatest value, relative: the light falls off
    clipped: float  # share of the pixels that are at the clip level in some channel


class Verdict(Enum):
    """Of a response."""

    LINEAR = "linear"
    NEARLY = "nearly linear"  # as stray light makes it
    CURVED = "non-linear"
    UNCLEAR = "unclear"  # the standard error is too large to tell


@dataclass(frozen=True)
class Response:
    """value = scale reflectance ** exponent, fitted to greys."""

    scale: float  # value of a white of reflectance 1
    exponent: float  # 1 for a linear picture
    standard_error: float  # of the exponent
    residual: float  # root mean square, relative
    verdict: Verdict

    def summary(self, name: str, decoded: bool, curve: GreyCurve | None = None) -> str:
        """One line about the pictures of which ``name`` shows the chart; ``decoded``: as sRGB.

        ``curve``: that on which the greys lie, and which the views now have.
        """
        figure = f"exponent {self.exponent:.2f} ± {max(self.standard_error, 0.01):.2f}"
        if self.verdict is Verdict.LINEAR:
            return f"These pictures are linear: {figure}"
        if self.verdict is Verdict.NEARLY:
            return f"These pictures are nearly linear: {figure}. Keep gloss and stray light off the chart's dark greys."
        if self.verdict is Verdict.UNCLEAR:
            return f"{name}: the six greys do not lie on one curve ({figure}). Light the chart evenly, without gloss."
        if decoded:
            return f"These pictures look non-linear (exponent {self.exponent:.2f}): the curve of {name} is not sRGB. " \
                   f"{'Use RAW files' if curve is None else curve.told}."
        also = ", or set the colour space of all views to sRGB" if self.exponent < 1 else ""
        return f"These pictures look non-linear (exponent {self.exponent:.2f}). Use RAW files{also}."


@dataclass(frozen=True)
class GreyCurve:
    """The tone curve of core/images/response.py on which a chart's greys lie."""

    response: float
    shoulder: float
    residual: float  # root mean square, relative to the file's values

    @property
    def told(self) -> str:
        """That it has been set."""
        return (f"Response {self.response:.2f} and Shoulder {self.shoulder:.2g} fit its greys to "
                f"{percent(self.residual, 1)} and are now set for all views; RAW files need neither")


def chart_squares(white: tuple[float, float], black: tuple[float, float], name: str = "chart") -> F64:
    """Squares (6, 3) on the greys between the middles of the ``white`` and the ``black`` patch: x, y, side in pixels.

    Raises BadInput (about ``name``) where the two are too close for squares of LEAST_PIXELS.
    """
    ends = np.array([white, black], np.float64)
    spacing = float(np.hypot(*(ends[1] - ends[0]))) / (len(CHART_GREYS) - 1)
    if not np.isfinite(ends).all() or (SIDE * spacing) ** 2 < LEAST_PIXELS:
        raise BadInput(f"{name}: the white and the black patch are too close to each other; click the middle of both, "
                       "in a picture that shows the chart larger")
    share = np.linspace(0, 1, len(CHART_GREYS))[:, None]
    middles = (1 - share) * ends[0] + share * ends[1]
    return np.concatenate([middles, np.full((len(share), 1), SIDE * spacing)], 1)


def measure_patch(values: F64, clip: float = 1.0, name: str = "patch") -> Patch:
    """Figures of the pixels ``values`` (h, w, 3), linear RGB, of a clicked square; ``clip``: what white clips at.

    Raises BadInput (about ``name``) where pixels are missing; UnusablePatch where they are clipped or dark; UnevenPatch
    where the square is not one patch.
    """
    values = np.asarray(values, np.float64)
    if values.ndim != 3 or values.shape[2] != 3 or values.shape[0] * values.shape[1] < LEAST_PIXELS:
        raise BadInput(f"{name}: the square has fewer than {LEAST_PIXELS} pixels; choose a larger one")
    if not np.isfinite(values).all():
        raise BadInput(f"{name}: the square holds pixels without a value; choose another place")
    clipped = float((values >= CLIPPED_VALUE * clip).any(-1).mean())
    if clipped > MOST_CLIPPED:
        raise UnusablePatch(f"{name}: {100 * clipped:.0f} % of the patch is clipped; use a darker exposure")
    mean = values.mean((0, 1))
    if not (mean > 0).all():
        raise UnusablePatch(f"{name}: the patch is black; use a brighter exposure or choose the patch again")
    spread, unevenness = _about_plane(values.mean(-1))
    if spread > MOST_SPREAD or _uneven(values.mean(-1)):
        raise UnevenPatch(f"{name}: the square shows more than one patch, or a shine; choose a smaller square inside "
                          "the patch")
    return Patch(mean, spread, unevenness, clipped)


def patch_scale(patch: Patch, reflectance: float, irradiance: F64, name: str = "patch") -> F64:
    """Factor (3,) by which the lamps' powers have to be multiplied so that the patch is as bright as in the picture.

    ``irradiance`` (3,) in W/m^2 is that of the lamps as they stand in the scene, at the patch and across it.  A matt
    patch of ``reflectance`` rho then has the radiance rho E / pi (Lambert).  BadInput where either is not positive.
    """
    irradiance = np.asarray(irradiance, np.float64)
    if not 0 < reflectance <= 1:
        raise BadInput(f"{name}: its reflectance is {reflectance:g}; enter a number above 0 and up to 1")
    if not (patch.mean > 0).all():
        raise BadInput(f"{name}: the view's Ambient Light alone would make the patch brighter; correct it")
    if not (np.isfinite(irradiance).all() and (irradiance > 0).all()):
        raise BadInput(f"{name}: no lamp of the scene lights the patch; check its place and the lamps")
    return np.asarray(np.pi * patch.mean / (reflectance * irradiance))


def chart_scale(means: F64, radiances: F64) -> F64:
    """Factor (3,) for the lamps' powers by least squares over patches (n, 3) of a chart.

    ``radiances`` (n, 3) are those that the lamps as they stand in the scene give the patches, by Lambert's law.
    """
    return np.asarray((means * radiances).sum(0) / (radiances ** 2).sum(0))


def chart_response(values: F64, reflectances: Sequence[float] = CHART_GREYS, name: str = "chart") -> Response:
    """Scale and exponent by a straight line through the logarithms of the greys' values and reflectances.

    ``values`` (n,) above 0, in the order of ``reflectances``, which are multiplied by the light on each grey where it
    is uneven.  Raises BadInput (about ``name``) for fewer than three greys, and where they do not grow darker.
    """
    if len(values) != len(reflectances) or len(values) < LEAST_GREYS:
        raise BadInput(f"{name}: only {len(values)} of the greys can be used, and {LEAST_GREYS} are needed; expose the "
                       "chart so that its white is not clipped")
    x = np.log(np.asarray(reflectances, np.float64))
    y = np.log(values)
    away = x - x.mean()
    exponent = float(away @ y / (away @ away))
    if not exponent > 0:
        raise BadInput(f"{name}: the greys grow darker where they should grow brighter; click white first, then black")
    rest = y - y.mean() - exponent * away
    error = float(np.sqrt(rest @ rest / (len(x) - 2) / (away @ away)))
    return Response(float(np.exp(y.mean() - exponent * x.mean())), exponent, error,
                    float(np.sqrt(np.mean(rest ** 2))), _verdict(abs(exponent - 1), error))


def chart_curve(values: F64, reflectances: F64) -> GreyCurve | None:
    """The tone curve that fits greys best; None where they are too few, or none fits.

    ``values`` (n,) of the file, white 1; ``reflectances`` (n,), multiplied by the light on each grey.
    """
    if len(values) < LEAST_OF_CURVE or not (values < 1).all():
        return None
    x = np.log(reflectances)
    best = None
    for shoulder in np.geomspace(1.0, STEEPEST, SHOULDERS):
        y = np.log(straight(values, 1.0, float(shoulder)))
        slope = 1 - (1 - 1 / shoulder) * values  # of the file's logarithm by that of y: errors are the file's
        share = slope**2 / (slope**2).sum()
        away, above = x - share @ x, y - share @ y
        response = float((share * away) @ above / ((share * away) @ away))
        residual = float(np.sqrt(np.mean((slope * (above - response * away)) ** 2)))
        if best is None or residual < best.residual:
            best = GreyCurve(response, float(shoulder), residual)
    return best if best is not None and best.residual < CURVE_FITS and best.response >= LEAST_RESPONSE else None


def _verdict(off: float, error: float) -> Verdict:
    if error > LINEAR and off < 2 * error + LINEAR:
        return Verdict.UNCLEAR
    return Verdict.LINEAR if off <= LINEAR else Verdict.NEARLY if off <= NEARLY else Verdict.CURVED


def _uneven(values: F64) -> bool:
    """Whether blocks of (h, w) differ from a plane by more than MOST_UNEVEN and more than their pixels' noise makes."""
    count = min(BLOCKS, min(values.shape) // LEAST_BLOCK)
    if count < LEAST_BLOCK:
        return False
    blocks = [part for rows in np.array_split(values, count) for part in np.array_split(rows, count, axis=1)]
    means = np.array([block.mean() for block in blocks]).reshape(count, count)
    noise = np.median([block.var() / block.size for block in blocks])  # of a mean; blocks with an edge are few
    off = (_about_plane(means)[0] * means.mean()) ** 2 * means.size / (means.size - 3)
    return bool(off > (MOST_UNEVEN * means.mean()) ** 2 + 4 * noise)


def _about_plane(values: F64) -> tuple[float, float]:
    """Relative standard deviation of (h, w) about its plane, and the plane's relative range."""
    y, x = np.indices(values.shape)
    design = np.stack([np.ones(values.size), x.ravel(), y.ravel()], -1)
    fit = np.linalg.lstsq(design, values.ravel(), rcond=None)[0]
    plane = design @ fit
    mean = float(values.mean())
    return float((values.ravel() - plane).std()) / mean, float(plane.max() - plane.min()) / mean
