"""What would put right what the warnings name, as changes of the scene that one button makes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..check_records import Checks
from ..phrases import NAMED
from .warnings import all_raw, curved_exponent, drifting, moved_lights, object_moved, off_cameras, strong_lights

# Exponents of pictures that were read as linear but are sRGB, and the other way round
ENCODED, DECODED = (0.35, 0.6), (1.7, 2.6)


@dataclass(frozen=True)
class Remedy:
    """One change of the scene."""

    label: str  # of the button
    kind: str  # "power", "move", "setting" or "colorspace"
    target: str = ""  # a light's object, or a row of SolveSettings
    factor: float = 1.0  # of power
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # metres; of a SUN radians
    value: str = ""  # of the setting, or the colour space


def remedies(checks: Checks) -> tuple[Remedy, ...]:
    """One for each warning that a change of the scene answers, in the order of the warnings."""
    exponent = curved_exponent(checks)
    for (low, high), space in ((ENCODED, "sRGB"), (DECODED, "Linear Rec.709")):
        if exponent is not None and low < exponent < high and not all_raw(v.view for v in checks.views):
            return (Remedy(f"Set Color Space of All Views to {space}", "colorspace", value=space),)
    found = []
    if off_cameras(checks):
        found.append(Remedy("Set Camera Alignment to Auto", "setting", "registration", value="auto"))
    if exponent is None:
        found += _lights(checks)
        if drifting(checks):
            found.append(Remedy("Set Exposures to Solve", "setting", "exposures", value="solve"))
    return tuple(found)


def _lights(checks: Checks) -> list[Remedy]:
    moved, strong = moved_lights(checks), strong_lights(checks)
    found = []
    if not object_moved(checks):
        for light in moved[:NAMED]:
            length = math.hypot(*light.offset)
            label = (f"Turn '{light.name}' by {math.degrees(length):.1f} Degrees" if light.sun else
                     f"Move '{light.name}' by {length:.2g} m")
            found.append(Remedy(label, "move", light.name, offset=light.offset))
    found += [Remedy(f"Multiply Power of '{light.name}' by {light.gain:.3f}", "power", light.name, light.gain)
              for light in [light for light in strong if light not in moved][:NAMED]]
    return found
