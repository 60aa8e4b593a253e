"""What was measured of a solve's result: records that a solution carries and the report prints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

SIGMAS = 4.0  # a shift or gain so many standard errors off is beyond doubt
CERTAIN = 8.0  # the same of a roll or bend, which shapes that are off may look like ...
GROWN = 16.0  # ... and of a growth, which they mostly look like
LEAST_SHIFT, LEAST_GAIN = 0.02, 0.003  # less is not worth a second solve: pixels, relative


@dataclass(frozen=True)
class Residual:
    """One view's residuals, summed up.  Shares and spreads are relative (0.01: 1 %)."""

    pixels: int  # that were judged
    gain: float  # median of observed / predicted
    gain_error: float  # its standard error
    spread: float  # robust standard deviation of observed / predicted
    noise: float  # the part of it that differs from pixel to pixel
    structure: float  # the part that neighbours share: what the model does not explain
    unlit: float | None  # radiance where no light of the view arrives, as a share of the lit pixels' median
    unlit_pixels: int


@dataclass(frozen=True)
class Slope:
    """Exponent between image and radiance."""

    exponent: float
    error: float  # its standard error


@dataclass(frozen=True)
class LightResidual:
    """What a light's pixels say of it."""

    name: str
    views: int
    gain: float  # by which its irradiance should be multiplied
    gain_error: float
    offset: tuple[float, float, float]  # metres by which it should be moved, from its shading; SUN: radians
    offset_share: float  # of its distance; SUN: radians
    effect: float  # relative: the errors of shading that the move would take away, root mean square
    explained: float  # share of the residual's variance that the move explains
    sun: bool = False  # whether it is a SUN


@dataclass(frozen=True)
class Misfit:
    """One view beside its prediction."""

    image: Path
    camera: str
    size: tuple[int, int]  # pixels of the image: width, height
    shift: tuple[float, float]  # pixels by which the image's content lies to the right of and above the prediction
    shift_error: float  # standard error of each, pixels
    gain: float  # radiance of the image over the predicted; geometric mean over the views 1
    gain_error: float  # relative
    alone: bool  # it departs from the other views of its camera, which share their shift
    growth: float = 0.0  # relative: by how much the content is larger than the prediction
    growth_error: float = 0.0  # its standard error
    centre: tuple[float, float] = (0.0, 0.0)  # of the object, where the shift was found: pixels from the image's middle
    roll: float = 0.0  # radians: by how much the content is turned counter-clockwise
    roll_error: float = 0.0  # its standard error
    bend: float = 0.0  # what the lens's k1 lacks, of all cameras with this lens; 0 unless beyond doubt
    bend_error: float = 0.0  # its standard error

    @property
    def pixels(self) -> float:
        """Length of the shift."""
        return float(np.hypot(*self.shift))

    @property
    def shifted(self) -> bool:
        """The shift is beyond doubt, and worth mending."""
        return self.pixels > max(LEAST_SHIFT, SIGMAS * self.shift_error)

    @property
    def grown(self) -> bool:
        """The focal length is off beyond doubt, and worth mending: at the image's edges."""
        return abs(self.growth) > max(self._least, GROWN * self.growth_error)

    @property
    def rolled(self) -> bool:
        """The camera is turned about its axis beyond doubt, and that is worth mending."""
        return abs(self.roll) > max(self._least, CERTAIN * self.roll_error)

    @property
    def warped(self) -> bool:
        """The camera is off by more than a shift."""
        return self.grown or self.rolled or self.bend != 0

    @property
    def _least(self) -> float:
        """Relative: what moves an image's edges by little."""
        return 4 * LEAST_SHIFT / max(self.size)

    @property
    def drifted(self) -> bool:
        """So is the exposure's."""
        return abs(float(np.log(self.gain))) > max(LEAST_GAIN, SIGMAS * self.gain_error)


@dataclass(frozen=True)
class ViewCheck:
    """One view."""

    view: str
    camera: str
    lights: tuple[str, ...]
    clipped: float  # share of the object's pixels
    residual: Residual
    slope: Slope | None


@dataclass(frozen=True)
class MaterialCheck:
    """One material."""

    material: str
    model: str
    observations: float  # median of good ones a texel
    needed: float
    fewer: float  # share of its solved texels with fewer than needed
    one_value: bool = False  # whether all its texels were given one roughness


@dataclass(frozen=True)
class Checks:
    """What was measured after a solve.  Shares are of 1."""

    name: str  # of the object
    views: tuple[ViewCheck, ...]
    lights: tuple[LightResidual, ...]
    materials: tuple[MaterialCheck, ...]
    noise: float  # relative: of a pixel, median over views
    structure: float  # relative: what neighbouring pixels leave over together, median over views
    highlight: float  # relative to the lobes' part: what blocks of 2 x 2 pixels leave over in highlights alone
    slope: Slope | None  # of all views
    unlit_share: float  # radiance where no light arrives, as a share of the lit median; NaN: nothing tells
    clipped: float  # share of the object's pixels, all views together
    no_highlight: float  # share of the seen surface that no half vector came near: tan(theta_h) > 2 alpha
    nearest: float  # median over the seen surface of the least tan(theta_h) / alpha
    doubtful: float  # share of solved texels whose roughness, by its standard error, is off by more than 0.15
    sure: bool  # whether the method tells standard errors
    pixels_per_texel: float  # area, median over what the cameras see
    registration: tuple[Misfit, ...] = ()  # of each view: by how much its camera and its exposure are off
    misfit: bool = False  # whether some material is not clearly what its model says, as prediction shows
    contradicted: float = 0.0  # share of solved texels whose views contradict each other far more than the others' do
    around: bool = False  # whether a world or meshes that glow light some view
    known: float = 1.0  # share of solved texels whose roughness is known well enough for a confidence of one half
    not_bounced: str = ""  # why light where none arrives was not rendered and taken out; empty: it was, or not asked
