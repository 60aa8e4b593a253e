"""What a check before a solve has measured, and what is wrong: a problem, its evidence, its remedy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..images.oiio_reader import JPEG
from ..images.shot_settings import LEAST_DIFFERENCE, NOTHING_SAID, ShotSettings, exposures_off
from ..phrases import percent, some

U8 = NDArray[np.uint8]

SHIFT, SHIFT_UNOUTLINED = 1.0, 1.5  # pixels of the checked pictures that a view may be off; where nothing masks it
REACH = 24  # checked pixels: greatest shift that is looked for
OUTLINE = 1.5  # checked pixels between outlines in their worst tenth, once shifted
EPIPOLAR = 1.0  # checked pixels, in the median, by which two pictures may disagree
MENDED = 2.0  # pixels up to which a solve shifts cameras by itself
ALIKE = 0.7  # the median shift over the median of their lengths: from here on all views are off alike
INSIDE = 0.05  # share of the mesh that a picture must show
CLIPPED = 0.01  # of the object's pixels
DARK = 0.01  # of white: median of the object
LIT = 0.3  # share of what a camera sees that its lights must reach, in the median
WHITE, BLACK = 1.25, 0.01  # base colours that are none: of the brightest 2 %, and the median
HIDDEN = 0.05  # of the object is left by alpha and mask
BACKS = 0.5  # of what the cameras see of the object, from which on it is inside out
UNLIKE = 2.0  # times as bright as the other views, or as dark
OFF, SIGMAS = 0.05, 3.0  # lamps: offset over distance that is said, if it is so many standard errors


@dataclass(frozen=True)
class ViewFigures:
    """One view.  Pixels are the picture file's own."""

    view: str
    lights: tuple[str, ...]
    reduction: float  # pixels of the file along a side of one that was looked at
    drawn: bool  # whether the camera shows the object at all
    shift: tuple[float, float] | None  # picture beside drawing, right and up; None: nothing tells
    outlined: bool  # told by alpha or a mask, to a tenth of a checked pixel; else to about a half
    clipped: float  # share of the object's pixels
    brightness: float | None  # median of the object, of white; None: the file's values have no white
    lit: float  # share of the object that the lights reach
    albedo: float  # base colour that the median pixel needs; NaN where nothing is lit
    brightest: float  # as well: that 2 % of the pixels exceed, highlights left out
    highlight: tuple[float, float] | None  # from the predicted one to the seen: pixels, degrees of half vector

    masked: bool  # whether coverage is a mask's, which need not follow the outline
    shown: float = 1.0  # share of what the camera sees of the object that alpha and mask leave
    outline: float | None = None  # pixels between outlines in their worst tenth, once shifted; None: none
    shot: ShotSettings = NOTHING_SAID
    exposure: float = 0.0  # EV, that the view states
    backs: float = 0.0  # share of what the camera sees of the object whose normals look away

    @property
    def pixels(self) -> float:
        """Length of the shift; NaN where nothing tells."""
        return float("nan") if self.shift is None else float(np.hypot(*self.shift))

    @property
    def shifted(self) -> bool:
        """Whether it is worth a word."""
        return self.pixels > (SHIFT if self.outlined else SHIFT_UNOUTLINED) * self.reduction


@dataclass(frozen=True)
class LampFigures:
    """A lamp, or a flash that goes with the camera."""

    name: str
    views: int
    on_camera: bool
    sun: bool
    distance: float  # metres from the object; 1 of a SUN
    place: tuple[float, float]  # where highlights say that it stands, beside its place: right, up; over its distance
    error: float  # standard error of each
    world: tuple[float, float, float]  # the same in metres, world axes

    @property
    def off(self) -> float:
        """Length of the offset, over the distance."""
        return float(np.hypot(*self.place))


@dataclass(frozen=True)
class PairFigures:
    """Two views whose cameras stand near each other, compared where both show the same texture."""

    one: str
    other: str
    points: int  # that were found in both
    pixels: float  # median distance from the epipolar lines, of the other's file; NaN: too few points, or unclear ones
    reduction: float  # as of ViewFigures, of the other

    @property
    def measured(self) -> bool:
        """Whether the points tell."""
        return not np.isnan(self.pixels)


@dataclass(frozen=True)
class Finding:
    """Something that is wrong."""

    problem: str  # "which file or object: what"
    evidence: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.problem} ({self.evidence}); {self.remedy}"


