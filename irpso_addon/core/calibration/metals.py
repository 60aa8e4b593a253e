"""Rigs that light metal: what of them is off is told from highlights, which are nearly all that a metal shows.

Dielectrics explain little of a bronze: its highlights have its colour, and between them it is dark.  Where dielectrics
do not explain left-out views and metals do, each texel has a Metallic of its own beside its base colour and roughness.
Light that bounces and bumps that the mesh lacks then still leave more than a rig that is off does, so that no change
leaves half of the error.  Numbers are added one kind after the other instead, each time the kind that predicts left-out
views best, as long as that is better beyond the scatter.

Few observations show where highlights are, so that predictions hardly tell the place of a flash that cameras carry.
Halves of the texels and of the light's angles do: where they agree on it, it is changed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..data import F64
from ..evaluation.folds import Folds, Judge
from ..evaluation.sampled_texels import predicted
from ..job import Steps, share_of
from .choice import Chosen
from .contest import ANY, GIVEN, HALF, SURE, Contest
from .far_exposures import FAR, median_gains
from .free_numbers import LEAST_CHANGE, NOTHING
from .rig_fit import ROUNDS, RigFound, fit_rig, left_over
from .rig_numbers import Free
from .rig_sample import RigSample
from .standard_errors import COMMON, unexplained
from .texel_materials import lobes_of
from .tone_curve import ToneCurve, may_have_one

PUZZLING = 0.1  # relative: what dielectrics leave over where metals are looked for; rigs that are off leave less
FARTHEST = 0.06  # of a lamp's distance: farther, a curve has made it seem nearer or farther
BESIDE = 0.2  # the same of a flash beside its camera, whose distance is kept: 20 cm from a metre away
MOST_SHOULDER = 3.5  # logarithm: curves of cameras are 5 to 15 times flatter at white, and a fit may run away
LEAST_CURVE = 0.05  # logarithm of the response: light that bounces brightens what is dark, as a response of 0.97 does
VISIBLY = 0.98  # of what predictions are off by: less is not worth a change
DIELECTRIC, METAL = "dielectric", "metal"


def metals_of(sample: RigSample, folds: Folds, first: RigFound) -> Steps[RigFound | None]:
    """The materials of texels that may be metal; None where dielectrics explain half of the radiance, or metals little.

    ``first``: dielectric materials.  More than one lamp in a view is none of it: then what a highlight shows cannot
    be said to be one lamp's.
    """
    if first.scatter < PUZZLING or any(len(view.lights) != 1 for view in sample.rig.views):
        return None
    contest = Judge(sample.texels, folds, sample.cluster)
    contest.add("lambert", [predicted(sample.texels, None, ~left_out, ANY) for left_out in folds.left_out])
    contest.add(DIELECTRIC, _predicted(sample, folds, first))
    dielectric = contest.error(DIELECTRIC)
    if dielectric.relative_rms < HALF:
        return None
    metals = replace(sample, metals=True)
    found = yield from fit_rig(metals, NOTHING, rounds=1)
    contest.add(METAL, _predicted(metals, folds, found))
    metal = contest.error(METAL)
    better = metal.relative_rms < dielectric.relative_rms and metal.lightness < dielectric.lightness
    return found if metal.fits and better else None


def _predicted(sample: RigSample, folds: Folds, found: RigFound) -> list[F64]:
    """Of each fold, (T, V, C) radiance over irradiance by what the other views show of each texel."""
    lobes = lobes_of(sample, sample.texels, found.materials)
    return [predicted(sample.texels, lobes, ~left_out, ANY) for left_out in folds.left_out]


def curve_of_metals(
    sample: RigSample, folds: Folds, first: RigFound, lamps: bool,
) -> Steps[ToneCurve | None]:
    """The response of the files, with a shoulder where they may have a tone curve; None: none that is sure.

    Highlights alone say little: a curve looks like another roughness.  What light that falls off with the distance says
    of it may be exposures and places of lamps.  So it has to predict left-out views better than all of them, although
    these are more numbers.
    """
    if any(view.response != 1 or view.shoulder != 1 for view in sample.rig.views):
        return None
    curve = replace(NOTHING, response=True, shoulder=all(may_have_one(view) for view in sample.rig.views))
    contest = Contest(sample, first, folds)
    found = yield from _tried(contest, curve, first)
    if not _sure(found) or not _better(contest, str(curve), GIVEN):
        return None
    exposures = replace(NOTHING, exposures=True)
    for rival in (exposures, *((replace(NOTHING, lamps=True), replace(exposures, lamps=True)) if lamps else ())):
        other = yield from _tried(contest, rival, _evened(sample, first) if rival.exposures else first)
        if not _is_far(other) and contest.gain(str(curve), str(rival)).sum() <= 0:
            return None
    change = found.change
    return ToneCurve(change.log_response, change.log_shoulder, found.error, contest.judge.error(GIVEN),
                     contest.judge.error(str(curve)))


def chosen_of_metals(
    sample: RigSample, folds: Folds, first: RigFound, lamps: bool, exposures: bool,
) -> Steps[Chosen | None]:
    """What of lamps and exposures is changed; None: nothing.  ``first``: materials of the sample."""
    contest, kept, found, taken = Contest(sample, first, folds), NOTHING, first, GIVEN
    kinds = [replace(NOTHING, lamps=kind == "lamps", exposures=kind == "exposures")
             for kind, free in (("lamps", lamps), ("exposures", exposures)) if free]
    while kinds:
        fits = []
        for kind in kinds:
            free = replace(kept, lamps=kept.lamps or kind.lamps, exposures=kept.exposures or kind.exposures)
            own = yield from _tried(contest, free, found if kept.scene or kind.lamps else _evened(sample, first))
            if _better(contest, str(free), taken) and not _is_far(own, _limit(sample)):
                fits.append((float(contest.gain(str(free), taken).sum()), kind, free, own))
        if not fits:
            break
        _, best, kept, found = max(fits, key=lambda fit: fit[0])
        taken, kinds = str(kept), [kind for kind in kinds if kind != best]
    if lamps and not kept.lamps and sample.rig.one_flash:
        beside = yield from _beside_lens(contest, taken, kept, found)
        if beside is not None:
            return beside
    return None if taken == GIVEN else Chosen(contest, taken, kept, found)


def _beside_lens(contest: Contest, taken: str, kept: Free, start: RigFound) -> Steps[Chosen | None]:
    """The place of the flash beside its cameras too, if parts of the sample agree on it; None: they do not.

    Predictions of left-out views need only be better by whatever little.  ``kept``: what is changed already, ``taken``
    in the contest.
    """
    free = replace(kept, lamps=True)
    found = yield from _tried(contest, free, start)
    if _is_far(found, BESIDE) or contest.gain(str(free), taken).sum() <= 0 or not (
            contest.judge.error(str(free)).lightness < contest.judge.error(taken).lightness):
        return None
    factor = COMMON * (yield from share_of(unexplained(contest.sample, free, found), 0.5, 0.9))
    sure = np.abs(found.change.offset) > np.maximum(SURE * factor * found.error.offset, LEAST_CHANGE)
    return Chosen(contest, str(free), free, found) if sure.any() else None


def _tried(contest: Contest, free: Free, start: RigFound) -> Steps[RigFound]:
    """What is found with some numbers free; its predictions are in the contest then."""
    found = yield from share_of(fit_rig(contest.sample, free, start=start, rounds=ROUNDS), 0.1, 0.5)
    contest.add(str(free), (yield from share_of(contest.predictions(free, found), 0.1, 0.5)))
    return found


def _better(contest: Contest, name: str, other: str) -> bool:
    """Whether a rig predicts left-out views better: beyond the scatter, by what can be seen, and no worse to look at.

    Of radiance, root mean squares say little: they are those of highlights that a few texels make too sharp.
    """
    seen = contest.scale(name) < VISIBLY * contest.scale(other)
    one, two = contest.judge.error(name), contest.judge.error(other)
    return seen and one.lightness < two.lightness and contest.beats(name, other)


def _evened(sample: RigSample, first: RigFound) -> RigFound:
    """Where a fit of exposures begins: that of an automatic flash may be too far off for what disbelieves outliers."""
    gain = median_gains(sample, left_over(sample, first))
    if np.abs(gain).max(initial=0.0) < FAR:
        return first
    return replace(first, change=replace(first.change, log_gain=gain))


def _is_far(found: RigFound, limit: float = FARTHEST) -> bool:
    """Whether lamps would stand where they cannot."""
    return bool(np.linalg.norm(found.change.offset, axis=1).mean() > limit)


def _limit(sample: RigSample) -> float:
    return BESIDE if sample.rig.one_flash else FARTHEST


def _sure(found: RigFound) -> bool:
    """Whether a fit is sure of a curve."""
    change, error = found.change, found.error
    return change.log_shoulder < MOST_SHOULDER and any(abs(value) > max(SURE * by, LEAST_CURVE) for value, by in (
        (change.log_response, error.log_response), (change.log_shoulder, error.log_shoulder)))
