"""Colours of lamps that the scene has wrong, from how the colours of texels differ from lamp to lamp.

The logarithm of what a texel reflects diffusely in a channel, less its mean over the channels, is the texel's own
colour plus the tint of what lights it, whatever its roughness and wherever the lamps stand.  The texels' own colours
are eliminated, and the lamps' tints are linear in what is left.  Cauchy weights, a prior about what is given, and
standard errors from clusters of neighbouring texels, as in rig_fit.py.  A tint that all lamps share cannot be found: it
belongs to the base colours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..data import F64, I32, Bool, Light
from ..evaluation.folds import Folds, Judge, scatter
from ..evaluation.sampled_texels import parts, predicted
from ..job import Progress, Steps
from .contest import GIVEN, HIGHLIGHT, LEAST_ERROR, SURE
from .rig import RigChange
from .rig_fit import RigFound
from .rig_numbers import CAUCHY, MEAN
from .rig_sample import COLOURS, RigSample
from .standard_errors import COMMON, parts_of
from .texel_materials import lobes_of

TINT = 0.1  # what a lamp's colour is off by: of the logarithm of a channel's power
LEAST_TINT = 0.02  # what is worth changing: photographs under calibrated lamps show up to 0.018
LEAST_SCATTER = 1e-4
LEAST = 1e-12
ROUNDS = 4
TINTED = "tinted"


@dataclass(frozen=True)
class Tints:
    """What lamps' powers are to be multiplied by in each channel."""

    log_tint: F64  # (G, 3), whose mean over the channels is 0
    error: F64  # (G,) standard error of a group's
    given: PredictionError  # of left-out views, as the scene is given
    changed: PredictionError

    def corrected(self, sample: RigSample) -> RigSample:
        """A sample as if its lamps had these colours."""
        return tinted(sample, self.log_tint)

    def beside(self, change: RigChange, error: RigChange) -> tuple[RigChange, RigChange]:
        """A change of the corrected rig as one of the given rig, and its standard errors."""
        return replace(change, log_tint=self.log_tint), replace(error, log_tint=self.error[:, None] * np.ones(COLOURS))


def tinted(sample: RigSample, log_tint: F64) -> RigSample:
    """A sample as if the powers of its lamps were multiplied so.  log_tint: (G, 3)."""
    texels, rig = sample.texels, sample.rig
    ratio = _brighter(sample, log_tint)
    views = tuple(replace(view, lights=tuple(
        replace(light, power=light.power * np.exp(log_tint[rig.number()[light.name]])) for light in view.lights))
        for view in rig.views)
    return replace(sample, rig=replace(rig, views=views), texels=replace(
        texels, reflected=texels.reflected / ratio, irradiance=texels.irradiance * ratio))


def lamp_tints(
    sample: RigSample, folds: Folds, first: RigFound, larger: Callable[[bool], RigSample],
) -> Steps[Tints | None]:
    """The colours of lamps that are off beyond doubt, if left-out views are predicted better with them.

    ``first``: the materials of the sample.  ``larger``: a sample of more texels, which says by how much.
    """
    group = sample.rig.number()
    kept = np.array([each.kept for each in sample.rig.groups], bool)
    if len(sample.rig.groups) < 2 or kept.all():
        return None
    yield Progress(0.0, "calibrate", "lamps' colours")
    colours = _Colours(sample, first, group)
    found, error = colours.fit(~kept)
    if not _off(found, error).any():
        return None
    judge = _Judged(sample, first, folds, colours, ~kept)
    if not judge.better():
        return None
    yield Progress(0.0, "calibrate", "lamps' colours")
    tints, error = _with_errors(larger(False), first, group, ~kept)
    if not _off(tints, error).any():
        return None
    return Tints(tints, error, *judge.errors(tints))


def _with_errors(sample: RigSample, first: RigFound, group: dict[str, int], free: Bool) -> tuple[F64, F64]:
    """Tints, and standard errors that explain by how much fits to parts of the sample differ (standard_errors.py)."""
    tints, error = _Colours(sample, first, group).fit(free)
    factor = 1.0
    for pair in parts_of(sample):
        if min(len(part.slot) for part in pair) == 0:
            continue
        (one, by), (other, of) = (_Colours(part, first, group).fit(free) for part in pair)
        apart = (one - other)[free] / np.hypot(by, of)[free, None]
        factor = max(factor, COMMON * float(np.sqrt(np.mean(apart**2))))
    return tints, error * factor


def _off(tints: F64, error: F64) -> Bool:
    return np.asarray(np.abs(tints).max(1) > np.maximum(SURE * error, LEAST_TINT))


