"""Which numbers of a rig are looked for, and which of them are off beyond doubt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .contest import SURE
from .rig_fit import MOST_AMBIENT, RigFound
from .rig_numbers import Free
from .rig_sample import RigSample

LEAST_CHANGE = 0.002  # what is worth it: of a lamp's distance, relative power or gain
LEAST_VIGNETTING = 0.05  # power of the cosine
LEAST_AMBIENT = 0.003  # of the lamps' typical irradiance
LEAST_RESPONSE = 0.02  # of the exponent: less is made up by what a texel's one roughness does not explain
LEAST_FIT = 0.001  # of the radiance: what a change must explain of fitted views, where base colours explain a part
# Of a lamp's distance, in the mean.  Farther, lamps may mimic what a mesh has wrong, and walk off together with turned
# normals.
FARTHEST = 0.025
NOTHING = Free(False, False)  # but colours


def candidates(sample: RigSample, lamps: bool, exposures: bool, tilts: bool) -> list[Free]:
    """From the fewest numbers on.  Where no lamp lights two views, their exposures are its power: one number a view.

    ``tilts``: of the normals too.  Beside them a response or vignetting cannot be told, and lamps walk off under a
    Specular IOR Level that is none of the material's.
    """
    none = Free(False, False, levels=tilts or not sample.scale_known, tilts=tilts)
    alone = [] if tilts or not exposures else [replace(none, vignetting=True), replace(none, response=True)]
    if not lamps:
        bent = replace(none, exposures=True, vignetting=True, response=True)
        return [*alone, replace(none, exposures=True), *([] if tilts else [bent])]
    lit = [tuple(light.name for light in view.lights) for view in sample.rig.views]
    apart = len(set(lit)) < len(lit) or any(group.carried for group in sample.rig.groups)
    both = [replace(none, ambient=True, response=True)] if alone else []
    placed = [replace(none, lamps=True)]
    even = [replace(none, exposures=True)] if exposures and not apart else []
    if exposures and apart:
        placed += [replace(none, lamps=True, exposures=True)]
    last = replace(placed[-1], ambient=True)
    return [replace(none, ambient=True), *alone, *both, *even, *placed, last,
            *([replace(last, vignetting=True, response=True)] if alone else [])]


def pruned(frees: list[Free], everything: RigFound) -> list[Free]:
    """Without what is certainly as it is given, where all numbers are free."""
    ambient, response = sure_of_ambient(everything), sure_of_response(everything)
    less = [replace(free, ambient=free.ambient and ambient, response=free.response and response) for free in frees]
    return list(dict.fromkeys(free for free in less if free.scene))


def is_off(found: RigFound) -> bool:
    """Whether some number is off beyond doubt."""
    return sure_of_vignetting(found) or sure_of_ambient(found) or sure_of_response(found) or any(
        bool(np.any(np.abs(value) > np.maximum(SURE * error, LEAST_CHANGE))) for value, error in (
            (found.change.offset, found.error.offset), (found.brightness.change, found.brightness.error)))


def sure_of_vignetting(found: RigFound) -> bool:
    """Whether it is off beyond doubt."""
    return abs(found.change.vignetting) > max(SURE * found.error.vignetting, LEAST_VIGNETTING)


def sure_of_ambient(found: RigFound) -> bool:
    """Whether there is light from all around, beyond doubt."""
    return MOST_AMBIENT > found.change.ambient > max(SURE * found.error.ambient, LEAST_AMBIENT)


def sure_of_response(found: RigFound) -> bool:
    """Whether the response is off beyond doubt."""
    return abs(found.change.log_response) > max(SURE * found.error.log_response, LEAST_RESPONSE)


def is_far(found: RigFound) -> bool:
    """Whether lamps would move farther than a shoot's figures are usually off."""
    return bool(np.linalg.norm(found.change.offset, axis=1).mean() > FARTHEST)


def gains(found: RigFound) -> bool:
    """Whether it explains anything beside noise."""
    return found.given**2 - found.scatter**2 > LEAST_FIT**2
