"""Whether a scene's lamps and exposures are put right: what is looked for, and in which order.

Each change is made only where left-out views are then predicted better.
"""

from __future__ import annotations

from dataclasses import replace

from ..evaluation.folds import Folds, split
from ..job import Progress, Steps, share_of
from .angles import angles_overlap
from .black_level import BlackLevel, black_level, without_black
from .choice import with_ambient
from .contest import GIVEN, Contest
from .details import with_details
from .falloff import edge_falloff
from .far_exposures import FarExposures, far_exposures
from .finish import Judged, Larger, ambient_of, final_of, judged_of, weighed
from .free_numbers import NOTHING, is_far, is_off
from .lamp_size import LampSize, lamp_size
from .metals import chosen_of_metals, curve_of_metals, metals_of
from .own_angles import foretells
from .rig import RigChange
from .rig_fit import ROUNDS, RigFound, fit_rig
from .rig_numbers import Free
from .rig_sample import RigSample
from .tints import Tints, tints_of
from .tone_curve import ToneCurve, may_have_one, tone_curve

LEAST_TEXELS = 100


def calibrate(
    sample: RigSample, lamps: bool, exposures: bool, more: Larger | None = None,
    normals: bool = False,
) -> Steps[Judged | None]:
    """What is to be changed; None where nothing is, where too little is seen to judge it, or where nothing fits.

    ``lamps``, ``exposures``: what may be changed.  The fewest numbers are changed that predict about as well as all.
    ``more``: a larger sample, with its openness where asked, which says by how much; None: the same.  ``normals``:
    whether the mesh may be wrong in detail.  What leaves most of the radiance of left-out views unexplained is no error
    of the rig's: a material that no model fits, such as a mirror, is predicted a little better by any free number.
    Only exposures that are far off are then told from it, of files without a tone curve that is not known: under one, a
    bright view is brighter by another factor than a dark one.  Metal is told from that first, see metals.py.
    """
    lamps = lamps and not all(group.kept for group in sample.rig.groups)
    folds = split(sample.texels)
    if folds is None or len(sample.slot) < LEAST_TEXELS or not (lamps or exposures):
        return None
    yield Progress(0.0, "calibrate", "lamps and exposures")
    first, larger = (yield from _materials(sample)), more or (lambda ambient: sample)
    overlap = angles_overlap(sample)
    metals = (yield from metals_of(sample, folds, first)) if overlap else None
    if metals is None:
        judged = yield from _judged(sample, folds, first, lamps, exposures, larger, normals)
    else:
        judged = yield from _of_metals(metals, lamps, exposures, larger)
    if judged is not None and judged.changed.fits:
        whose = overlap or (yield from foretells(sample, folds, judged.found.change))
        return replace(judged, overlap=overlap) if whose else None
    if not exposures or not overlap or any(may_have_one(view) for view in sample.rig.views):
        return None
    far = yield from far_exposures(sample, folds, first, unexplained=True)
    return None if far is None else _alone(far)


def _of_metals(first: RigFound, lamps: bool, exposures: bool, larger: Larger) -> Steps[Judged | None]:
    """The change of a rig that lights metal, by the larger sample.  ``first``: materials, of `with_metals`."""
    sample = replace(larger(False), metals=True)
    folds = split(sample.texels)
    if folds is None:
        return None
    curve = (yield from curve_of_metals(sample, folds, first, lamps)) if exposures else None
    if curve is not None:
        sample = curve.corrected(sample)
        first = yield from _materials(sample)
    elif any(may_have_one(view) for view in sample.rig.views):
        return None
    taken = yield from chosen_of_metals(sample, folds, first, lamps, exposures)
    judged = None if taken is None else (yield from judged_of(taken, lambda ambient: sample))
    return judged if curve is None else _beside(curve, judged, first)


def _judged(
    sample: RigSample, folds: Folds, first: RigFound, lamps: bool, exposures: bool, larger: Larger, normals: bool,
) -> Steps[Judged | None]:
    """The change that predicts left-out views better, of `calibrate`.  ``first``: the materials of the sample."""
    curve = (yield from tone_curve(sample, folds, first)) if exposures else None
    if curve is not None:
        seen = curve.corrected(sample)
        judged = yield from _with_black(seen, lamps, exposures, lambda ambient: curve.corrected(larger(ambient)),
                                        normals, (yield from _materials(seen)))
        return _beside(curve, judged, first)
    return (yield from _with_black(sample, lamps, exposures, larger, normals, first))


def _with_black(
    sample: RigSample, lamps: bool, exposures: bool, larger: Larger, normals: bool, first: RigFound,
) -> Steps[Judged | None]:
    """What else is to be changed, a black level before all.  ``first``: the materials of the sample."""
    folds = split(sample.texels)
    if folds is None:
        return None
    black = (yield from black_level(sample, folds, first)) if exposures else None
    if black is None:
        return (yield from _with_size(sample, lamps, exposures, larger, normals, first))
    light = black.corrected(sample)
    first = yield from _materials(light)
    judged = yield from _with_size(
        light, lamps, exposures, lambda ambient: black.corrected(larger(ambient)), normals, first)
    return _beside(black, judged, first)


