"""Views whose exposure is far off, as an automatic flash or automatic brightness makes it: found before all else.

The fit of a rig disbelieves observations that depart from all others, and with them such a view as a whole.  So its
exposure is first taken from what it shows of texels that other views show too, by medians (median polish: Tukey,
Exploratory Data Analysis, 1977), and then fitted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..data import F64
from ..evaluation.folds import Folds
from ..evaluation.sampled_texels import median_of_known
from ..job import Steps, share_of
from .contest import GIVEN, HALF, SURE, Contest
from .rig import RigChange
from .rig_fit import ROUNDS, RigFound, fit_rig, left_over
from .rig_numbers import Free
from .rig_sample import RigSample

FAR = 0.25  # logarithm of the largest gain: powers and places of lamps that are honestly off make less
# Where no model explains the pictures, of what left-out views are off by: what gains may leave, robust and of L*.
CLEAR, CLEAR_LIGHTNESS = 0.65, 0.9
TAKEN = 0.15  # and of the others that are then taken
POLISHED = 12  # rounds of medians
LEAST_SHARED = 30  # texels that a view shares with others


@dataclass(frozen=True)
class FarExposures:
    """The gains of views that are far off."""

    found: RigFound  # of these gains alone
    free: Free
    given: PredictionError  # of left-out views, as the scene is given
    changed: PredictionError

    def evened(self, sample: RigSample) -> RigSample:
        """A sample as if its views had these exposures."""
        gain = self.found.change.log_gain
        views = tuple(replace(view, gain=view.gain * float(np.exp(by)))
                      for view, by in zip(sample.rig.views, gain, strict=True))
        evened = np.exp(-gain)[sample.view][None, :, None]
        return replace(sample, texels=replace(sample.texels, reflected=sample.texels.reflected * evened),
                       rig=replace(sample.rig, views=views),
                       shade=None if sample.shade is None else sample.shade * evened)

    def with_gains(self, change: RigChange) -> RigChange:
        """A change of the evened rig as one of the given rig."""
        return replace(change, log_gain=change.log_gain + self.found.change.log_gain)

    def with_errors(self, error: RigChange) -> RigChange:
        """Its standard errors."""
        own = self.found.error.log_gain
        return replace(error, log_gain=np.where(error.log_gain > 0, error.log_gain, own))


def far_exposures(
    sample: RigSample, folds: Folds, first: RigFound, unexplained: bool = False,
) -> Steps[FarExposures | None]:
    """The gains that are far off beyond doubt, if left-out views are predicted better with them.

    ``first``: the materials of the sample.  The typical view keeps its exposure, as in `fit_rig`.  ``unexplained``: no
    model explains the pictures.  Then gains need not halve the error, but must win clearly, see `_wins`.
    """
    free = Free(False, True, levels=not sample.scale_known)
    gains = sample.geometry.gains
    if gains is None:
        gains = sample.geometry.gains = median_gains(sample, left_over(sample, first))
    if np.abs(gains).max(initial=0.0) < FAR:
        return None
    none = RigChange.none(len(sample.rig.groups), len(sample.rig.views))
    start = replace(first, change=replace(none, log_gain=gains))
    found = yield from share_of(fit_rig(sample, free, start=start, rounds=ROUNDS), 0.02, 0.05)
    gain, error = found.change.log_gain, found.error.log_gain
    far = np.abs(gain) > np.maximum(SURE * error, TAKEN)
    if np.abs(gain[far]).max(initial=0.0) < FAR:
        return None
    contest = Contest(sample, found, folds)
    contest.add(str(free), (yield from share_of(contest.predictions(free, found), 0.05, 0.1)))
    given, changed = contest.judge.error(GIVEN), contest.judge.error(str(free))
    if not contest.beats(str(free), GIVEN):
        return None
    # Lamps that stand elsewhere make views brighter or darker too.
    if changed.lightness >= HALF * given.lightness and not (unexplained and (yield from _wins(contest, free))):
        return None
    alone = replace(none, log_gain=np.where(far, gain, 0.0))
    return FarExposures(replace(found, change=alone, error=replace(none, log_gain=np.where(far, error, 0.0))), free,
                        given, changed)


def _wins(contest: Contest, free: Free) -> Steps[bool]:
    """Whether gains predict left-out views clearly better where no model does, and better than what else might.

    That is lamps that stand elsewhere, a diffuse that is not Lambert's, and pictures that are darker at their edges.
    Where what is left is more than half of the radiance, as on crumpled foil, gains say nothing of exposures.
    """
    name, none = str(free), replace(free, exposures=False)
    given, changed = contest.judge.error(GIVEN), contest.judge.error(name)
    if given.fits or changed.lightness > CLEAR_LIGHTNESS * given.lightness or not contest.shows(name, GIVEN):
        return False
    if contest.scale(name) > min(HALF, CLEAR * contest.scale(GIVEN)):
        return False
    for rival in (replace(none, lamps=True), replace(none, diffuse=True), replace(none, vignetting=True)):
        found = yield from share_of(fit_rig(contest.sample, rival), 0.1, 0.1)
        contest.add(str(rival), (yield from share_of(contest.predictions(rival, found), 0.1, 0.1)))
        if not contest.beats(name, str(rival)):
            return False
    return True


def median_gains(sample: RigSample, left: F64) -> F64:
    """(V,) logarithms of what each view shows over what the others do of the same texels, by medians; 0: unknown.

    ``left``: as of `left_over`.
    """
    channel, views = sample.texels.channel, len(sample.rig.views)
    seen = np.isfinite(left)
    own = [(layers := sample.view == view, seen[:, layers]) for view in range(views)]
    known = np.array([there.any(1).sum() >= LEAST_SHARED for _, there in own], bool)
    gain, some = np.zeros(views), [(seen[:, channel == one].any(1), channel == one) for one in np.unique(channel)]
    for _ in range(POLISHED if known.any() else 0):
        rest = left - gain[sample.view]
        for texels, same in some:
            rest[np.ix_(texels, same)] -= median_of_known(rest[np.ix_(texels, same)])[:, None]
        for view in np.flatnonzero(known):
            layers, there = own[view]
            gain[view] += np.median(rest[:, layers][there])
        gain -= np.median(gain[known])
    return np.where(known, gain, 0.0)
