"""Which numbers of a rig are changed: the fewest that predict left-out views about as well as all.

Half of the texels say what is to be changed; of the other half, views are left out in turn and predicted under the
change.  So the change is judged by texels, and base colours by views, that had no part in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..evaluation.folds import split
from ..job import Steps, share_of
from .contest import GIVEN, HALF, SURE, Contest
from .free_numbers import LEAST_FIT, NOTHING, candidates, gains, is_off, pruned, sure_of_ambient
from .rig_fit import AGAIN, ROUNDS, RigFit, RigFound, around_of, fit_rig
from .rig_numbers import Free
from .rig_sample import RigSample

# Power of the cosine.  Shoots that Cycles rendered show up to 0.02, one of flat faces under few lamps 0.06; photographs
# of a matt figurine show 0.1 to 0.2.
LEAST_BEND = 0.08
QUICK = 2  # rounds that say whether something seems to be off
HOPELESS = 0.75  # of what neighbours have in common: where all numbers leave more, none of them leave HALF
OUT_OF_REACH = 2.0  # times what another rig's predictions are off by: four more rounds of a fit gain less
PAYS = 0.8  # of what is left over: below it, materials are not of the usual Specular IOR Level


@dataclass(frozen=True)
class Chosen:
    """Numbers that are worth changing, and the change by the sample that chose them."""

    contest: Contest
    taken: str  # the name of the rig in the contest
    free: Free
    found: RigFound

    @property
    def left(self) -> float:
        """Relative: what predictions of left-out views are off by, robust."""
        return self.contest.scale(self.taken)


@dataclass(frozen=True)
class Everything:
    """What all numbers that may be off explain together."""

    sample: RigSample
    frees: list[Free]  # from the fewest numbers on
    found: RigFound  # with the last of them free
    tilts: bool

    def foretold(self) -> float:
        """Relative: what predictions of left-out views are off by under it, robust."""
        folds = split(self.sample.texels)
        assert folds is not None
        contest = Contest(self.sample, self.found, folds, self.tilts)
        contest.add("everything", contest.of_whole(self.found))
        return contest.scale("everything")


@dataclass(frozen=True)
class Begun:
    """A fit of all numbers in which something seems to be off, however it ends."""

    quick: Everything  # after two rounds
    whole: Everything

    @property
    def from_afar(self) -> bool:
        """Whether lamps are to go first."""
        whole = self.whole
        return whole.frees[-1].lamps and not gains(whole.found) and (gains(self.quick.found) or not whole.tilts)

    @property
    def away(self) -> bool:
        """Whether it leaves more than it began with, and numbers alone are to be looked at."""
        return self.whole.found.scatter > self.whole.found.given and not self.whole.tilts

    @property
    def common(self) -> float:
        """Relative: what neighbouring texels leave over in common, at least."""
        return min(self.quick.found.common[1], self.whole.found.common[1])


def begun_of(sample: RigSample, lamps: bool, exposures: bool, tilts: bool) -> Steps[Begun | None]:
    """All numbers; None where nothing seems to be off.  ``tilts``: of the texels' normals too."""
    frees = candidates(sample, lamps, exposures, tilts)
    fit = RigFit(sample, frees[-1])
    quick = yield from share_of(fit.found(QUICK), 0.0, 0.1)
    if not frees[-1].levels:
        other = RigFit(sample, replace(frees[-1], levels=True))
        beside = yield from share_of(other.found(QUICK), 0.1, 0.2)
        if beside.scatter < PAYS * quick.scatter:
            fit, quick, frees = other, beside, [replace(free, levels=True) for free in frees]
    if not is_off(quick):
        return None
    whole = yield from share_of(fit.found(ROUNDS), 0.2, 0.5)
    return Begun(*(Everything(sample, frees, found, tilts) for found in (quick, whole)))


def everything_of(begun: Begun) -> Steps[Everything | None]:
    """All numbers, unless they explain nothing."""
    every = begun.whole
    if begun.from_afar:
        every = replace(every, found=(yield from _from_afar(every.sample, every.frees[-1])))
    if begun.away:
        alone = yield from _one_number(every)
        if alone.found.scatter < every.found.scatter or not gains(every.found):
            every = alone
    return every if is_off(every.found) and gains(every.found) else None


