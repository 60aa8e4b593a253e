"""Whether a scene's lamps and exposures are put right: only where left-out views are then predicted better.

Half of the texels say what is to be changed; of the other half, views are left out in turn and predicted under the
change.  So the change is judged by texels, and base colours by views, that had no part in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..evaluation.folds import split
from ..job import Progress, Steps, share_of
from .black_level import BlackLevel, black_level, without_black
from .contest import GIVEN, HALF, SURE, Contest
from .falloff import edge_falloff
from .far_exposures import far_exposures
from .free_numbers import LEAST_FIT, NOTHING, candidates, gains, is_far, is_off, pruned, sure_of_ambient
from .rig import RigChange
from .rig_fit import ROUNDS, RigFound, fit_rig, shade_of
from .rig_numbers import Free, tell_typical
from .rig_sample import COLOURS, RigSample
from .shade import shows_shade
from .standard_errors import COMMON, unexplained
from .tints import Tints, lamp_tints

# Power of the cosine.  Shoots that Cycles rendered show up to 0.02, one of flat faces under few lamps 0.06; photographs
# of a matt figurine show 0.1 to 0.2.
LEAST_BEND = 0.08
LEAST_TEXELS = 100
COLOURED = 1000  # texels that say the colour of light from all around
MESH = 0.003  # of the radiance, that neighbours leave over in common: more may be a mesh that is wrong in detail
TILTED = 0.9  # of what predictions are off by: below it, lamps are found beside tilts
PAYS = 0.8  # of what is left over: below it, materials are not of the usual Specular IOR Level

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


def calibrate(
    sample: RigSample, lamps: bool, exposures: bool, more: Larger | None = None,
    normals: bool = False,
) -> Steps[Judged | None]:
    """What is to be changed; None where nothing is, or where too little is seen to judge it.

    ``lamps``, ``exposures``: what may be changed.  The fewest numbers are changed that predict about as well as all.
    ``more``: a larger sample, with its openness where asked, which says by how much; None: the same.  ``normals``:
    whether the mesh may be wrong in detail.
    """
    larger = more or (lambda ambient: sample)
    lamps = lamps and not all(group.kept for group in sample.rig.groups)
    folds = split(sample.texels)
    if folds is None or len(sample.slot) < LEAST_TEXELS or not (lamps or exposures):
        return None
    yield Progress(0.0, "calibrate", "lamps and exposures")
    first = yield from _materials(sample)
    black = (yield from black_level(sample, folds, first)) if exposures else None
    if black is None:
        return (yield from _with_colours(sample, lamps, exposures, larger, normals, first))
    light = black.corrected(sample)
    first = yield from _materials(light)
    judged = yield from _with_colours(
        light, lamps, exposures, lambda ambient: black.corrected(larger(ambient)), normals, first)
    return _beside(black, judged, first)


def _materials(sample: RigSample) -> Steps[RigFound]:
    """Those of a sample, as the scene is given."""
    return (yield from fit_rig(sample, Free(False, False, levels=not sample.scale_known), rounds=1))


def _with_colours(
    sample: RigSample, lamps: bool, exposures: bool, larger: Larger, normals: bool, first: RigFound,
) -> Steps[Judged | None]:
    """What else is to be changed, colours of lamps before all.  ``first``: the materials of the sample."""
    folds = split(sample.texels)
    if folds is None:
        return None
    tints = (yield from lamp_tints(sample, folds, first, larger)) if lamps else None
    if tints is None:
        return (yield from _with_exposures(sample, lamps, exposures, larger, normals, first))
    judged = yield from _with_exposures(
        tints.corrected(sample), lamps, exposures, lambda ambient: tints.corrected(larger(ambient)), normals, first)
    return _beside(tints, judged, first)


def _beside(found: BlackLevel | Tints, judged: Judged | None, first: RigFound) -> Judged:
    """What was found before all else, and what was then.  ``first``: the materials, if that is nothing."""
    if judged is None:
        none = RigChange.none(len(first.change.offset), len(first.change.log_gain))
        change, error = found.beside(none, none)
        return Judged(replace(first, change=change, error=error), found.given, found.changed, NOTHING, error)
    change, error = found.beside(judged.found.change, judged.error)
    return replace(judged, found=replace(judged.found, change=change), error=error, given=found.given)


def _with_exposures(
    sample: RigSample, lamps: bool, exposures: bool, larger: Larger, normals: bool, first: RigFound,
) -> Steps[Judged | None]:
    """What else is to be changed, exposures that are far off before all.  ``first``: the materials of the sample."""
    folds = split(sample.texels)
    assert folds is not None
    far = (yield from far_exposures(sample, folds, first)) if exposures else None
    if far is None:
        judged = yield from _with_details(sample, lamps, exposures, larger, normals)
        return _with_falloff(sample, judged, first) if exposures else judged
    evened = far.evened
    judged = yield from _with_details(
        evened(sample), lamps, exposures, lambda ambient: evened(larger(ambient)), normals)
    judged = _with_falloff(evened(sample), judged, first)
    if judged is None:
        return Judged(far.found, far.given, far.changed, far.free, far.found.error)
    found = replace(judged.found, change=far.with_gains(judged.found.change))
    return replace(judged, found=found, given=far.given, free=replace(judged.free, exposures=True),
                   error=far.with_errors(judged.error))


def _with_falloff(sample: RigSample, judged: Judged | None, first: RigFound) -> Judged | None:
    """With vignetting, if cameras show it.  ``first``: the materials of the sample, if nothing else is off."""
    found = first if judged is None else judged.found
    falloff = edge_falloff(sample, found)
    if falloff is None:
        return judged
    if judged is None:
        none = RigChange.none(len(first.change.offset), len(first.change.log_gain))
        alone = falloff.beside(replace(first, change=none, error=none))
        return Judged(alone, falloff.given, falloff.changed, NOTHING, alone.error)
    beside = falloff.beside(judged.found)
    return replace(judged, found=beside, error=replace(judged.error, vignetting=falloff.error))


def _with_details(
    sample: RigSample, lamps: bool, exposures: bool, more: Larger, normals: bool,
) -> Steps[Judged | None]:
    """What is to be changed, beside a mesh that is wrong in detail too: that may hide what is off."""
    judged, off = yield from _judged(sample, lamps, exposures, more, False)
    if off and normals and (judged is None or judged.found.common[1] > MESH):
        beside, _ = yield from _judged(sample, lamps, exposures, more, True)
        if beside is not None and (judged is None or beside.left < TILTED * judged.left):
            judged = beside
    return judged


def _judged(
    sample: RigSample, lamps: bool, exposures: bool, more: Larger, tilts: bool,
) -> Steps[tuple[Judged | None, bool]]:
    """What is to be changed, and whether something seems to be off.  ``tilts``: of the texels' normals too."""
    folds = split(sample.texels)
    assert folds is not None
    frees = candidates(sample, lamps, exposures, tilts)
    quick = yield from share_of(fit_rig(sample, frees[-1], rounds=2), 0.0, 0.1)
    if not frees[-1].levels:
        levels = replace(frees[-1], levels=True)
        other = yield from share_of(fit_rig(sample, levels, rounds=2), 0.1, 0.2)
        if other.scatter < PAYS * quick.scatter:
            quick, frees = other, [replace(free, levels=True) for free in frees]
    if not is_off(quick):
        return None, False
    if not gains(quick):
        return None, True
    everything = yield from share_of(fit_rig(sample, frees[-1]), 0.2, 0.5)
    if frees[-1].lamps and not gains(everything):
        everything = yield from _from_afar(sample, frees[-1])
    if not is_off(everything) or not gains(everything):
        return None, True
    whole, given, frees = frees[-1], everything, pruned(frees, everything)
    if frees[-1] != whole:
        everything = yield from share_of(fit_rig(sample, frees[-1], start=everything), 0.45, 0.5)
    contest = Contest(sample, everything, folds, tilts)
    taken, found, kept = GIVEN, everything, frees[-1]
    for n, free in enumerate(frees):
        begin, middle, end = (0.5 + 0.5 * (n + part) / len(frees) for part in (0.0, 0.3, 1.0))
        own = everything
        if free != frees[-1]:
            own = yield from share_of(fit_rig(sample, free, start=everything), begin, middle)
        if not _explains(own, free, given, everything):
            continue
        contest.add(str(free), (yield from share_of(contest.predictions(free, own), middle, end)))
        if contest.worth(free, taken) and (yield from _is_no_material(contest, free, everything, (middle, end))):
            taken, found, kept = str(free), own, free
            if own.scatter**2 - everything.scatter**2 < LEAST_FIT**2:  # more numbers explain no more
                break
    if taken == GIVEN:
        return None, True
    kept, found = yield from _with_ambient(contest, kept, found)
    bent, beside = yield from _with_diffuse(contest, kept, found)
    if bent != kept and (yield from _is_response(contest, frees[-1], everything)):
        taken, kept, found = str(frees[-1]), frees[-1], everything
    else:
        kept, found = bent, beside
    final = yield from _final(kept, found, more)
    found = final.found
    if not is_off(found):
        return None, True
    found = yield from _weighed(final)
    if is_far(found) and (tilts or not contest.leaves_half(taken)):
        return None, True
    ambient = yield from _ambient(final.sample, final.free, found)
    return Judged(found, contest.judge.error(GIVEN), contest.judge.error(taken), final.free, found.error, ambient,
                  contest.scale(taken)), True


