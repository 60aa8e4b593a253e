"""What the given rig and others predict of left-out views, highlights apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..data import F64
from ..evaluation.folds import Folds, Judge, rises, scatter
from ..evaluation.sampled_texels import predicted
from ..job import Steps, share_of
from .rig import RigChange
from .rig_fit import RigFound, beside_tilts, fit_rig
from .rig_numbers import CAUCHY, Free
from .rig_round import OUTLYING, in_common
from .rig_sample import RigSample
from .texel_materials import lobes_of, shown_by

SURE = 3.0  # standard errors from which on a number is changed, or a rig better
LEAST_ERROR = 0.002  # of the radiance: what a change must explain of left-out views ...
LEAST_BENT = 0.001  # ... and a response: base colours and powers hide most of it, but it bends highlights
HALF = 0.5
WORSE = 1.02  # ratio to which root mean squares, of radiance and L*, may rise in any case: of `rises`
HIGHLIGHT = 0.25  # of the radiance: lobes that show more make a highlight
LEAST_SEEN = 1e-6
# Of base colours.  What lights all views alike is a matter of power and base colours, which pictures do not separate: a
# flash that is right may make base colours larger than 1 where those of one that is wrong are not.
ANY = np.inf
GIVEN = "given"


class Contest:
    """What the given rig and others predict of left-out views, highlights apart."""

    def __init__(
        self, sample: RigSample, whole: RigFound, folds: Folds, tilts: bool = False, highlights: bool = False,
    ) -> None:
        """``whole``: with all numbers free, of all texels.  ``tilts``: texels' normals are their own numbers too.

        ``highlights``: they are judged too.
        """
        self.sample, self.folds, self.tilts = sample, folds, tilts
        self.judged = sample if highlights else diffuse_alone(sample, whole)
        odd = np.unique(sample.cluster, return_inverse=True)[1] % 2 == 1
        # Which texels each half has, what says its change, and what is judged:
        self.halves = [(half, sample.part(half), self.judged.part(half)) for half in (odd, ~odd)]
        self.judge = Judge(self.judged.texels, folds)
        self.left: dict[str, F64] = {}  # of each rig, (T, V): log of predicted over observed radiance, 0 if not judged
        self.add("lambert", [
            predicted(self.judged.texels, None, ~left_out, ANY) for left_out in folds.left_out])
        none = RigChange.none(len(sample.rig.groups), len(sample.rig.views))
        self.add(GIVEN, self._predicted(self.judged, replace(whole, change=none)))

    def add(self, name: str, predictions: list[F64]) -> None:
        """``predictions``: of each fold, (T, V, C) radiance over the given irradiance."""
        self.judge.add(name, predictions)
        shown = np.ones_like(self.sample.texels.cos_v)
        for left_out, prediction in zip(self.folds.left_out, predictions, strict=True):
            shown[:, left_out] = prediction[:, left_out].mean(-1)
        observed = self.judged.texels.reflected.mean(-1)
        known = self.judge.judged & (observed > 0) & (shown > 0)
        self.left[name] = np.log(np.where(known, shown, 1.0) / np.where(known, observed, 1.0))

    def predictions(self, free: Free, whole: RigFound) -> Steps[list[F64]]:
        """Under a change, as `add` takes them: of each half of the texels by what the other one found."""
        values = [np.zeros_like(self.sample.texels.reflected) for _ in self.folds.left_out]
        for n, ((_, half, _), (others, _, judged)) in enumerate(zip(self.halves, self.halves[::-1], strict=True)):
            found = yield from share_of(fit_rig(half, free, start=whole), n / 2, (n + 1) / 2)
            shown = self._predicted(judged, replace(found, materials=whole.materials))
            for value, of in zip(values, shown, strict=True):
                value[others] = of
        return values

    def of_whole(self, found: RigFound) -> list[F64]:
        """The same of both halves by what all texels found."""
        return self._predicted(self.judged, found)

    def _predicted(self, sample: RigSample, found: RigFound) -> list[F64]:
        """Of each fold, by the texels' own numbers that the other views say."""
        if self.tilts:
            return beside_tilts(sample, found, self.folds)
        seen = sample.geometry.under(found.change)
        lobes = lobes_of(sample, seen.texels, found.materials)
        return [seen.as_given(predicted(seen.texels, lobes, ~left_out, ANY)) for left_out in self.folds.left_out]

    def beats(self, name: str, other: str) -> bool:
        """Whether a rig predicts better than another, beyond the scatter."""
        return self.lead(name, other) > SURE

    def lead(self, name: str, other: str) -> float:
        """By how many standard errors a rig predicts better than another; 0 if they predict alike."""
        gain = self.gain(name, other)
        return float(gain.sum()) / max(scatter(gain, self.sample.cluster), LEAST_SEEN)

    def gain(self, name: str, other: str) -> F64:
        """(T,) by how much a rig predicts each texel better than another."""
        unit = CAUCHY * max(min(self.scale(name), self.scale(other)), LEAST_SEEN)
        return np.asarray((np.log1p((self.left[other] / unit) ** 2) - np.log1p((self.left[name] / unit) ** 2)).sum(1))

    def worth(self, free: Free, other: str) -> bool:
        """Whether a rig predicts better than a smaller one: beyond the scatter, and by what can be seen."""
        least = LEAST_BENT if free.response else LEAST_ERROR
        return self.beats(str(free), other) and self.shows(str(free), other, least)

    def shows(self, name: str, other: str, least: float = LEAST_ERROR) -> bool:
        """Whether a rig predicts better than another by what can be seen: so much of the radiance."""
        one, two = self.judge.candidates[name], self.judge.candidates[other]
        seen = self.scale(other) ** 2 - self.scale(name) ** 2 > least**2
        return seen and not rises(two, one, WORSE, self.sample.cluster)

    def leaves_half(self, name: str, free: Free) -> bool:
        """Whether a rig leaves less than half of what the given one does, of left-out views.

        ``free``: what it changes.  Where that is the place of the flash that all cameras carry and nothing else, less
        than half of what neighbours are off by in common is enough, which noise is not.  Three numbers mimic little of
        what a material's model lacks.  Ambient light beside them mimics a flash that is nearer.
        """
        place = self.sample.rig.one_flash and not (
            free.exposures or free.vignetting or free.ambient or free.response or free.shoulder)
        return self.scale(name) < HALF * self.scale(GIVEN) or (
            place and self._shared(name) < HALF * self._shared(GIVEN))

    def _shared(self, name: str) -> float:
        """What predictions of neighbouring texels are off by in common, relative."""
        left = self.left[name]
        return in_common(left, left != 0, self.sample.cluster, OUTLYING * self.scale(name))

    def scale(self, name: str) -> float:
        """Robust standard deviation of what a rig's predictions are off by, relative."""
        left = self.left[name][self.left[name] != 0]
        return 1.4826 * float(np.median(np.abs(left))) if len(left) else 0.0


def diffuse_alone(sample: RigSample, found: RigFound) -> RigSample:
    """The sample without what highlights make bright: where texels differ in roughness, those hide all else."""
    texels = sample.texels
    seen = sample.geometry.under(found.change).texels
    specular = shown_by(seen, lobes_of(sample, seen, found.materials))[1][..., 0]
    shown = np.maximum(seen.reflected.mean(-1), LEAST_SEEN)
    quality = np.where((specular < HIGHLIGHT * shown) & (sample.clarity > 0.5), texels.quality, 0.0)
    return sample.showing(replace(texels, quality=quality), sample.shade)