@dataclass(frozen=True)
class CheckPicture:
    """A view with the mesh's edges over it, (h, w, 3) display-encoded, row 0 at the bottom; lines to stand below."""

    pixels: U8
    lines: tuple[str, ...]


@dataclass(frozen=True)
class ShootCheck:
    """The whole check."""

    name: str  # of the object
    views: tuple[ViewFigures, ...]  # those that were looked at
    total: int  # how many there are
    outside: tuple[str, ...]  # views, of all, whose camera does not show the mesh
    lamps: tuple[LampFigures, ...]
    findings: tuple[Finding, ...] = ()
    pictures: tuple[CheckPicture, ...] = ()
    pairs: tuple[PairFigures, ...] = ()
    common: float | None = None  # shift that the views without one have in common, checked pixels; None: none

    @property
    def summary(self) -> str:
        """One line: what was looked at, and how well it fits."""
        shifts = [view.pixels for view in self.views if view.shift is not None]
        degrees = [view.highlight[1] for view in self.views if view.highlight]
        parts = [f"{self.name}: {len(self.views)} of {self.total} views checked"]
        parts.append(
            f"edges {np.median(shifts):.2f} pixels off (worst {max(shifts):.2f})" if shifts else
            "edges not found" if self.common is None else
            f"edges {self.common:.1f} checked pixels off, of all views together")
        lines = [pair.pixels for pair in self.pairs if pair.measured]
        parts.append(f"epipolar lines {np.median(lines):.2f} pixels off (worst of {len(lines)} pairs {max(lines):.2f})"
                     if lines else "epipolar lines not measured")
        parts.append(f"highlights {np.median(degrees):.1f} degrees off" if degrees else "no clear highlights")
        parts.append(f"{percent(max((view.clipped for view in self.views), default=0.0), 1)} clipped at most")
        return ", ".join(parts)


def findings(check: ShootCheck) -> tuple[Finding, ...]:
    """What is wrong, the likeliest cause of the rest first; nothing where all is well."""
    inside_out = _inside_out(check)
    if inside_out:  # which explains what is wrong with edges, highlights and light
        return (*_outside(check), *_hidden(check), *inside_out, *_files(check), *_exposure(check))
    return (*_outside(check), *_hidden(check), *_shifts(check), *_pairs(check), *_outlines(check), *_files(check),
            *_exposure(check), *_light(check), *_power(check), *_lamps(check))


def _outside(check: ShootCheck) -> list[Finding]:
    if not check.outside:
        return []
    return [Finding(
        f"{some(check.outside)}: does not show '{check.name}'",
        f"{len(check.outside)} of {check.total} cameras have less than {percent(INSIDE)} of the mesh in their picture",
        "export cameras and mesh from the same project in the same coordinates, or switch these views off")]


def _hidden(check: ShootCheck) -> list[Finding]:
    hidden = [view for view in check.views if view.drawn and view.shown < HIDDEN]
    if not hidden:
        return []
    worst = min(hidden, key=lambda view: view.shown)
    return [Finding(f"{some([view.view for view in hidden])}: its mask or alpha hides the object",
                    f"{percent(worst.shown)} of what its camera sees of '{check.name}' is left in '{worst.view}'",
                    "paint the object white in the mask and the rest black; check that it is this picture's mask")]


def _inside_out(check: ShootCheck) -> list[Finding]:
    shares = [view.backs for view in check.views if view.drawn]
    if not shares or np.median(shares) <= BACKS:
        return []
    return [Finding(f"object '{check.name}': its faces look inwards",
                    f"{percent(float(np.median(shares)))} of what the cameras see are backs, in the median view",
                    "recalculate its normals outside (Mesh > Normals > Recalculate Outside)")]