def _from_afar(sample: RigSample, free: Free) -> Steps[RigFound]:
    """All numbers at once run away where lamps are far off; lamps alone come near."""
    lamps = Free(True, False, levels=free.levels, tilts=free.tilts)
    near = yield from share_of(fit_rig(sample, lamps, rounds=2 * ROUNDS), 0.5, 0.5)
    found = yield from share_of(fit_rig(sample, free, start=near, rounds=ROUNDS), 0.5, 0.5)
    best = found if found.scatter < near.scatter else near
    return replace(best, given=near.given, common=(near.common[0], best.common[1]))


def found_again(before: Judged, sample: RigSample, more: Larger) -> Steps[Judged | None]:
    """The same change where cameras have been put right since: no other numbers but ambient light, their values anew.

    Cameras that are off hide ambient light, which makes little of the radiance.  None where nothing is off any more, or
    left-out views are not predicted better.  ``sample``, ``more``: as of `calibrate`.
    """
    if len(sample.rig.groups) != len(before.found.change.offset):  # cameras have left a flash that they shared
        return None
    black = before.found.change.black_level
    if black is None:
        return (yield from _again(before, sample, more))
    error = before.error.black_level
    assert error is not None
    light = replace(before, found=replace(before.found, change=replace(before.found.change, black_level=None)))
    again = yield from _again(
        light, without_black(sample, black), lambda ambient: without_black(more(ambient), black))
    return _beside(BlackLevel(black, error, before.given, before.changed), again, before.found)