def _brighter(sample: RigSample, log_tint: F64) -> F64:
    """(T, V, C) irradiance under tinted lamps over that under the given ones."""
    texels, group = sample.texels, sample.rig.number()
    channels = texels.reflected.shape[-1]
    ratio = np.ones(texels.reflected.shape)
    for v, place in enumerate(sample.view):
        lights = sample.rig.views[place].lights
        given = [_lit(sample, light) for light in lights]
        after = sum((lit * np.exp(log_tint[group[light.name]]) for lit, light in zip(given, lights, strict=True)),
                    np.zeros(COLOURS))
        of = after / np.maximum(sum(given, np.zeros(COLOURS)), LEAST) if len(lights) > 1 else (
            np.exp(log_tint[group[lights[0].name]])[None])
        ratio[:, v] = of if channels > 1 else of[:, texels.channel[v], None]
    return ratio


def _lit(sample: RigSample, light: Light) -> F64:
    """(T, 3) irradiance by a lamp."""
    return np.asarray(sample.geometry.given[light.name][0][:, None] * light.power)


class _Colours:
    """Colours of T texels in V views, and which lamps made them."""

    def __init__(self, sample: RigSample, first: RigFound, group: dict[str, int]) -> None:
        texels = sample.texels
        specular = parts(texels, lobes_of(sample, texels, first.materials))[1]
        places, layers = np.unique(sample.view, return_index=True)
        self.first: I32 = layers.astype(np.int32)  # of each view's layers
        shown = np.stack([
            texels.reflected[:, sample.view == place].reshape(len(texels.reflected), -1) for place in places], 1)
        below = np.maximum(shown - specular[:, layers], 0.0)
        good = texels.usable()[:, layers] & (specular[:, layers, 0] < HIGHLIGHT * np.maximum(shown.mean(-1), LEAST))
        good &= (below > HIGHLIGHT * np.maximum(shown, LEAST)).all(-1)
        logs = np.log(np.where(good[..., None], below, 1.0))
        self.value: F64 = logs - logs.mean(-1, keepdims=True)  # (T, V, 3)
        share = np.where(good[..., None], below / np.maximum(shown, LEAST), 0.0).min(-1)
        self.weight: F64 = share**2  # (T, V)
        self.groups, self.cluster = len(sample.rig.groups), _numbered(sample.cluster)
        self.kept = any(each.kept for each in sample.rig.groups)
        self.share: list[tuple[list[int], F64]] = []  # of each view: groups, and (T, n) their shares in its light
        for place in places:
            lights = sample.rig.views[place].lights
            lit = np.stack([_lit(sample, light).mean(-1) for light in lights], -1)
            lit /= np.maximum(lit.sum(-1, keepdims=True), LEAST)
            self.share.append(([group[light.name] for light in lights], lit))

    def fit(self, free: Bool, texels: Bool | None = None) -> tuple[F64, F64]:
        """(G, 3) tints, and (G,) their standard errors; ``texels``: the only ones to count."""
        weight = self.weight if texels is None else self.weight * texels[:, None]
        robust, tints, error = weight, np.zeros((self.groups, COLOURS)), np.zeros(self.groups)
        count = int(free.sum())
        prior = np.eye(count) / TINT**2 + (0.0 if self.kept else 1 / (MEAN * count) ** 2)
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
        if not self.kept:
            tints -= np.median(tints, axis=0)
            tints -= tints.mean(1, keepdims=True)
        return tints, error

    def left(self, tints: F64, weight: F64, known: Bool | None = None) -> F64:
        """(T, V, 3) colours less tints and the texels' own colours, which the ``known`` views (V,) show."""
        value = self.value - np.stack([
            lit @ tints[groups] for groups, lit in self.share], 1)
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


class _Judged:
    """Left-out views under given colours and under those that the other half of the texels finds."""

    def __init__(self, sample: RigSample, first: RigFound, folds: Folds, colours: _Colours, free: Bool) -> None:
        self.sample, self.first, self.folds, self.colours, self.free = sample, first, folds, colours, free

    def better(self) -> bool:
        """Whether they are predicted better, beyond the scatter, and by what can be seen."""
        colours, odd = self.colours, self.colours.cluster % 2 == 1
        halves = [(half, colours.fit(self.free, ~half)[0]) for half in (odd, ~odd)]
        given, changed = (np.zeros_like(colours.value) for _ in range(2))
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
        judge, brighter = Judge(texels, self.folds), _brighter(self.sample, tints)
        under = tinted(self.sample, tints).texels
        judge.add("lambert", [predicted(texels, None, ~out) for out in self.folds.left_out])
        judge.add(GIVEN, [predicted(texels, lobes, ~out) for out in self.folds.left_out])
        judge.add(TINTED, [predicted(under, lobes, ~out) * brighter for out in self.folds.left_out])
        return judge.error(GIVEN), judge.error(TINTED)
