"""Prediction by folds: lamps (or cameras) are left out in turn, and what they should have shown is predicted.

Evidence inside a fit cannot see that a model is wrong in a systematic way: the fit bends the model's numbers until the
observations are explained.  What was left out cannot be bent to.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..change_records import PredictionError
from ..data import F64, I32, Bool
from .sampled_texels import SampledTexels

FOLDS = 3  # at least
MOST_FOLDS = 6  # each takes its time
MANY = 1.5  # ratio of the variances for many observations, a third left out
LEAST_SETS = 3  # of lamps, or cameras: with fewer, leaving one out leaves too little
LEAST_KNOWN = 2  # good observations that a texel keeps where it is predicted
WHITE = 99.5  # per cent of the radiances that lie below white
LEAST_CLUSTERS = 8  # fewer are too few to leave one's errors out
ALIKE = 0.05, 0.08  # of the loss, by which a smaller model may be worse: the scatter, but between these


@dataclass(frozen=True)
class Folds:
    """Which layers are left out in each fold."""

    left_out: tuple[Bool, ...]  # (V,) each
    of: str  # "lamps" or "cameras"


@dataclass(frozen=True)
class Candidate:
    """What one model predicted of every layer when it was left out."""

    squares: F64  # (T,) of errors of radiance, as far as observations are to be trusted
    lightness: F64  # (T,) the same of L*


def split(texels: SampledTexels, numbers: int = 1) -> Folds | None:
    """Every third set of lamps, or camera where there are too few sets; None where there are too few of both.

    ``numbers``: that a fit finds in each texel.  Of few observations, a smaller part is left out; otherwise such a fit
    looks worse than it is.  Its variance with n observations goes as 1 / (n - numbers): one part in 2 n / (n - numbers)
    doubles it.
    """
    known = texels.typical_observations()
    wanted = int(np.clip(np.ceil(2 * known / max(known - numbers, 1e-9)), FOLDS, MOST_FOLDS))
    for of, labels in (("lamps", texels.lamps), ("cameras", texels.camera)):
        names = np.unique(labels)
        if len(names) >= LEAST_SETS:
            count = min(wanted, len(names))
            return Folds(tuple(np.isin(labels, names[k::count]) for k in range(count)), of)
    return None


class Judge:
    """Collects what candidates predict, and says which one is to be taken.  The first must have no lobe.

    Where a picture is dark though the scene says that it is lit, nobody can be blamed for the diffuse.  But a lobe that
    flashes there is an error: normals and shadows that are off put it in the wrong place.
    """

    def __init__(self, texels: SampledTexels, folds: Folds, clusters: I32 | None = None) -> None:
        """``clusters``: (T,) groups of neighbouring texels, which err alike; None: each texel is one."""
        self.texels, self.folds = texels, folds
        self.clusters = np.arange(len(texels.cos_v), dtype=np.int32) if clusters is None else clusters
        self.radiance = texels.reflected * texels.irradiance
        usable = texels.usable()
        self.white = float(np.percentile(self.radiance[usable], WHITE)) if usable.any() else 1.0
        self.judged: Bool = np.zeros_like(usable)  # (T, V) that count in all candidates alike
        self.dark: Bool = np.zeros_like(usable)  # (T, V) in shadows that the scene does not explain
        self.bounded: Bool = np.zeros_like(usable)  # (T, V) clipped: brighter is no error
        for left_out in folds.left_out:
            for channel in np.unique(texels.channel):  # each is known by its own layers alone
                own = texels.channel == channel
                enough = (usable & ~left_out & own).sum(1) >= LEAST_KNOWN
                here = left_out & own & enough[:, None]
                self.judged |= usable & here
                self.dark |= (texels.quality > 0) & ~usable & here
                if texels.clipped is not None:
                    self.bounded |= (texels.clipped > 0) & here
        # A pixel may show a place far from the texel, behind a bump: it then says little of what the texel should show.
        told = self.judged | self.dark | self.bounded
        self.weight = np.where(told, texels.trust(), 0.0)  # (T, V) of squared errors
        self.plain = np.zeros_like(self.radiance)  # what the first candidate predicts
        self.candidates: dict[str, Candidate] = {}

    def add(self, name: str, predictions: Sequence[F64]) -> None:
        """``predictions``: (T, V, C) radiance / irradiance of each fold, of which the layers left out count."""
        value = np.zeros_like(self.radiance)
        for left_out, prediction in zip(self.folds.left_out, predictions, strict=True):
            value[:, left_out] = prediction[:, left_out]
        self.add_apart(name, value)

    def add_apart(self, name: str, value: F64) -> None:
        """``value``: (T, V, C) radiance / irradiance that is predicted of each layer in the fold that leaves it out."""
        if not self.candidates:
            self.plain = value * self.texels.irradiance
        self.candidates[name] = self._errors(value, np.ones(len(self.texels.camera), bool))

    def hopeful(self, predictions: Mapping[str, F64], names: Iterable[str], margin: float) -> list[str]:
        """Of some candidates, those whose loss in the first fold alone exceeds the least by no more than ``margin``.

        ``predictions``: (T, V, C) of the first fold, as of `add`, of those and of others to compare them with.
        """
        left_out = self.folds.left_out[0]
        errors = {name: self._errors(value, left_out) for name, value in predictions.items()}
        total = {name: float(values.sum()) for name, values in _losses(errors, self.clusters).items()}
        return [name for name in names if total[name] <= (1 + margin) * min(total.values())]

    def _errors(self, value: F64, layers: Bool) -> Candidate:
        """Of ``value``, (T, V, C) radiance / irradiance, in some layers, (V,)."""
        off, light = self.off(value, layers)
        return Candidate((off**2).sum((1, 2)), (light**2).sum((1, 2)))

    def off(self, value: F64, layers: Bool) -> tuple[F64, F64]:
        """(T, V, C) each: errors of radiance and of L*, of which a candidate holds the sums of squares."""
        value, judged = value * self.texels.irradiance, (self.judged & layers)[..., None]
        off = np.where(judged, value - self.radiance, 0.0)
        off += np.where((self.dark & layers)[..., None], np.maximum(value - self.plain, 0.0), 0.0)
        light = np.where(judged, lightness(value / self.white) - lightness(self.radiance / self.white), 0.0)
        if (bounded := self.bounded & layers).any():
            shown, least = value[bounded], self.radiance[bounded]
            off[bounded] = np.minimum(shown - least, 0.0)
            light[bounded] = np.minimum(lightness(shown / self.white) - lightness(least / self.white), 0.0)
        root = np.sqrt(self.weight)[..., None]
        return root * off, root / np.sqrt(light.shape[2]) * light

    def error(self, name: str) -> PredictionError:
        """Of a candidate, over all that was left out; `limited`: of the surface, not of one place.

        Errors and radiance alike: else one mirrored lamp, most of the radiance, hides that nothing is predicted.
        """
        candidate = self.candidates[name]
        squares, light = (
            float(limited(of, self.clusters).sum()) for of in (candidate.squares, candidate.lightness))
        weight = np.where(self.judged | self.bounded, self.weight, 0.0)
        shown = (weight[..., None] * self.radiance**2).sum((1, 2))
        signal = float(limited(shown, self.clusters).sum())
        return PredictionError(float(np.sqrt(squares / max(signal, 1e-30))),
                               float(np.sqrt(light / max(float(weight.sum()), 1e-30))))

    def choose(self, families: Sequence[Sequence[str]]) -> str:
        """The best of the smallest family that predicts about as well as the best one.

        ``families``: names of candidates, from the smallest models on.  Both errors count, each relative to the least:
        lightness alone misses the texel that may flash under another lamp, radiance alone the body of dark things.
        Only candidates that are `no_worse_than_plain` count, and the first.
        """
        loss = self._losses()
        total = {name: float(values.sum()) for name, values in loss.items()}
        fine = [[name for name in family if name == families[0][0] or self.no_worse_than_plain(name)]
                for family in families]
        firsts = [min(family, key=lambda name: total[name]) for family in fine if family]
        best = min(firsts, key=lambda name: total[name])
        for name in firsts:
            spread = scatter(loss[name] - loss[best], self.clusters) / total[best]
            if total[name] <= (1 + min(max(spread, ALIKE[0]), ALIKE[1])) * total[best]:
                return name
        return best

    def no_worse_than_plain(self, name: str) -> bool:
        """Whether neither of a candidate's errors is larger than the first candidate's."""
        one, plain = self.error(name), self.error(next(iter(self.candidates)))
        return one.relative_rms <= plain.relative_rms and one.lightness <= plain.lightness

    def spared(self, numbers: int) -> float:
        """Of its loss: by so much folds make a fit of so many numbers a texel look worse than with many observations.

        Its variance with n observations goes as 1 / (n - numbers).
        """
        count = self.texels.typical_observations()
        kept = count * (1 - 1 / len(self.folds.left_out))
        return max((count - numbers) / max(kept - numbers, 0.5) - MANY, 0.0)

    def stays(self, name: str, margin: float) -> bool:
        """Whether a candidate's loss is no larger than the first's, nor than the least by more than so much of it."""
        total = {other: float(values.sum()) for other, values in self._losses().items()}
        return total[name] <= min(next(iter(total.values())), (1 + margin) * min(total.values()))

    def excuses(self, name: str, numbers: int, one_value: str | None) -> bool:
        """Whether a fit of so many numbers a texel may stay for what it is `spared`.

        ``one_value``: the candidate that is to be taken else, where it has one value for all texels.  If that also
        predicts lightness no worse, texels do not differ, and what the fit finds in them are false lobes.
        """
        if one_value is not None and self.error(one_value).lightness <= self.error(name).lightness:
            return False
        spared = self.spared(numbers)
        return spared > 0 and self.stays(name, spared)

    def near(self, names: Sequence[str], margin: float) -> list[str]:
        """Candidates among them whose loss is larger than the least of theirs by no more than so much of it."""
        total = {name: float(values.sum()) for name, values in self._losses().items() if name in names}
        return [name for name in names if name in total and total[name] <= (1 + margin) * min(total.values())]

    def leads(self, name: str, margin: float, among: Iterable[str]) -> bool:
        """Whether a candidate's loss is smaller than all others' of some by so much of its own."""
        total = {other: float(values.sum()) for other, values in self._losses().items()}
        return name in total and all(total[name] * (1 + margin) < total[other] for other in among if other != name)

    def _losses(self) -> dict[str, F64]:
        """(T,) of each candidate: both squared errors, each relative to the least of them."""
        return _losses(self.candidates, self.clusters)


def _losses(candidates: Mapping[str, Candidate], clusters: I32) -> dict[str, F64]:
    both = {name: (limited(c.squares, clusters), limited(c.lightness, clusters)) for name, c in candidates.items()}
    least = [max(min(float(of[part].sum()) for of in both.values()), 1e-30) for part in (0, 1)]
    return {name: squares / least[0] + lightness / least[1] for name, (squares, lightness) in both.items()}


def limited(values: F64, clusters: I32) -> F64:
    """(T,) values >= 0, of which no cluster has more than all others: one place's luck chooses no model.

    Of fewer than LEAST_CLUSTERS, no texel has more than all others.
    """
    of = _places(clusters)
    sums = np.bincount(of, values)
    most = int(sums.argmax()) if len(sums) else 0
    others = float(sums.sum() - sums[most]) if len(sums) > 1 else np.inf
    return values if others >= sums.max(initial=0.0) else np.where(of == most, values * (others / sums[most]), values)


def _places(clusters: I32) -> I32:
    """(T,) indices of clusters; of texels where there are few clusters."""
    _, of = np.unique(clusters, return_inverse=True)
    few = of.max(initial=0) + 1 < LEAST_CLUSTERS
    return np.asarray(np.arange(len(of)) if few else of, np.int32)


def scatter(values: F64, clusters: I32) -> float:
    """Standard error of the sum of (T,) values, whose clusters are independent."""
    _, of = np.unique(clusters, return_inverse=True)
    sums = np.bincount(of, values)
    return float(np.sqrt(len(sums)) * sums.std()) if len(sums) > 1 else 0.0


def rises(before: Candidate, after: Candidate, ratio: float, clusters: I32) -> bool:
    """Whether a root mean square, of radiance or of L*, rises by more than a ratio and beyond its scatter.

    A few texels in highlights can have most of the error of radiance: what one place does shows no rise.
    """
    of = _places(clusters)
    for old, new in ((before.squares, after.squares), (before.lightness, after.lightness)):
        each = np.bincount(of, new - old)
        others = np.where(of == each.argmax(), 0.0, new - old)
        rise = float(others.sum())
        if rise > (ratio**2 - 1) * old.sum() and rise > scatter(others, clusters):
            return True
    return False


def lightness(relative: F64) -> F64:
    """CIE L* of luminance relative to white, 0 to 1 (CIE 15:2004, eq. 8.1)."""
    y = np.clip(relative, 0.0, 1.0)
    value: F64 = np.where(y > 216 / 24389, 116 * np.cbrt(y) - 16, y * 24389 / 27)
    return value