def _again(before: Judged, sample: RigSample, more: Larger) -> Steps[Judged | None]:
    """As `found_again`, black level aside."""
    folds = split(sample.texels)
    if folds is None:
        return None
    first = yield from _materials(sample)
    tinted = before.found.change.log_tint is not None
    tints = (yield from lamp_tints(sample, folds, first, more)) if tinted else None
    seen = sample if tints is None else tints.corrected(sample)
    again = None
    if before.free != NOTHING:
        white = replace(before, found=replace(before.found, change=replace(before.found.change, log_tint=None)))
        again = yield from _found_again(
            white, seen, more if tints is None else lambda ambient: tints.corrected(more(ambient)))
    if before.found.change.vignetting and not before.free.vignetting:
        again = _with_falloff(seen, again, first)
    return again if tints is None else _beside(tints, again, first)


def _found_again(before: Judged, sample: RigSample, more: Larger) -> Steps[Judged | None]:
    """As `found_again`, of all but colours."""
    folds = split(sample.texels)
    if folds is None:
        return None
    contest = Contest(sample, before.found, folds, before.free.tilts)
    free, found = yield from _with_ambient(contest, before.free, before.found)
    final = yield from _final(free, found, more, ROUNDS)
    free, found = final.free, final.found
    if not is_off(found):
        return None
    found = yield from _weighed(final)
    if is_far(found) and not is_far(before.found):
        return None
    contest = Contest(sample, found, folds, free.tilts)
    contest.add(str(free), (yield from share_of(contest.predictions(free, found), 1.0, 1.0)))
    if not contest.beats(str(free), GIVEN):
        return None
    ambient = yield from _ambient(final.sample, free, found)
    return replace(before, found=found, given=contest.judge.error(GIVEN), changed=contest.judge.error(str(free)),
                   free=free, error=found.error, ambient_radiance=ambient)


@dataclass(frozen=True)
class _Final:
    """By how much a rig is off."""

    sample: RigSample  # to which it was fitted
    free: Free
    found: RigFound


def _final(free: Free, found: RigFound, more: Larger, rounds: int | None = None) -> Steps[_Final]:
    """By the larger sample.

    Without ambient light, where the larger sample is not sure of it.  ``rounds``: of the first fit, if materials are to
    be found in it too.
    """
    sample = more(free.ambient)
    found = yield from share_of(fit_rig(sample, free, start=found, rounds=rounds), 1.0, 1.0)
    if free.ambient and not sure_of_ambient(found):
        if free.only_ambient:
            none = RigChange.none(len(found.change.offset), len(found.change.log_gain))
            return _Final(sample, replace(free, ambient=False), replace(found, change=none))
        free = replace(free, ambient=False)
        found = yield from share_of(fit_rig(sample, free, start=found), 1.0, 1.0)
    return _Final(sample, free, found)


