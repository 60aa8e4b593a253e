"""Tints from how the colours of texels differ from view to view.

The logarithm of what a texel reflects diffusely in a channel, less its mean over the channels, is the texel's own
colour plus the tint of what lights it and that of the picture, whatever its roughness and wherever the lamps stand.
The texels' own colours are eliminated, and the tints are linear in what is left.  Cauchy weights, a prior about what is
given, and clusters of neighbouring texels, as in rig_fit.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..change_records import PredictionError
from ..data import F64, I32, Bool
from ..evaluation.folds import Folds, Judge, scatter
from ..evaluation.sampled_texels import predicted
from .contest import GIVEN, HIGHLIGHT, LEAST_ERROR, SURE
from .rig_fit import RigFound
from .rig_numbers import CAUCHY, MEAN
from .rig_sample import COLOURS, RigSample
from .texel_materials import lobes_of, shown_by

TINT = 0.1  # what a lamp or a picture is off by: of the logarithm of a channel
LEAST_SCATTER = 1e-4
LEAST = 1e-12
ROUNDS = 4
TINTED = "tinted"


@dataclass(frozen=True)
class Tinted:
    """What may have G tints: the lamps of a rig, or its views."""

    free: Bool  # (G,) which may be changed
    share: Callable[[RigSample, int], tuple[list[int], F64]]  # of a view: tints, and (T, n) their shares in it
    brighter: Callable[[RigSample, F64], F64]  # (T, V, C) of radiance under tints over that under the given ones
    corrected: Callable[[RigSample, F64], RigSample]  # a sample as if these tints were given
    typical: Callable[[F64], F64]  # (3,) what stays as it is given, of the tints: nothing tells what all share


class ColourFit:
    """Colours of T texels in V views, and the tints that they are seen under."""

    def __init__(self, sample: RigSample, first: RigFound, tinted: Tinted) -> None:
        texels = sample.texels
        specular = shown_by(texels, lobes_of(sample, texels, first.materials))[1]
        places, layers = np.unique(sample.view, return_index=True)
        self.tinted = tinted
        self.first: I32 = layers.astype(np.int32)  # of each view's layers
        shown = np.stack([
            texels.reflected[:, sample.view == place].reshape(len(texels.reflected), -1) for place in places], 1)
        specular = specular[:, layers]
        below = np.maximum(shown - specular, 0.0)
        good = texels.usable()[:, layers] & (specular[..., 0] < HIGHLIGHT * np.maximum(shown.mean(-1), LEAST))
        good &= (below > HIGHLIGHT * np.maximum(shown, LEAST)).all(-1)
        # (T, V, 3) what texels reflect, and (T, V, 1) what of it is specular and has no colour of theirs
        self.shown: F64 = np.where(good[..., None], shown, 1.0)
        self.specular: F64 = np.where(good[..., None], specular, 0.0)
        share = np.where(good[..., None], below / np.maximum(shown, LEAST), 0.0).min(-1)
        self.weight: F64 = share**2  # (T, V)
        self.groups, self.cluster = len(tinted.free), _numbered(sample.cluster)
        self.share = [tinted.share(sample, int(place)) for place in places]

    def fit(self, texels: Bool | None = None) -> tuple[F64, F64]:
        """(G, 3) tints, and (G,) their standard errors; ``texels``: the only ones to count."""
        free = self.tinted.free
        weight = self.weight if texels is None else self.weight * texels[:, None]
        robust, tints, error = weight, np.zeros((self.groups, COLOURS)), np.zeros(self.groups)
        count = int(free.sum())
        prior = np.eye(count) / TINT**2 + (1 / (MEAN * count) ** 2 if free.all() else 0.0)
        for _ in range(ROUNDS):
            left = self.left(tints, robust)
            scale = _scale(left, weight > 0)
            robust = weight / (1 + (left**2).mean(-1) / (CAUCHY * scale) ** 2)
            normal, pull, alike = self._sums(robust, self.left(tints, robust))
            information = normal[np.ix_(free, free)] / (alike * scale**2) + prior
            covariance = np.linalg.inv(information)
            step = covariance @ (pull[free] / (alike * scale**2) - prior @ tints[free])
            tints[free] += step
            error[free] = np.sqrt(covariance.diagonal())
        if free.all():
            tints -= self.tinted.typical(tints)
            tints -= tints.mean(1, keepdims=True)
        return tints, error

    def left(self, tints: F64, weight: F64, known: Bool | None = None) -> F64:
        """(T, V, 3) colours less tints and the texels' own colours, which the ``known`` views (V,) show."""
        white = self.shown / np.exp(np.stack([lit @ tints[groups] for groups, lit in self.share], 1))
        value = np.log(np.maximum(white - self.specular, LEAST))
        value -= value.mean(-1, keepdims=True)
        weight = weight if known is None else weight * known
        own = (weight[..., None] * value).sum(1) / np.maximum(weight.sum(1), LEAST)[:, None]
        return np.asarray(value - own[:, None])

    def _sums(self, weight: F64, left: F64) -> tuple[F64, F64, float]:
        """Normal matrix (G, G) without own colours, gradient (G, 3), and observations for one that is independent."""
        G, clusters = self.groups, int(self.cluster.max()) + 1
        normal, pull = np.zeros((G, G)), np.zeros((G, COLOURS))
        own, total = np.zeros((len(weight), G)), np.maximum(weight.sum(1), LEAST)
        scores = np.zeros((G, clusters, COLOURS))
        for v, (groups, lit) in enumerate(self.share):
            weighted = weight[:, v, None] * lit
            np.add.at(normal, np.ix_(groups, groups), lit.T @ weighted)
            for n, group in enumerate(groups):
                own[:, group] += weighted[:, n]
                score = weighted[:, n, None] * left[:, v]
                pull[group] += score.sum(0)
                for channel in range(COLOURS):
                    scores[group, :, channel] += np.bincount(self.cluster, score[:, channel], minlength=clusters)
        normal -= own.T @ (own / total[:, None])
        scale = _scale(left, weight > 0)
        ratio = (scores**2).sum(1).mean(-1) / np.maximum(normal.diagonal() * scale**2, LEAST)
        return normal, pull, max(float(np.median(ratio)), 1.0)


