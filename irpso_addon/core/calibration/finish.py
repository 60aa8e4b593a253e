"""By how much a rig is changed: by a larger sample than that which chose its numbers, with standard errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..data import F64
from ..job import Steps, share_of
from .choice import Chosen
from .contest import GIVEN
from .free_numbers import is_far, is_off, sure_of_ambient
from .rig import Rig, RigChange
from .rig_fit import RigFound, around_of, fit_rig
from .rig_numbers import Free, tell_typical
from .rig_sample import COLOURS, RigSample
from .standard_errors import COMMON, unexplained

# Of its distance: how far off a carried flash is found where 1 % of the light is the room's, alone or with a mesh and
# cameras that are off as those of a shoot are (1.2 and 1.9 %).
DISTANCE = 0.02
COLOURED = 1000  # texels that say the colour of light from all around

Larger = Callable[[bool], RigSample]


@dataclass(frozen=True)
class Judged:
    """A change that is worth making."""

    found: RigFound
    given: PredictionError  # of left-out views, as the scene is given
    changed: PredictionError
    free: Free  # what was looked for
    error: RigChange  # standard errors of the change
    ambient_radiance: tuple[float, float, float] = (0.0, 0.0, 0.0)  # W/(m^2 sr)
    left: float = 0.0  # relative: what predictions of left-out views are off by, robust
    overlap: bool = True  # whether views have angles in common: else it may all be the material's


def judged_of(chosen: Chosen, more: Larger) -> Steps[Judged | None]:
    """The change that was chosen, by the larger sample; None where nothing is off after all."""
    final = yield from final_of(chosen.free, chosen.found, more)
    if not is_off(final.found):
        return None
    found = yield from weighed(final)
    contest, taken = chosen.contest, chosen.taken
    if is_far(found) and not contest.sample.metals and (contest.tilts or not contest.leaves_half(taken, final.free)):
        return None
    ambient = yield from ambient_of(final.sample, final.free, found)
    return Judged(found, contest.judge.error(GIVEN), contest.judge.error(taken), final.free, found.error, ambient,
                  chosen.left)


@dataclass(frozen=True)
class Final:
    """By how much a rig is off."""

    sample: RigSample  # to which it was fitted
    free: Free
    found: RigFound


def final_of(free: Free, found: RigFound, more: Larger, rounds: int | None = None) -> Steps[Final]:
    """By the larger sample.

    Without ambient light, where the larger sample is not sure of it.  ``rounds``: of the first fit, if materials are to
    be found in it too.
    """
    sample = more(free.ambient)
    found = yield from share_of(fit_rig(sample, free, start=found, rounds=rounds), 1.0, 1.0)
    if free.ambient and not sure_of_ambient(found):
        if free.only_ambient:
            none = RigChange.none(len(found.change.offset), len(found.change.log_gain))
            return Final(sample, replace(free, ambient=False), replace(found, change=none))
        free = replace(free, ambient=False)
        found = yield from share_of(fit_rig(sample, free, start=found), 1.0, 1.0)
    return Final(sample, free, found)


def weighed(final: Final) -> Steps[RigFound]:
    """What was found with its standard errors, drawn towards what is given by how far off lamps typically are."""
    sample, free, found = final.sample, final.free, final.found
    factor = yield from unexplained(sample, free, found)
    if tell_typical(sample.rig, free):
        found = yield from share_of(fit_rig(sample, free, start=found, factor=factor), 1.0, 1.0)
    # What lamps typically are off by is not learnt again: under more scatter than there is, it would come out smaller.
    stated = yield from share_of(
        fit_rig(sample, free, start=found, factor=factor * COMMON, again=1, prior=found.prior), 1.0, 1.0)
    found = replace(found, error=stated.error)
    if not (free.lamps and sample.rig.one_flash):
        return found
    change, error = as_bright(sample.rig, sample.position.mean(0), found.change, found.error)
    return replace(found, change=change, error=error)


def as_bright(rig: Rig, middle: F64, change: RigChange, error: RigChange) -> tuple[RigChange, RigChange]:
    """With a power under which a flash that cameras carry, a little nearer or farther, lights the object as it did.

    ``middle``: (3,) of the object.  The distance makes all views brighter alike, which pictures do not separate from
    the base colours.  The little that they show of it is what light from all around, and whatever is wrong at grazing
    angles, show too.  So it is believed as far as it is more than these make of it (James and Stein 1961).
    """
    group = rig.groups[0]
    lights = {light.name: light for view in rig.views for light in view.lights}
    ways = np.array([axes.T @ (middle - lights[name].matrix[:3, 3])
                     for name, axes in zip(group.lights, group.axes, strict=True)]) / group.reach
    distance = float(np.linalg.norm(ways, axis=1).mean())
    toward = ways.mean(0) / max(float(np.linalg.norm(ways.mean(0))), 1e-6)
    nearer, unsure = float(change.offset[0] @ toward), float(np.linalg.norm(error.offset[0] * toward))
    believed = nearer * max(0.0, 1 - (DISTANCE**2 + unsure**2) / max(nearer**2, 1e-12))
    power = 2 * np.log((distance - nearer) / (distance - believed))
    return (replace(change, log_power=np.array([power])),
            replace(error, log_power=np.hypot(error.log_power, 2 * unsure / distance)))


def ambient_of(sample: RigSample, free: Free, found: RigFound) -> Steps[tuple[float, float, float]]:
    """Radiance of the light from all around in red, green and blue.

    Places in the shade say its colour, else some texels' pictures in each channel how much there is.
    """
    grey = found.change.ambient * sample.light / np.pi
    if not free.ambient:
        return 0.0, 0.0, 0.0
    if sample.texels.reflected.shape[-1] < COLOURS:  # layers of one channel each: all of them share the light
        return grey, grey, grey
    white = around_of(sample, found)  # as what was found, weighted by base colours
    if white is not None and white.value:
        shades = [around_of(sample.channel(n), found) for n in range(COLOURS)]
        red, green, blue = (0.0 if shade is None else grey * shade.value / white.value for shade in shades)
        return red, green, blue
    sample = sample.part(np.arange(len(sample.slot)) % max(len(sample.slot) // COLOURED, 1) == 0)
    radiance = []
    for channel in range(COLOURS):
        fit = yield from share_of(fit_rig(sample.channel(channel), free, start=found), 1.0, 1.0)
        radiance.append(fit.change.ambient * sample.light / np.pi)
    red, green, blue = (float(value) for value in radiance)
    return red, green, blue
