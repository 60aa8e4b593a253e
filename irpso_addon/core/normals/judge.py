"""Whether a scene's normals are refined: only where left-out views are then predicted better.

Of a sample of texels, views are left out in turn.  The others say the tilt of each texel, and its base colour; what was
left out is then predicted under it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..calibration.texel_materials import lobes_of, materials_of
from ..data import F64, I32, Bool
from ..evaluation.folds import Folds, Judge, rises, scatter, split
from ..evaluation.joint_material import OneMaterial
from ..evaluation.sampled_texels import Lobes, SampledTexels, parts, predicted
from ..job import Progress, Steps, share_of
from .low_pass import common
from .tilt_fit import CAUCHY, Beside, TiltsFound, fit_tilts
from .tilt_sample import TiltSample

LEAST_TEXELS = 100
LEAST_VIEWS = 6  # good observations of a texel: fewer say nothing when a third is left out
LEAST_TILT = np.radians(0.15)  # standard deviation: less is not worth a map
SURE = 3.0  # standard errors
OUTLYING = 3.0  # standard deviations at which errors are cut off whose products are looked at
LEAST_ERROR = 0.005  # of the radiance: what refined normals must explain
BETTER = 3 / 4  # ratio to which the error must fall
WORSE = 1.02  # ratio to which the error of L* may rise in any case
HIGHLIGHT = 0.25  # of the radiance: lobes that show more make a highlight
LEAST_SEEN = 1e-6
PASSES = 2  # of tilts and roughnesses in turn
GIVEN, LARGE, ALL = "given", "large", "all"
FEW, NO_BETTER = "too few views show its texels", "refined ones predict left-out views no better"


@dataclass(frozen=True)
class NormalsJudged:
    """Normals that are worth refining."""

    materials: dict[int, OneMaterial]  # by slot, under the refined normals
    scatter: float  # relative: of the observations
    deviation: float  # standard deviation of a tilt, radians
    given: float  # as of RefinedNormals
    refined: float
    beside: Beside  # what is found of each texel beside its tilt; its roughness is found after it, but for reliefs
    large: bool = False  # whether what whole regions have in common is kept


def too_few(texels: SampledTexels) -> bool:
    """Whether too few texels have enough observations for anything to be said of normals."""
    return int(np.count_nonzero(_judged(texels))) < LEAST_TEXELS


def _judged(texels: SampledTexels) -> Bool:
    return np.asarray(texels.usable().sum(1) >= LEAST_VIEWS)


def judge_normals(sample: TiltSample) -> Steps[NormalsJudged | str]:
    """What is to be refined; or why the normals stay as they are given.

    Where a material has paints of several roughnesses, tilts take up a part of them if one roughness is held while
    they are found.  Where a reflection is not the model's, a roughness beside each tilt takes up a part of that.
    Prediction decides.
    """
    if too_few(sample.texels):
        return FEW
    sample = sample.part(_judged(sample.texels))
    folds, texels = split(sample.texels), sample.texels
    if folds is None:
        return FEW
    yield Progress(0.0, "normals", "shading normals")
    given = _lobes(sample, texels, materials_of(sample.rig, texels, not sample.rig.scale_known))
    best: _Contest | None = None
    for n, beside in enumerate((Beside.NOTHING, Beside.ROUGHNESS)):
        fitted = yield from share_of(_fitted(sample, given, beside), 0.5 * n, 0.5 * n + 0.2)
        if fitted is None:
            if beside is Beside.NOTHING:
                return "they explain the views"
            break
        contest = _Contest(sample, given, fitted, folds)
        for fold, left_out in enumerate(folds.left_out):
            contest.predict(~left_out)
            yield Progress(0.5 * n + 0.2 + 0.3 * (fold + 1) / len(folds.left_out), "normals")
        if contest.worth_it() and (best is None or contest.beats(best)):
            best = contest
            if sample.worlds is not None:  # soft light hardly tells how rough each texel is
                break
    if best is None:
        return NO_BETTER
    return best.judged_normals()


@dataclass(frozen=True)
class _Fitted:
    """What all views say of a sample."""

    beside: Beside
    materials: dict[int, OneMaterial]
    lobes: Lobes
    tilts: TiltsFound


def _fitted(sample: TiltSample, given: Lobes, beside: Beside) -> Steps[_Fitted | None]:
    """Tilts, and the materials under them; None: they are too small to matter."""
    found = fit_tilts(sample, given, beside=beside)
    if found.deviation() < LEAST_TILT:
        return None
    for n in range(PASSES):
        yield Progress(n / PASSES, "normals")
        tilt = found.under(found.deviation())[0]
        seen = sample.tilted(tilt)[0]
        materials = materials_of(sample.rig, seen, not sample.rig.scale_known)
        lobes = _lobes(sample, seen, materials)
        found = fit_tilts(sample, lobes, start=tilt, beside=beside)
    return _Fitted(beside, materials, lobes, found)


def large_scale(sample: TiltSample, tilt: F64) -> F64:
    """(T, 2) what the tilts of regions, and of like normals, have in common."""
    rig = sample.rig
    return sample.in_plane(common(rig.position, rig.normal, sample.offset(tilt), np.ones(len(tilt))))


def _lobes(sample: TiltSample, texels: SampledTexels, materials: dict[int, OneMaterial]) -> Lobes:
    return lobes_of(sample.rig, texels, materials)


class _Contest:
    """What given and refined normals predict of left-out views, highlights apart."""

    def __init__(self, sample: TiltSample, given: Lobes, fitted: _Fitted, folds: Folds) -> None:
        self.sample, self.given, self.fitted, self.folds = sample, given, fitted, folds
        self.lobes, whole = fitted.lobes, fitted.tilts
        self.start = whole.under(whole.deviation())[0]
        texels = sample.texels
        self.judged = replace(texels, quality=np.where(self._highlights(), 0.0, texels.quality))
        self.judge = Judge(self.judged, folds)
        self.predictions: dict[str, list[F64]] = {"lambert": [], GIVEN: [], LARGE: [], ALL: []}
        self.left: dict[str, F64] = {}
        self.nearest = _nearest(sample.rig.position)

    def _highlights(self) -> np.ndarray:
        texels = self.sample.texels
        shown = np.maximum(texels.reflected.mean(-1), LEAST_SEEN)
        seen, more = self.sample.tilted(self.start)
        return np.asarray((parts(texels, self.given)[1][..., 0] > HIGHLIGHT * shown)
                          | (parts(seen, self.lobes)[1][..., 0] * more > HIGHLIGHT * shown))

    def predict(self, known: np.ndarray) -> None:
        """One fold."""
        sample = self.sample
        self.predictions["lambert"].append(predicted(self.judged, None, known))
        self.predictions[GIVEN].append(predicted(self.judged, self.given, known))
        found = fit_tilts(sample, self.lobes, known, self.start, beside=self.fitted.beside)
        tilt = found.under(found.deviation())[0]
        for name, tilts in ((LARGE, large_scale(sample, tilt)), (ALL, tilt)):
            seen, more = sample.tilted(tilts)
            quality = np.where(self.judged.quality > 0, seen.quality, 0.0)
            shown = predicted(replace(seen, quality=quality), self.lobes, known)
            self.predictions[name].append(shown * more[..., None])

    def worth_it(self) -> bool:
        """Whether refined normals predict better than given ones, and than what whole regions have in common."""
        for name, predictions in self.predictions.items():
            self.judge.add(name, predictions)
            self.left[name] = self._left(predictions)
        return self._worth(ALL, GIVEN, 1.0) and self._worth(ALL, LARGE, BETTER)

    def beats(self, other: _Contest) -> bool:
        """Whether under these refined normals texels next to each other are off by less in common, beyond the scatter.

        Noise, which they do not share, hides the difference in all that they are off by.
        """
        most = OUTLYING * self.scale(GIVEN)
        both = (self.left[ALL] != 0) & (other.left[ALL] != 0)
        mine, others = (np.clip(contest.left[ALL], -most, most) * both for contest in (self, other))
        gain = (others * others[self.nearest] - mine * mine[self.nearest]).sum(1)
        return bool(gain.sum() > scatter(gain, self.sample.rig.cluster))

    def judged_normals(self) -> NormalsJudged:
        """What all views say, and what it predicts of left-out ones."""
        tilts = self.fitted.tilts
        return NormalsJudged(self.fitted.materials, tilts.scatter, tilts.deviation(), self.scale(LARGE),
                             self.scale(ALL), self.fitted.beside)

    def scale(self, name: str) -> float:
        """Robust standard deviation of what predictions are off by, relative."""
        seen = self.left[name][self.left[name] != 0]
        return 1.4826 * float(np.median(np.abs(seen))) if len(seen) else 0.0

    def _left(self, predictions: list[F64]) -> F64:
        """(T, V) log of predicted over observed radiance; 0 where it is not judged."""
        shown = np.ones_like(self.sample.texels.cos_v)
        for left_out, prediction in zip(self.folds.left_out, predictions, strict=True):
            shown[:, left_out] = prediction[:, left_out].mean(-1)
        observed = self.judged.reflected.mean(-1)
        known = self.judge.judged & (observed > 0) & (shown > 0)
        return np.asarray(np.log(np.where(known, shown, 1.0) / np.where(known, observed, 1.0)))

    def _worth(self, name: str, other: str, ratio: float) -> bool:
        """Whether one predicts better than another: beyond the scatter, and by what can be seen.

        All that they are off by may say so, or that which is no noise: noise may be most of it.
        """
        candidates, cluster = self.judge.candidates, self.sample.rig.cluster
        return not rises(candidates[other], candidates[name], WORSE, cluster) and any(
            gain.sum() > SURE * scatter(gain, cluster) and after < ratio * before
            and before**2 - after**2 > LEAST_ERROR**2
            for gain, after, before in (self._whole(name, other), self._in_common(name, other)))

    def _whole(self, name: str, other: str) -> tuple[F64, float, float]:
        """(T,) by how much one predicts better than another, and what the two are off by."""
        after, before = self.scale(name), self.scale(other)
        unit = CAUCHY * max(after, LEAST_SEEN)
        gain = (np.log1p((self.left[other] / unit) ** 2) - np.log1p((self.left[name] / unit) ** 2)).sum(1)
        return gain, after, before

    def _in_common(self, name: str, other: str) -> tuple[F64, float, float]:
        """The same of what two texels next to each other are off by in common, which noise is not."""
        most = OUTLYING * self.scale(other)

        def products(each: str) -> F64:
            left = np.clip(self.left[each], -most, most)
            return np.asarray(left * left[self.nearest])

        after, before = products(name), products(other)
        return (before - after).sum(1), _root_mean(after), _root_mean(before)


def _root_mean(products: F64) -> float:
    """Of those that are known, which are not 0."""
    known = products[products != 0]
    return float(np.sqrt(max(float(known.mean()), 0.0))) if len(known) else 0.0


def _nearest(position: F64) -> I32:
    """(T,) of each of (T, 3) places the one that is next to it."""
    middle = position - position.mean(0)
    square = (middle**2).sum(-1)
    apart = square[:, None] + square - 2 * middle @ middle.T
    np.fill_diagonal(apart, np.inf)
    return np.asarray(apart.argmin(1), np.int32)