def _shifts(check: ShootCheck) -> list[Finding]:
    views = [view for view in check.views if view.drawn]
    known = [view for view in views if view.shift is not None]
    lines = []
    fits = check.common is not None and check.common <= SHIFT_UNOUTLINED
    if views and len(known) < len(views) / 2 and not fits:
        names = [view.view for view in views if view.shift is None]
        lines.append(Finding(
            f"{some(names)}: the mesh's edges are not found in the picture",
            f"in {len(names)} of {len(views)} views no shift of up to {REACH} pixels of the smaller picture fits",
            "check that each picture belongs to its camera, and export mesh and cameras from the same alignment"))
    off = [view for view in known if view.shifted]
    if not off:
        return lines
    shifts = np.array([view.shift for view in known])
    length, worst = float(np.median(np.hypot(*shifts.T))), max(off, key=lambda view: view.pixels)
    x, y = np.median(shifts, axis=0)
    alike = len(known) > 2 and np.hypot(x, y) > ALIKE * length and len(off) > len(known) / 2
    evidence = (f"{len(off)} of {len(known)} views, median {length:.1f} pixels, worst {worst.pixels:.1f} in "
                f"'{worst.view}'" + (f"; all by about ({x:+.1f}, {y:+.1f})" if alike else ""))
    if all(view.pixels / view.reduction < MENDED for view in off):
        remedy = "set Camera Alignment to Auto, which corrects so small a shift"
    elif alike:
        remedy = ("choose the pictures that the project was made from, not cropped, resized or undistorted ones, and "
                  "keep the project's principal point")
    else:
        remedy = ("align the project again and export cameras and mesh together; retake the pictures if the object "
                  "or a camera moved")
    return [*lines, Finding(f"{some([view.view for view in off])}: the picture does not line up with the "
                            "mesh", evidence,
                            remedy)]


def _pairs(check: ShootCheck) -> list[Finding]:
    """Not where edges have shown it."""
    told = {view.view for view in check.views if view.shift is not None and view.shifted}
    off = [pair for pair in check.pairs if pair.measured and pair.pixels > EPIPOLAR * pair.reduction
           and not {pair.one, pair.other} & told]
    if not off:
        return []
    worst = max(off, key=lambda pair: pair.pixels / pair.reduction)
    names = list(dict.fromkeys(name for pair in off for name in (pair.one, pair.other)))
    return [Finding(
        f"{some(names)}: their cameras contradict each other",
        f"{len(off)} of {sum(pair.measured for pair in check.pairs)} pairs; {worst.points} points that '{worst.one}' "
        f"and '{worst.other}' both show are {worst.pixels:.1f} pixels (median) from their epipolar lines",
        "check that each picture belongs to its camera and its lens, or align the project again and export it")]


def _outlines(check: ShootCheck) -> list[Finding]:
    off = [view for view in check.views
           if view.outline is not None and not view.masked and view.outline > OUTLINE * view.reduction]
    if not off:
        return []
    worst = max(off, key=lambda view: view.outline or 0.0)
    return [Finding(f"{some([view.view for view in off])}: the object's outline differs from the mesh's",
                    f"{worst.outline:.1f} pixels apart in the worst tenth of it in '{worst.view}', after the shift "
                    "was removed",
                    "check that the mesh is complete and placed as in the pictures; check the cameras' focal length")]


def _files(check: ShootCheck) -> list[Finding]:
    names = [view.view for view in check.views if Path(view.view).suffix.lower() in JPEG]
    if not names:
        return []
    return [Finding(f"{some(names)}: in JPEG format",
                    "8 bits per channel, and a tone curve if a camera wrote them, which IRPSO undoes in part",
                    "use RAW files, or EXR or 16 bits of linear light")]


def _exposure(check: ShootCheck) -> list[Finding]:
    lines = []
    clipped = [view for view in check.views if view.clipped > CLIPPED]
    if clipped:
        worst = max(clipped, key=lambda view: view.clipped)
        lines.append(Finding(
            f"{some([view.view for view in clipped])}: clipped",
            f"{percent(worst.clipped)} of the object's pixels in '{worst.view}'",
            "retake the pictures with less exposure: roughness is found from highlights"))
    black = [view for view in check.views if view.drawn and view.albedo == 0]
    if black:
        lines.append(Finding(f"{some([view.view for view in black])}: is black where it shows the object",
                             f"{len(black)} of {len(check.views)} views, half of the object's pixels or more",
                             "replace the picture, or switch the view off"))
    dark = [view for view in check.views
            if view.brightness is not None and view.brightness < DARK and view not in black]
    if dark:
        level = min(view.brightness or 0.0 for view in dark)
        lines.append(Finding(f"{some([view.view for view in dark])}: too dark",
                             f"the object's median is {percent(level, 2)} of white, near the noise",
                             "expose more, or increase the flash's power"))
    return lines