def chosen(every: Everything) -> Steps[Chosen | None]:
    """What is to be changed."""
    sample, frees, everything = every.sample, every.frees, every.found
    folds = split(sample.texels)
    assert folds is not None
    whole, given, frees = frees[-1], everything, pruned(frees, everything)
    hopeless = given.common[1] > HOPELESS * given.common[0]
    judged = [free for free in frees if free.only_ambient or not hopeless]
    if not judged:
        return None
    if frees[-1] != whole:
        everything = yield from share_of(fit_rig(sample, frees[-1], start=everything), 0.45, 0.5)
    contest = Contest(sample, everything, folds, every.tilts)
    taken, found, kept = GIVEN, everything, frees[-1]
    for n, free in enumerate(judged):
        begin, middle, end = (0.5 + 0.5 * (n + part) / len(judged) for part in (0.0, 0.3, 1.0))
        own = everything
        if free != frees[-1]:
            start = everything if free.lamps else replace(  # exposures are to show what powers and places did
                everything, change=replace(everything.change, log_gain=everything.brightness.change))
            own = yield from share_of(fit_rig(sample, free, start=start), begin, middle)
        if not _explains(own, free, given, everything):
            continue
        contest.add(str(free), (yield from share_of(contest.predictions(free, own), middle, end)))
        if contest.worth(free, taken) and (yield from _is_no_material(contest, free, everything, (middle, end))):
            taken, found, kept = str(free), own, free
            if own.scatter**2 - everything.scatter**2 < LEAST_FIT**2:  # more numbers explain no more
                break
    if taken == GIVEN:
        return None
    if (yield from _is_diffuse(contest, taken, kept)):
        with_diffuse = yield from _beside_diffuse(contest, kept, found)
        return None if with_diffuse is None else Chosen(contest, str(with_diffuse[0]), *with_diffuse)
    kept, found = yield from with_ambient(contest, kept, found)
    bent, beside = yield from _with_diffuse(contest, kept, found)
    if bent != kept and (yield from _is_response(contest, frees[-1], everything)):
        return Chosen(contest, str(frees[-1]), frees[-1], everything)
    return Chosen(contest, taken, bent, beside)


def _one_number(every: Everything) -> Steps[Everything]:
    """The one number of all views that explains most, where a fit of all numbers leaves more than it began with.

    Under a flash that the cameras carry, ambient light and a response bend brightness so much alike that a fit of both
    runs away.  Each alone does not.
    """
    none = replace(NOTHING, levels=every.frees[-1].levels)
    single = (replace(none, ambient=True), replace(none, vignetting=True), replace(none, response=True))
    alone, fits = [free for free in single if free in every.frees], []
    for free in alone:
        fit = RigFit(every.sample, free)
        found = yield from share_of(fit.found(QUICK), 0.5, 0.5)
        fits.append((yield from share_of(fit.found(ROUNDS), 0.5, 0.5)) if is_off(found) else found)
    best = min(range(len(fits)), key=lambda n: fits[n].scatter)
    return replace(every, frees=[alone[best]], found=fits[best])


def _from_afar(sample: RigSample, free: Free) -> Steps[RigFound]:
    """All numbers at once run away where lamps are far off; lamps alone come near, if that explains anything."""
    lamps = Free(True, False, levels=free.levels, tilts=free.tilts)
    near = yield from share_of(fit_rig(sample, lamps, rounds=2 * ROUNDS), 0.5, 0.5)
    if not gains(near):
        return near
    found = yield from share_of(fit_rig(sample, free, start=near, rounds=ROUNDS), 0.5, 0.5)
    best = found if found.scatter < near.scatter else near
    return replace(best, given=near.given, common=(near.common[0], best.common[1]))