def _weighed(final: _Final) -> Steps[RigFound]:
    """What was found with its standard errors, drawn towards what is given by how far off lamps typically are."""
    sample, free, found = final.sample, final.free, final.found
    factor = yield from unexplained(sample, free, found)
    if tell_typical(sample.rig, free):
        found = yield from share_of(fit_rig(sample, free, start=found, factor=factor), 1.0, 1.0)
    stated = yield from share_of(fit_rig(sample, free, start=found, factor=factor * COMMON), 1.0, 1.0)
    return replace(found, error=stated.error)


def _with_ambient(contest: Contest, free: Free, found: RigFound) -> Steps[tuple[Free, RigFound]]:
    """A rig that is better than the given one, with ambient light if the fit is sure of it and predicts no worse.

    One number more, which all views share, is not judged by halves of the texels: the lamps of two halves differ by
    more than it explains.  Where places in the shade show it, lit places need only not contradict.
    """
    without = yield from share_of(fit_rig(contest.sample, free, start=found, rounds=ROUNDS), 1.0, 1.0)
    if free.ambient or not free.lamps:
        return free, without
    lit = replace(free, ambient=True)
    other = yield from share_of(fit_rig(contest.sample, lit, start=found, rounds=ROUNDS), 1.0, 1.0)
    if not sure_of_ambient(other):
        return free, without
    for name, each in (("without", without), ("lit", other)):
        contest.add(name, contest.of_whole(each))
    fine = not contest.beats("without", "lit") if shows_shade(contest.sample) else (
        contest.gain("lit", "without").sum() > 0)
    return (lit, other) if fine else (free, without)


def _with_diffuse(contest: Contest, free: Free, found: RigFound) -> Steps[tuple[Free, RigFound]]:
    """The same beside a diffuse that is not Lambert's, if there is one: lamps lean to make up for it.

    Real diffuse reflection is darker at grazing light, because light is refracted on its way in and out.  Lamps that
    lean explain a power of the cosine about as well, so that prediction hardly tells the two apart.  But it is one
    number, and near 0 where the diffuse is Lambert's.  All numbers of the diffuse must predict better.
    """
    if not free.lamps or free.response:
        return free, found
    best, name = (free, found), "lambert's"
    contest.add(name, contest.of_whole(found))
    for bent in (replace(free, cosine=True), replace(free, diffuse=True)):
        other = yield from share_of(fit_rig(contest.sample, bent, start=found, rounds=ROUNDS), 1.0, 1.0)
        contest.add(str(bent), contest.of_whole(other))
        sure = abs(other.change.cosine) > max(SURE * other.error.cosine, LEAST_BEND)
        if (sure and not contest.beats(name, str(bent))) if bent.cosine else contest.beats(str(bent), name):
            best, name = (bent, other), str(bent)
    return best


def _explains(found: RigFound, free: Free, given: RigFound, everything: RigFound) -> bool:
    """Whether a fit leaves clearly less over than the given rig: less than half of what neighbours have in common.

    Lamps, exposures and a response can mimic what the model of the material lacks, but only in part.  Ambient light
    alone must explain more than what would then be left for all other numbers.  ``given``: a fit that began there.
    """
    left, gain = found.scatter**2 - everything.scatter**2, given.given**2 - found.scatter**2
    return gain > LEAST_FIT**2 and (left < gain if free.only_ambient else found.common[1] < HALF * given.common[0])


def _is_no_material(contest: Contest, free: Free, start: RigFound, share: tuple[float, float]) -> Steps[bool]:
    """Whether ambient light or a response predicts as well as a diffuse that is not Lambert's, a response better.

    Such a diffuse bends brightness alike.  But some ambient light is in every room.
    """
    if not free.response and not free.only_ambient:
        return True
    other = replace(free, response=False, ambient=free.ambient and free.response, diffuse=True)
    found = yield from share_of(fit_rig(contest.sample, other, start=start, rounds=ROUNDS), *share)
    contest.add(str(other), (yield from share_of(contest.predictions(other, found), *share)))
    if free.response:
        return contest.beats(str(free), str(other))
    return not contest.beats(str(other), str(free))


def _is_response(contest: Contest, whole: Free, everything: RigFound) -> Steps[bool]:
    """Whether what a diffuse that is not Lambert's would explain is the files' response.

    It may have been too little to be worth it while nothing else was to explain it.  ``whole``: all numbers, if judged.
    """
    if not whole.response or str(whole) not in contest.left:
        return False
    return (yield from _is_no_material(contest, whole, everything, (1.0, 1.0)))


def _ambient(sample: RigSample, free: Free, found: RigFound) -> Steps[tuple[float, float, float]]:
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
