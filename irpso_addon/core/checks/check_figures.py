"""The figures of a solve's checks beside the limits of its warnings: what the panel's traffic lights show."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from ..check_records import Checks
from ..phrases import percent
from . import warnings
from .residuals import BOUNCED

NEAR = 0.5  # of a limit: from here on a figure is near it


class Level(Enum):
    """Where a figure is with regard to its limit."""

    NONE = "none"  # it has no limit, or nothing tells
    GOOD = "good"
    NEAR = "near"  # or beyond by no more than its own error allows
    BEYOND = "beyond"


@dataclass(frozen=True)
class CheckFigure:
    """One row."""

    name: str
    value: str  # with its limit in brackets, where it has one
    level: Level = Level.NONE
    worst: str = ""  # the camera or light that it is of


def level_of(value: float, limit: float, doubt: float = 0.0) -> Level:
    """``value``: how far a figure is from what it should be, NaN where nothing tells; ``doubt``: what chance may do."""
    value = abs(value)
    if not math.isfinite(value):
        return Level.NONE
    if value > max(limit, doubt):
        return Level.BEYOND
    return Level.NEAR if value > NEAR * limit else Level.GOOD


def check_figures(checks: Checks) -> list[CheckFigure]:
    """A row for each figure that a user may want to see; the worst of the lights and cameras."""
    structure = max(warnings.STRUCTURE, warnings.NOISE_SHARE * checks.noise)
    rows = [CheckFigure("Noise", _known(checks.noise)), _share("Unexplained", checks.structure, structure),
            _share("Contradicting Views", checks.contradicted, warnings.CONTRADICTED),
            _share("Doubtful Roughness", checks.doubtful, warnings.DOUBTFUL),
            CheckFigure("No Highlight", _known(checks.no_highlight)),
            _share("Clipped", checks.clipped, warnings.CLIPPED),
            _share("Light in Shadows", checks.unlit_share, BOUNCED)]
    if checks.slope:
        limit, slope = warnings.LEAST_POWER, checks.slope
        rows.append(CheckFigure("Linearity", f"{slope.exponent:.3f} (1 ± {limit})", level_of(
            slope.exponent - 1, limit, warnings.SIGMAS_POWER * slope.error)))
    if checks.registration:
        worst, limit = max(checks.registration, key=lambda m: m.pixels), warnings.LEAST_SHIFT
        doubt = 0.0 if worst.shifted else worst.pixels  # by its own standard error
        rows.append(CheckFigure("Camera Alignment", f"{worst.pixels:.2f} px (< {limit})", level_of(
            worst.pixels, limit, doubt), worst.camera))
    if checks.lights:
        light, limit = max(checks.lights, key=lambda x: abs(math.log(x.gain))), warnings.LEAST_GAIN
        rows.append(CheckFigure(
            "Light Power", f"{percent(light.gain - 1, 1, sign=True)} (± {100 * limit:.1f})", level_of(
                light.gain - 1, limit, warnings.SIGMAS * light.gain_error), light.name))
    return rows


def _known(value: float) -> str:
    return percent(value, 1) if math.isfinite(value) else "unknown"


def _share(name: str, value: float, limit: float) -> CheckFigure:
    level = level_of(value, limit)
    return CheckFigure(name, _known(value) + ("" if level is Level.NONE else f" (< {100 * limit:.1f})"), level)