def with_ambient(contest: Contest, free: Free, found: RigFound) -> Steps[tuple[Free, RigFound]]:
    """A rig that is better than the given one, with ambient light if the fit is sure of it and predicts no worse.

    One number more, which all views share, is not judged by halves of the texels: the lamps of two halves differ by
    more than it explains.  Where places in the shade show it, lit places need only not contradict.
    """
    without = yield from share_of(fit_rig(contest.sample, free, start=found, rounds=AGAIN), 1.0, 1.0)
    if free.ambient or not free.lamps or contest.sample.metals:  # between metals light bounces, which looks alike
        return free, without
    lit = replace(free, ambient=True)
    other = yield from share_of(fit_rig(contest.sample, lit, start=found, rounds=AGAIN), 1.0, 1.0)
    if not sure_of_ambient(other):
        return free, without
    for name, each in (("without", without), ("lit", other)):
        contest.add(name, contest.of_whole(each))
    shade = around_of(contest.sample, other)
    fine = contest.lead("without", "lit") < shade.value / shade.error if shade is not None else (
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
        other = yield from share_of(fit_rig(contest.sample, bent, start=found, rounds=AGAIN), 1.0, 1.0)
        contest.add(str(bent), contest.of_whole(other))
        sure = abs(other.change.cosine) > max(SURE * other.error.cosine, LEAST_BEND)
        if (sure and not contest.beats(name, str(bent))) if bent.cosine else contest.beats(str(bent), name):
            best, name = (bent, other), str(bent)
    return best


def _is_diffuse(contest: Contest, taken: str, free: Free) -> Steps[bool]:
    """Whether a diffuse that is not Lambert's, under the rig as given, predicts about as well as a changed rig.

    Three numbers in place of the places of all lamps: a rough surface shines back to where light comes from.  The place
    of one flash that cameras carry is as few numbers.
    """
    if not (free.lamps or free.exposures) or any(group.carried for group in contest.sample.rig.groups):
        return False
    alone = _alone(free)
    fit = RigFit(contest.sample, alone)
    contest.add(str(alone), contest.of_whole((yield from share_of(fit.found(QUICK), 1.0, 1.0))))
    if contest.scale(str(alone)) > OUT_OF_REACH * contest.scale(taken):
        return False
    found = yield from share_of(fit.found(ROUNDS), 1.0, 1.0)
    contest.add(str(alone), (yield from share_of(contest.predictions(alone, found), 1.0, 1.0)))
    return not contest.beats(taken, str(alone))


def _beside_diffuse(contest: Contest, free: Free, found: RigFound) -> Steps[tuple[Free, RigFound] | None]:
    """What of a rig is changed beside such a diffuse, if that predicts better than the diffuse alone."""
    both = replace(free, response=False, vignetting=False, diffuse=True)
    if not both.scene:
        return None
    other = yield from share_of(fit_rig(contest.sample, both, start=found, rounds=ROUNDS), 1.0, 1.0)
    contest.add(str(both), (yield from share_of(contest.predictions(both, other), 1.0, 1.0)))
    return (both, other) if contest.worth(both, str(_alone(free))) else None


def _alone(free: Free) -> Free:
    """Of a material, all that its diffuse may be; nothing of the scene."""
    return Free(False, False, levels=free.levels, tilts=free.tilts, diffuse=True)


def _explains(found: RigFound, free: Free, given: RigFound, everything: RigFound) -> bool:
    """Whether a fit leaves clearly less over than the given rig: less than half of what neighbours have in common.

    Lamps, exposures and a response can mimic what the model of the material lacks, but only in part.  Ambient light
    alone must explain more than what would then be left for all other numbers.  ``given``: a fit that began there.
    """
    left, gain = found.scatter**2 - everything.scatter**2, given.given**2 - found.scatter**2
    return gain > LEAST_FIT**2 and (left < gain if free.only_ambient else found.common[1] < HALF * given.common[0])


def _is_no_material(contest: Contest, free: Free, start: RigFound, share: tuple[float, float]) -> Steps[bool]:
    """Whether ambient light predicts as well as a diffuse that is not Lambert's, a response or vignetting better.

    Such a diffuse bends brightness alike.  But some ambient light is in every room.
    """
    if not free.response and not free.only_ambient and not free.vignetting:
        return True
    other = replace(free, response=False, vignetting=False, ambient=free.ambient and free.response, diffuse=True)
    found = yield from share_of(fit_rig(contest.sample, other, start=start, rounds=ROUNDS), *share)
    contest.add(str(other), (yield from share_of(contest.predictions(other, found), *share)))
    if free.response or free.vignetting:
        return contest.beats(str(free), str(other))
    return not contest.beats(str(other), str(free))


def _is_response(contest: Contest, whole: Free, everything: RigFound) -> Steps[bool]:
    """Whether what a diffuse that is not Lambert's would explain is the files' response.

    It may have been too little to be worth it while nothing else was to explain it.  ``whole``: all numbers, if judged.
    """
    if not whole.response or str(whole) not in contest.left:
        return False
    return (yield from _is_no_material(contest, whole, everything, (1.0, 1.0)))