def _numbered(values: I32) -> I32:
    """From 0 on, without gaps."""
    return np.unique(values, return_inverse=True)[1].astype(np.int32)


def _scale(left: F64, known: Bool) -> float:
    """Robust standard deviation."""
    return 1.4826 * float(np.median(np.abs(left[known]))) + LEAST_SCATTER if known.any() else 1.0


class ColourContest:
    """Left-out views under given colours and under those that the other half of the texels finds."""

    def __init__(self, sample: RigSample, first: RigFound, folds: Folds, colours: ColourFit) -> None:
        self.sample, self.first, self.folds, self.colours = sample, first, folds, colours

    def better(self) -> bool:
        """Whether they are predicted better, beyond the scatter, and by what can be seen."""
        colours, odd = self.colours, self.colours.cluster % 2 == 1
        halves = [(half, colours.fit(~half)[0]) for half in (odd, ~odd)]
        given, changed = (np.zeros_like(colours.shown) for _ in range(2))
        known = colours.weight > 0  # and so in other views, which say the texel's own colour
        for left_out in self.folds.left_out:
            out = left_out[colours.first]
            known[:, out] &= known[:, ~out].any(1, keepdims=True)
            given[:, out] = colours.left(np.zeros((colours.groups, COLOURS)), colours.weight, ~out)[:, out]
            for half, tints in halves:
                own = colours.left(tints, colours.weight, ~out)
                changed[np.ix_(half, out)] = own[np.ix_(half, out)]
        before, after = _scale(given, known), _scale(changed, known)
        unit = CAUCHY * min(before, after)
        gain = np.log1p((given / unit) ** 2) - np.log1p((changed / unit) ** 2)
        texel = np.where(known, gain.sum(-1), 0.0).sum(1)
        return bool(texel.sum() > SURE * scatter(texel, colours.cluster)
                    and before**2 - after**2 > LEAST_ERROR**2)

    def errors(self, tints: F64) -> tuple[PredictionError, PredictionError]:
        """Of left-out views, as given and under ``tints``."""
        texels, lobes = self.sample.texels, lobes_of(self.sample, self.sample.texels, self.first.materials)
        tinted = self.colours.tinted
        judge, brighter = Judge(texels, self.folds), tinted.brighter(self.sample, tints)
        under = tinted.corrected(self.sample, tints).texels
        judge.add("lambert", [predicted(texels, None, ~out) for out in self.folds.left_out])
        judge.add(GIVEN, [predicted(texels, lobes, ~out) for out in self.folds.left_out])
        judge.add(TINTED, [predicted(under, lobes, ~out) * brighter for out in self.folds.left_out])
        return judge.error(GIVEN), judge.error(TINTED)
