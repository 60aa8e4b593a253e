"""By how much a rig is changed: by a larger sample than that which chose its numbers, with standard errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..job import Steps, share_of
from .choice import Chosen
from .contest import GIVEN
from .free_numbers import is_far, is_off, sure_of_ambient
from .rig import RigChange
from .rig_fit import RigFound, fit_rig, shade_of
from .rig_numbers import Free, tell_typical
from .rig_sample import COLOURS, RigSample
from .standard_errors import COMMON, unexplained

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


def judged_of(chosen: Chosen, more: Larger) -> Steps[Judged | None]:
    """The change that was chosen, by the larger sample; None where nothing is off after all."""
    final = yield from final_of(chosen.free, chosen.found, more)
    if not is_off(final.found):
        return None
    found = yield from weighed(final)
    contest, taken = chosen.contest, chosen.taken
    if is_far(found) and (contest.tilts or not contest.leaves_half(taken)):
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
    return replace(found, error=stated.error)


def ambient_of(sample: RigSample, free: Free, found: RigFound) -> Steps[tuple[float, float, float]]:
    """Radiance of the light from all around in red, green and blue.

    Places in the shade say its colour, else some texels' pictures in each channel how much there is.
    """
    grey = found.change.ambient * sample.light / np.pi
    if not free.ambient:
        return 0.0, 0.0, 0.0
    if sample.texels.reflected.shape[-1] < COLOURS:  # layers of one channel each: all of them share the light
        return grey, grey, grey
    white = shade_of(sample, found)  # as what was found, weighted by base colours
    if white:
        red, green, blue = (grey * (shade_of(sample.channel(n), found) or 0.0) / white for n in range(COLOURS))
        return red, green, blue
    sample = sample.part(np.arange(len(sample.slot)) % max(len(sample.slot) // COLOURED, 1) == 0)
    radiance = []
    for channel in range(COLOURS):
        fit = yield from share_of(fit_rig(sample.channel(channel), free, start=found), 1.0, 1.0)
        radiance.append(fit.change.ambient * sample.light / np.pi)
    red, green, blue = (float(value) for value in radiance)
    return red, green, blue