def _with_size(
    sample: RigSample, lamps: bool, exposures: bool, larger: Larger, normals: bool, first: RigFound,
) -> Steps[Judged | None]:
    """What else is to be changed, the size of the lamps before all.  ``first``: the materials of the sample."""
    folds = split(sample.texels)
    assert folds is not None
    size = (yield from lamp_size(sample, folds, first)) if lamps else None
    if size is None:
        return (yield from _with_colours(sample, lamps, exposures, larger, normals, first))
    wide = size.corrected(sample)
    judged = yield from _with_colours(
        wide, lamps, exposures, lambda ambient: size.corrected(larger(ambient)), normals, (yield from _materials(wide)))
    return _beside(size, judged, first)


def _materials(sample: RigSample) -> Steps[RigFound]:
    """Those of a sample, as the scene is given."""
    return (yield from fit_rig(sample, Free(False, False, levels=not sample.scale_known), rounds=1))


def _with_colours(
    sample: RigSample, lamps: bool, exposures: bool, larger: Larger, normals: bool, first: RigFound,
) -> Steps[Judged | None]:
    """What else is to be changed, colours of lamps and pictures before all.  ``first``: the materials of the sample."""
    folds = split(sample.texels)
    if folds is None:
        return None
    tints = yield from tints_of(sample, folds, first, lamps, exposures, larger)
    if tints is None:
        return (yield from _with_exposures(sample, lamps, exposures, larger, normals, first))
    judged = yield from _with_exposures(
        tints.corrected(sample), lamps, exposures, lambda ambient: tints.corrected(larger(ambient)), normals, first)
    return _beside(tints, judged, first)


def _beside(found: BlackLevel | LampSize | Tints | ToneCurve, judged: Judged | None, first: RigFound) -> Judged:
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
        judged = yield from with_details(sample, lamps, exposures, larger, normals)
        return _with_falloff(sample, judged, first) if exposures else judged
    evened = far.evened
    judged = yield from with_details(
        evened(sample), lamps, exposures, lambda ambient: evened(larger(ambient)), normals)
    judged = _with_falloff(evened(sample), judged, first)
    if judged is None:
        return _alone(far)
    found = replace(judged.found, change=far.with_gains(judged.found.change))
    return replace(judged, found=found, given=far.given, free=replace(judged.free, exposures=True),
                   error=far.with_errors(judged.error))


def _alone(far: FarExposures) -> Judged:
    """Where nothing else is changed."""
    return Judged(far.found, far.given, far.changed, far.free, far.found.error)


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


def found_again(before: Judged, sample: RigSample, more: Larger) -> Steps[Judged | None]:
    """The same change where cameras have been put right since: no other numbers but ambient light, their values anew.

    Cameras that are off hide ambient light, which makes little of the radiance.  None where nothing is off any more, or
    left-out views are not predicted better.  ``before``: more than colours, a black level or vignetting.  ``sample``,
    ``more``: as of `calibrate`.
    """
    if len(sample.rig.groups) != len(before.found.change.offset):  # cameras have left a flash that they shared
        return None
    if any(one.metallic for one in before.found.materials.values()) and not sample.metals:
        return (yield from found_again(before, replace(sample, metals=True),
                                       lambda ambient: replace(more(ambient), metals=True)))
    if before.found.change.log_shoulder or (before.found.change.log_response and not before.free.response):
        curve = ToneCurve.of(before)
        change = replace(before.found.change, log_response=0.0, log_shoulder=0.0)
        straight = replace(before, found=replace(before.found, change=change))
        again = yield from found_again(
            straight, curve.corrected(sample), lambda ambient: curve.corrected(more(ambient)))
        return _beside(curve, again, before.found)
    extent, doubt = before.found.change.extent, before.error.extent
    if extent is not None and doubt is not None:
        size = LampSize(extent, doubt, before.given, before.changed)
        small = replace(before, found=replace(before.found, change=replace(before.found.change, extent=None)))
        again = yield from found_again(small, size.corrected(sample), lambda ambient: size.corrected(more(ambient)))
        return _beside(size, again, before.found)
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
    lamps, views = (tints is not None for tints in (before.found.change.log_tint, before.found.change.log_balance))
    tints = yield from tints_of(sample, folds, first, lamps, views, more)
    seen = sample if tints is None else tints.corrected(sample)
    change = replace(before.found.change, log_tint=None, log_balance=None)
    white = replace(before, found=replace(before.found, change=change))
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
    free, found = yield from with_ambient(contest, before.free, before.found)
    final = yield from final_of(free, found, more, ROUNDS)
    free, found = final.free, final.found
    if not is_off(found):
        return None
    found = yield from weighed(final)
    if is_far(found) and not is_far(before.found):
        return None
    contest = Contest(sample, found, folds, free.tilts)
    contest.add(str(free), (yield from share_of(contest.predictions(free, found), 1.0, 1.0)))
    if not contest.beats(str(free), GIVEN):
        return None
    ambient = yield from ambient_of(final.sample, free, found)
    return replace(before, found=found, given=contest.judge.error(GIVEN), changed=contest.judge.error(str(free)),
                   free=free, error=found.error, ambient_radiance=ambient)


