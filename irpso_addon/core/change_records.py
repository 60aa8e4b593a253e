"""What a solve has put right of its scene: records that a solution carries and the report prints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

# Errors of left-out radiance from which on no model fits: relative (predicting black errs by 1), and of CIE L*.
UNEXPLAINED, UNEXPLAINED_LIGHTNESS = 0.6, 12.0


@dataclass(frozen=True)
class PredictionError:
    """How far predictions of views are off that took no part in the fit."""

    relative_rms: float  # square root of the sum of squared errors of radiance over that of squared radiances
    lightness: float  # root mean square error of CIE L*; about 1 is just noticeable

    @property
    def fits(self) -> bool:
        """Whether what was fitted explains the views at all."""
        return self.relative_rms < UNEXPLAINED and self.lightness < UNEXPLAINED_LIGHTNESS


@dataclass(frozen=True)
class LampChange:
    """A lamp, or the copies of a flash that cameras carry, put right."""

    lights: tuple[str, ...]
    offset: tuple[float, float, float]  # metres; of a flash in its camera's axes: right, up, backwards; SUN: radians
    offset_error: tuple[float, float, float]  # standard errors of these
    share: float  # length of the offset, of the distance to the object
    power: float  # factor
    power_error: float  # its standard error, relative
    cameras: tuple[str, ...] = ()  # of a flash that cameras carry: those of ``lights``
    sun: bool = False  # whether it is a SUN
    sure_place: bool = True  # whether its place is off beyond doubt; else it is changed along with the others
    sure_power: bool = True  # the same of its power
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)  # factors of its red, green and blue beside that of its power
    tint_error: float = 0.0  # their standard error, relative
    sure_tint: bool = False  # whether its colour is off beyond doubt

    @property
    def sure(self) -> bool:
        """Whether something of it is off beyond doubt."""
        return self.sure_place or self.sure_power or self.sure_tint


@dataclass(frozen=True)
class SizeChange:
    """The size of lamps that are all alike, put right."""

    lights: tuple[str, ...]
    extent: float  # half of their width, metres; of SUNs the half angle, radians
    error: float  # its standard error
    given: float  # what it was
    sun: bool = False  # whether they are SUNs


@dataclass(frozen=True)
class CameraChange:
    """A camera that was put right, from how it was given: turned about its axis, zoomed, bent and shifted."""

    camera: str
    size: tuple[int, int]  # of its pictures, pixels: width, height
    pixels: float  # by which its pictures of the object moved, root mean square over the mesh
    error: float  # standard error of the object's shift, pixels
    focal: float  # factor of its focal length; of an orthographic camera, that by which pictures grow
    focal_error: float  # its standard error, relative
    roll: float  # radians by which its pictures turned counter-clockwise
    roll_error: float  # its standard error
    k1: float  # added to the radial term k1 of its lens
    k1_error: float  # its standard error
    shift: tuple[float, float]  # by which the principal point moved to the right and up, of the width and the height
    image: Path | None = None  # the view that departs from its camera's others; None: it is of all views
    sure: bool = True  # whether it is off beyond doubt; else it was changed along with the others


@dataclass(frozen=True)
class ExposureChange:
    """A view whose exposure, or white balance, was put right."""

    image: Path
    camera: str
    stops: float  # EV to be added to the view's exposure
    error: float  # its standard error
    sure: bool = True  # whether it is off beyond doubt; else it is changed along with the others
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)  # factors of the view's tint, beside its exposure
    tint_error: float = 0.0  # their standard error, relative
    sure_tint: bool = False  # whether its white balance is off beyond doubt


@dataclass(frozen=True)
class VignettingChange:
    """Vignetting of all views that was put right."""

    power: float  # to be added to the views'
    error: float  # its standard error
    stops: float  # EV by which it darkens the corners of the widest picture
    sure: bool = True  # whether it is off beyond doubt


@dataclass(frozen=True)
class AmbientChange:
    """Light from all around that shines in all views beside their lamps."""

    radiance: tuple[float, float, float]  # to be added to the views', W/(m^2 sr), linear RGB
    share: float  # its irradiance, over the typical one by lamps
    error: float  # standard error of ``share``


@dataclass(frozen=True)
class ResponseChange:
    """The response of all files that was put right."""

    exponent: float  # by which the views' response is to be multiplied
    error: float  # its standard error, relative
    shoulder: float = 1.0  # the same of the views' shoulder
    shoulder_error: float = 0.0


@dataclass(frozen=True)
class BlackLevelChange:
    """What all files hold where no light falls, found in the shade."""

    level: tuple[float, float, float]  # to be added to the views': values of the files, linear Rec.709
    error: float  # standard error of each


@dataclass(frozen=True)
class WorldChange:
    """A world, under one of the turns that views ask for, put right."""

    world: str
    given: float  # radians: the turn that views ask for
    turn: float  # radians about Z to be added to it, against the clock as seen from above
    turn_error: float  # its standard error
    strength: float  # factor of its light, the same under all of the world's turns
    strength_error: float  # its standard error, relative
    sure_turn: bool  # whether its turn is off beyond doubt; else it is changed along with the others
    sure_strength: bool  # the same of its strength


@dataclass(frozen=True)
class Calibration:
    """What was put right of the light and of exposures, because left-out views are then predicted better."""

    lamps: tuple[LampChange, ...]
    exposures: tuple[ExposureChange, ...]
    given: PredictionError  # of left-out views, highlights apart, as the scene was given
    changed: PredictionError  # and after the change
    vignetting: VignettingChange | None = None
    ambient: AmbientChange | None = None
    response: ResponseChange | None = None
    black_level: BlackLevelChange | None = None
    size: SizeChange | None = None
    worlds: tuple[WorldChange, ...] = ()
    overlap: bool = True  # whether views have angles in common: else it may all be the material's


@dataclass(frozen=True)
class RefinedNormals:
    """Shading normals that were refined, because left-out views are then predicted better."""

    tilt: float  # degrees: median angle between refined normals and those that were given, where views show the texel
    # Robust standard deviation of what predictions of left-out views are off by, relative; highlights apart, and
    # without what normals of whole regions would explain:
    given: float
    refined: float
    # Root mean square of how far vertices followed them, relative to the object's longest side; 0: they lie as given.
    moved: float = 0.0