def _light(check: ShootCheck) -> list[Finding]:
    shares = [view.lit for view in check.views if view.drawn]
    if not shares or np.median(shares) >= LIT:
        return []
    return [Finding(f"lights of '{check.name}': they light too little of it",
                    f"{percent(float(np.median(shares)))} of what the cameras see is lit, in the median view",
                    "place the lamps outside the mesh, on the cameras' side, where no object hides them; check that "
                    "the mesh's faces point outwards")]


def _power(check: ShootCheck) -> list[Finding]:
    lit = [view for view in check.views if np.isfinite(view.albedo) and view.albedo > 0]
    if not lit:
        return []
    lines, middle = [], float(np.median([view.albedo for view in lit]))
    brightest = float(np.median([view.brightest for view in lit]))
    do = "the lights' power, the exposure of the views and the project's scale"
    if brightest > WHITE:
        lines.append(Finding(f"lights of '{check.name}': too little power",
                             f"bright parts would have to reflect {brightest:.3g} times the light that arrives",
                             f"multiply the power by {brightest / 0.8:.3g} or more; check {do}"))
    elif middle < BLACK:
        lines.append(Finding(f"lights of '{check.name}': too much power",
                             f"the surface would have to reflect {percent(middle, 2)} of the light that arrives",
                             f"divide the power by about {0.2 / middle:.3g}; check {do}"))
    exposed = _exposures(lit)
    lines += exposed[1]
    unlike = [view for view in lit if max(view.albedo / middle, middle / view.albedo) > UNLIKE
              and view not in exposed[0]]
    if unlike and len(lit) > 2:
        worst = max(unlike, key=lambda view: max(view.albedo / middle, middle / view.albedo))
        lines.append(Finding(
            f"{some([view.view for view in unlike])}: differs in brightness from the other views",
            f"'{worst.view}' is {worst.albedo / middle:.2g} times as bright as they are under the same light",
            "check the views' exposure and lights; set an automatic flash to manual"))
    return lines


def _exposures(views: list[ViewFigures]) -> tuple[list[ViewFigures], list[Finding]]:
    """Those whose Exposure is not what EXIF states, where what EXIF states makes them more like the rest; what to do.

    A flash that is shorter than the exposure time lights all alike, whatever EXIF states.
    """
    off = np.array(exposures_off([(view.shot, view.exposure) for view in views]))
    given = np.log2([view.albedo for view in views])
    middle = np.median(given - off)
    wrong = (abs(off) > LEAST_DIFFERENCE) & (abs(given - off - middle) < abs(given - middle))
    if not wrong.any() or len(views) < 3:
        return [], []
    found = [views[i] for i in np.flatnonzero(wrong)]
    worst = int(np.argmax(np.where(wrong, abs(off), 0)))
    return found, [Finding(
        f"{some([view.view for view in found])}: EXIF states another exposure than for the other views",
        f"{off[worst]:+.2f} EV beside the Exposure of '{views[worst].view}', whose brightness differs too",
        f"set its Exposure to {views[worst].exposure + off[worst]:.3g}" + (
            ", and correct the others likewise" if len(found) > 1 else ""))]


def _lamps(check: ShootCheck) -> list[Finding]:
    if sum(view.shifted for view in check.views) > len(check.views) / 2:  # which moves all highlights
        return []
    return [Finding(
        f"light '{lamp.name}': does not match the highlights",
        f"highlights of {lamp.views} views are {np.degrees(np.arctan(lamp.off)) / 2:.1f} degrees (of the half vector) "
        "from the predicted ones", _move(lamp))
        for lamp in check.lamps if lamp.off > max(OFF, SIGMAS * lamp.error)]


def _move(lamp: LampFigures) -> str:
    right, up = (part * lamp.distance for part in lamp.place)
    if lamp.sun:
        return f"turn it by {np.degrees(np.arctan(lamp.off)):.0f} degrees; measure its direction again"
    if not lamp.on_camera:
        x, y, z = lamp.world
        return (f"measure its place: the highlights fit if the light is moved by ({x:+.3g}, {y:+.3g}, {z:+.3g}) m, "
                f"{percent(lamp.off)} of its distance")
    words = [(right, "to the right", "to the left"), (up, "up", "down")]
    parts = [f"{abs(1000 * by):.0f} mm {plus if by > 0 else minus}" for by, plus, minus in words
             if abs(by) > 0.1 * lamp.off * lamp.distance]
    return ("measure the flash's offset from the lens: the highlights fit if the light is moved "
            f"{' and '.join(parts)}, {percent(lamp.off)} of its distance; check the project's scale too")
