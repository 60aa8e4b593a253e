"""Places and powers of lamps, and exposures, that explain a sample of texels best.

Gauss-Newton on the logarithm of radiance.  Each texel's base colour is eliminated (variable projection, Golub and
Pereyra, SIAM J. Numer. Anal. 10, 1973); each material has one roughness and Specular IOR Level, and what its highlights
show counts little.  Cauchy weights; a prior about what is given; standard errors from the scores of clusters of
neighbouring texels (the sandwich of Huber 1967), which err alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..data import F64, I32, Bool
from ..evaluation.folds import Folds
from ..evaluation.joint_material import OneMaterial
from ..evaluation.sampled_texels import Lobes, parts
from ..job import Progress, Steps
from ..shading.lights import light_basis
from ..vectors import dot
from .paint import Elimination, base_colours, paints_of
from .rig import Rig, RigChange
from .rig_sample import RigSample, Seen, to_middle
from .shade import AroundInShade, around_in_shade
from .texel_materials import lobes_of, materials_of

PLACE, POWER, GAIN = 0.05, 0.1, 0.03  # what a shoot's figures are off by: of a lamp's distance; relative
VIGNETTING = 2.0  # power of the cosine
AMBIENT, RESPONSE = 0.2, 0.3  # of the lamps' typical irradiance; of the logarithm of the response's exponent
COSINE, TRANSMISSION = 0.3, 1.0  # powers
LEVEL = 0.3  # of Specular IOR Level
OUTLYING = 3.0  # standard deviations at which errors are cut off
CAUCHY = 2.4  # standard deviations at which an observation has lost half its weight
ROUNDS, AGAIN = 6, 3  # from what is given; from what was found
SETTLED = 2e-4  # of a lamp's distance, relative power or gain
LONGEST = 0.15  # of a lamp's distance: a step
SHARED = 5  # numbers of all views: vignetting, ambient light, response, two of the diffuse
REFITS = (0, 3)  # rounds in which the materials are fitted
MEAN = 1e-4  # of powers, and of gains: brightness as a whole belongs to the base colours
LEARNT = 200  # rounds in which it is learnt what places and powers typically are off by
LEAST_USUAL = 1e-3  # of a lamp's distance, relative power
HUBER, TYPICAL_ROUNDS = 1.345, 20  # standard deviations from which on a value is an outlier; of the mean of powers
LEAST_LAMPS = 4  # that are free: fewer say little of what is typical
DIFFUSE = 0.5  # share of the diffuse in what is no highlight
LEAST = 1e-12
STEP = 0.02  # relative, of roughness: for derivatives
GRAZING = 0.05  # cosine to a lamp: below it, what a tilt does is not linear


@dataclass(frozen=True)
class Free:
    """Which numbers are looked for."""

    lamps: bool  # places and powers
    exposures: bool
    vignetting: bool = False
    levels: bool = False  # the Specular IOR Level of each material
    ambient: bool = False
    response: bool = False
    cosine: bool = False  # a power of the cosine: the usual way in which a diffuse is not Lambert's
    diffuse: bool = False  # all that it may have beside Lambert's
    tilts: bool = False  # of the texels' normals, in detail: each texel's own, as its base colour

    @property
    def scene(self) -> bool:
        """Whether any of the scene's numbers are."""
        return self.ambient or self.lamps or self.exposures or self.vignetting or self.response

    @property
    def only_ambient(self) -> bool:
        """Of the scene's numbers."""
        return self.ambient and not replace(self, ambient=False).scene


@dataclass(frozen=True)
class RigFound:
    """A change with its standard errors, shaped alike."""

    change: RigChange
    error: RigChange
    scatter: float  # relative: what observations leave over, robust
    given: float  # the same where the fit began
    common: tuple[float, float]  # relative: what neighbouring texels leave over in common; where the fit began, and now
    materials: dict[int, OneMaterial]  # by slot
    brightness: ViewBrightness


@dataclass(frozen=True)
class ViewBrightness:
    """By how much each view is brighter or darker than the typical one, beside what was given: (V,) logarithms.

    That is surer than which part of it is its lamps' power, and which its exposure.
    """

    change: F64
    error: F64


def fit_rig(
    sample: RigSample, free: Free, start: RigFound | None = None, rounds: int | None = None,
    factor: float | None = None,
) -> Steps[RigFound]:
    """The change of the rig that explains a sample.  ``start``: of more texels, or with other numbers free.

    Materials are those of ``start``, unless ``rounds`` says how many there are to be.  ``factor``: what observations
    scatter by, times what they show; then lamps are as far off as they typically are, if `tell_typical`.
    """
    refit = start is None or rounds is not None
    return _RigFit(sample, free, factor).found(start, (rounds or ROUNDS) if refit else AGAIN, refit)


def left_over(sample: RigSample, found: RigFound) -> F64:
    """(T, V) logarithm of radiance over what was found; NaN where highlights show, or nothing is known.

    Base colours are those of all cameras: their own would take up an exposure that a camera's views have in common.
    """
    fit = _RigFit(sample, Free(False, False))
    fit.paints = [replace(paint, cameras=(np.ones(len(paint.layers), bool),)) for paint in fit.paints]
    seen = sample.geometry.under(found.change)
    now = _Round(fit, seen, lobes_of(sample, seen.texels, found.materials), None)
    return np.where(now.good & (now.share > DIFFUSE), now.left, np.nan)


def in_common(rest: F64, seen: Bool, cluster: I32, most: float) -> float:
    """Root mean product of what two texels of a cluster, (T,), have in (T, V) ``rest``, cut off at ``most``."""
    rest, of = np.where(seen, np.clip(rest, -most, most), 0.0), np.unique(cluster, return_inverse=True)[1]
    total, count = (np.zeros((int(of.max()) + 1, rest.shape[1])) for _ in range(2))
    np.add.at(total, of, rest)
    np.add.at(count, of, seen)
    products = float((total**2).sum() - (rest**2).sum()) / max(float((count * (count - 1)).sum()), 1.0)
    return float(np.sqrt(max(products, 0.0)))


def shade_of(sample: RigSample, found: RigFound) -> float | None:
    """What places in the shade say of light from all around under the rig that was found; None: nothing."""
    shade = _round_of(sample, found, Free(False, False, ambient=True)).around_in_shade()
    return None if shade is None else shade.value


def base_of(sample: RigSample, found: RigFound) -> F64:
    """(T, V) base colours under the rig that was found."""
    return _round_of(sample, found, Free(False, False)).base


def _round_of(sample: RigSample, found: RigFound, free: Free) -> _Round:
    seen = sample.geometry.under(found.change)
    return _Round(_RigFit(sample, free), seen, lobes_of(sample, seen.texels, found.materials), None)


def tell_typical(rig: Rig, free: Free) -> bool:
    """Whether lamps are enough to tell how far off they typically are."""
    return free.lamps and sum(not group.kept for group in rig.groups) >= LEAST_LAMPS


def beside_tilts(sample: RigSample, found: RigFound, folds: Folds) -> list[F64]:
    """Of each fold, (T, V, C) radiance of the left-out views over the given irradiance, where texels are tilted.

    Base colours, roughnesses and tilts are those that the other views say.
    """
    seen = sample.geometry.under(found.change)
    fit = _RigFit(sample, Free(False, False, tilts=True))
    fit.change = found.change
    now = _Round(fit, seen, lobes_of(sample, seen.texels, found.materials), None)
    result = []
    for left_out in folds.left_out:
        own = Elimination(fit.paints, now.weight * ~left_out, now.share, now.bend, now.scatter, now.tilts)
        result.append(sample.texels.reflected * np.exp(-own.remains(now.left))[..., None])
    return result


class _RigFit:
    """The rounds of `fit_rig`; numbers: offsets, powers, gains, SHARED, and levels of the materials."""

    def __init__(self, sample: RigSample, free: Free, factor: float | None = None) -> None:
        self.sample, self.geometry = sample, sample.geometry
        self.factor = 1.0 if factor is None else factor
        self.learns = factor is not None and tell_typical(sample.rig, free)
        self.groups, self.views = len(sample.rig.groups), len(sample.rig.views)
        self.group, self.levels, self.tilts = sample.rig.number(), free.levels, free.tilts
        self.change = RigChange.none(self.groups, self.views)
        self.kept = np.array([group.kept for group in sample.rig.groups], bool)
        lamps = np.concatenate([np.repeat(~self.kept, 3), ~self.kept]) & free.lamps
        self.slots = [int(slot) for slot in np.unique(sample.slot)] if free.levels else []
        self.free = np.flatnonzero(np.concatenate(
            [lamps, np.full(self.views, free.exposures), [free.vignetting, free.ambient, free.response],
             [free.cosine or free.diffuse, free.diffuse], np.ones(len(self.slots), bool)]))
        self.prior = np.concatenate([np.full(3 * self.groups, PLACE), np.full(self.groups, POWER),
                                     np.full(self.views, GAIN), [VIGNETTING, AMBIENT, RESPONSE, COSINE, TRANSMISSION],
                                     np.full(len(self.slots), LEVEL)])
        self.paints = paints_of(sample.texels)
        self.expected = np.zeros(len(self.prior))  # the prior's middle
        self.start = np.zeros(len(self.prior))  # whose means are kept
        self.means = np.zeros((len(self.prior),) * 2)
        gains = 4 * self.groups, 4 * self.groups + self.views
        for first, end in ((3 * self.groups, 4 * self.groups), gains):
            self.means[first:end, first:end] = 1 / (MEAN * (end - first)) ** 2

    def found(self, start: RigFound | None, rounds: int, refit: bool) -> Steps[RigFound]:
        """Rounds until nothing moves any more."""
        materials, weight, given = {} if start is None else start.materials, None, None
        if start is not None:
            self.change = start.change
            self.change = self._unpacked(self.packed()[self.free])  # what is not free is as it is given
            self.start = self.packed()
        for n in range(rounds):
            yield Progress(n / rounds, "calibrate")
            seen = self.geometry.under(self.change)
            if refit and n in REFITS:
                materials = materials_of(self.sample, seen.texels, self.levels)
            now = _Round(self, seen, lobes_of(self.sample, seen.texels, materials), weight)
            self.expect(now.around_in_shade())
            step, covariance = now.step()
            weight, given = now.weight, given or (now.scatter, now.common())
            self.change = self._moved(step)
            materials = self._levelled(materials, step)
            if np.abs(step[:len(step) - len(self.slots)]).max(initial=0.0) < SETTLED and n + 1 not in REFITS:
                break
        assert given is not None
        return RigFound(_centred(self.change, bool(self.kept.any())), self._spread(covariance), now.scatter, given[0],
                        (given[1], now.common()), materials, self._brightness(covariance))

    def _brightness(self, covariance: F64) -> ViewBrightness:
        slopes = np.zeros((self.views, len(self.prior)))
        for v, view in enumerate(self.sample.rig.views):
            slopes[v, 4 * self.groups + v] = 1.0
            for light in view.lights:
                slopes[v, 3 * self.groups + self.group[light.name]] += 1 / len(view.lights)
        change = slopes @ self.packed()
        apart = (slopes - slopes.mean(0))[:, self.free]
        return ViewBrightness(change - _typical(change), np.sqrt(np.maximum((apart @ covariance * apart).sum(1), 0.0)))

    def _spread(self, covariance: F64) -> RigChange:
        return self._unpacked(np.sqrt(np.maximum(covariance.diagonal(), 0.0)))

    def expect(self, around: AroundInShade | None) -> None:
        """Light from all around is about what the shade shows."""
        if around is not None:
            number = 4 * self.groups + self.views + 1
            self.expected[number], self.prior[number] = around.value, around.error

    def spread(self) -> F64:
        """Standard deviations of the prior; of a gain that is far off, as an automatic flash makes it, a wider one."""
        spread, gains = self.prior.copy(), slice(4 * self.groups, 4 * self.groups + self.views)
        spread[gains] = np.maximum(spread[gains], np.abs(self.change.log_gain) / CAUCHY)
        return spread

    def learn(self, free: F64, variance: F64) -> None:
        """By how much places and powers typically are off (empirical Bayes: one round of expectation maximisation).

        ``free``, ``variance``: values of the free numbers, and how far those may be off.
        """
        values, unsure = np.zeros(len(self.prior)), np.zeros(len(self.prior))
        values[self.free], unsure[self.free] = free, variance
        for first, end, most in ((0, 3 * self.groups, PLACE), (3 * self.groups, 4 * self.groups, POWER)):
            own = self.free[(self.free >= first) & (self.free < end)]
            usual = float(np.sqrt(np.mean(values[own] ** 2 + unsure[own])))
            self.prior[own] = min(max(usual, LEAST_USUAL), most)

    def packed(self) -> F64:
        """The change as one vector."""
        return np.concatenate([self.change.offset.ravel(), self.change.log_power, self.change.log_gain,
                               [self.change.vignetting, self.change.ambient, self.change.log_response,
                                self.change.cosine, self.change.transmission],
                               np.zeros(len(self.slots))])

    def _levelled(self, materials: dict[int, OneMaterial], step: F64) -> dict[int, OneMaterial]:
        """With the steps of their levels."""
        steps = step[len(step) - len(self.slots):]
        return materials | {slot: replace(materials[slot], level=float(np.clip(materials[slot].level + by, 0.02, 1.0)))
                            for slot, by in zip(self.slots, steps, strict=True) if slot in materials}

    def _moved(self, step: F64) -> RigChange:
        change = self._unpacked(step)
        lengths = np.linalg.norm(change.offset, axis=1, keepdims=True)
        offset = change.offset * np.minimum(1.0, LONGEST / np.maximum(lengths, LEAST))
        return RigChange(self.change.offset + offset, self.change.log_power + change.log_power,
                         self.change.log_gain + change.log_gain, self.change.vignetting + change.vignetting,
                         max(self.change.ambient + change.ambient, 0.0), self.change.log_response + change.log_response,
                         self.change.cosine + change.cosine, self.change.transmission + change.transmission)

    def _unpacked(self, free: F64) -> RigChange:
        values = np.zeros(len(self.prior))
        values[self.free] = free
        G, gains = self.groups, 4 * self.groups + self.views
        return RigChange(values[:3 * G].reshape(G, 3), values[3 * G:4 * G], values[4 * G:gains],
                         *values[gains:gains + SHARED].tolist())


def _centred(change: RigChange, kept: bool) -> RigChange:
    """With typical powers and gains as they were given: one lamp that is off changes no other.

    ``kept``: some lamps are sure, and with them what the others' powers are to be compared with.
    """
    return replace(change, log_power=change.log_power - (0.0 if kept else _typical(change.log_power)),
                   log_gain=change.log_gain - _typical(change.log_gain))


def _typical(values: F64) -> float:
    """A mean to which outliers count as much as what is a little off (Huber, Ann. Math. Stat. 35, 1964).

    Of lamps that are all a little off it is nearer to the truth than their median.
    """
    middle = float(np.median(values))
    reach = HUBER * max(1.4826 * float(np.median(np.abs(values - middle))), LEAST)
    for _ in range(TYPICAL_ROUNDS):
        weight = np.minimum(1.0, reach / np.maximum(np.abs(values - middle), LEAST))
        middle = float((weight * values).sum() / weight.sum())
    return middle


class _Round:
    """One linearisation.  (T, V) arrays are of texels and layers."""

    def __init__(self, fit: _RigFit, seen: Seen, lobes: Lobes, weight: F64 | None) -> None:
        self.fit, self.seen = fit, seen
        texels = seen.texels
        diffuse, specular = (part[..., 0] for part in parts(texels, lobes))
        rougher, glossier = ([part[..., 0] for part in parts(texels, changed)] for changed in (
            replace(lobes, roughness=lobes.roughness * (1 + STEP)), replace(lobes, level=lobes.level + STEP)))
        self.observed = texels.reflected.mean(-1)
        fine = np.ones(self.observed.shape, bool)
        for v, place in enumerate(fit.sample.view):
            for light in fit.sample.rig.views[place].lights:
                fine[:, v] &= seen.fine[light.name]
        self.good: Bool = texels.usable() & (self.observed > 0) & fine
        self.weight = np.where(self.good, 1.0, 0.0) if weight is None else np.where(self.good, weight, 0.0)
        for _ in range(3):
            weight = np.where(self.good, self.weight / np.maximum(self.observed, 1e-4) ** 2, 0.0)
            base = base_colours(fit.paints, weight, diffuse, self.observed - specular)
            predicted = np.maximum(base * diffuse + specular, LEAST)
            share = np.clip(base * diffuse / predicted, 0, 1)
            bend, level = ((base * other[0] + other[1] - predicted) / (predicted * STEP)
                           for other in (rougher, glossier))
            left = np.log(np.where(self.good, self.observed / predicted, 1.0))
            self.scatter = 1.4826 * float(np.median(np.abs(left[self.good]))) + 1e-4 if self.good.any() else 1.0
            robust = 1 / (1 + (left / (CAUCHY * self.scatter)) ** 2)
            self.weight = np.where(self.good, share**2 * robust, 0.0)
        # Errors are those of the files: a response that made all of them alike would leave none.
        power = 1.0 if seen.bent is None else seen.bent.power
        self.base = base
        self.share, self.bend, self.level, self.left = share * power, bend * power, level * power, left * power
        self.scatter *= power
        self.around, self.logarithm = self._bends()
        self.tilts = self._tilts() if fit.tilts else ()
        for _ in range(3 if fit.tilts else 0):
            rest = self._elimination().remains(self.left)
            self.scatter = 1.4826 * float(np.median(np.abs(rest[self.good]))) + 1e-4 if self.good.any() else 1.0
            self.weight = np.where(self.good, share**2 / (1 + (rest / (CAUCHY * self.scatter)) ** 2), 0.0)

    def common(self) -> float:
        """Relative: the part of what is left over that neighbouring texels have in common, which noise is not."""
        rest = self._elimination().remains(self.left) if self.fit.tilts else self.left
        return in_common(rest, self.good & (self.share > DIFFUSE), self.fit.sample.cluster, OUTLYING * self.scatter)

    def around_in_shade(self) -> AroundInShade | None:
        """Light from all around, where it is looked for."""
        fit = self.fit
        if 4 * fit.groups + fit.views + 1 not in fit.free:
            return None
        return around_in_shade(fit.sample, self.base, self.seen.shown, fit.geometry.open)

    def _elimination(self) -> Elimination:
        return Elimination(self.fit.paints, self.weight, self.share, self.bend, self.scatter, self.tilts)

    def _tilts(self) -> tuple[F64, F64]:
        """(T, V) slopes of log radiance by radians of the normal, each way; highlights, which count little, apart."""
        sample, lights = self.fit.sample, self.fit.sample.rig.lights(self.fit.change)
        ways = light_basis(sample.normal)
        one, other = (np.zeros(self.left.shape) for _ in ways)
        for v, place in enumerate(sample.view):
            for light in sample.rig.views[place].lights:
                to_light = to_middle(lights[light.name], sample.position)
                cosine = np.maximum(dot(to_light, sample.normal), GRAZING)
                for slopes, way in zip((one, other), ways, strict=True):
                    slopes[:, v] += self.share[:, v] * self.seen.share[v, light.name] * dot(to_light, way) / cosine
        return one, other

    def _bends(self) -> tuple[F64, F64]:
        """(T, V) slopes of log radiance by light from all around, and by the logarithm of the response's exponent."""
        sample, bent = self.fit.sample, self.seen.bent
        irradiance = np.maximum(sample.texels.irradiance.mean(-1), LEAST)
        around = sample.light * self.fit.geometry.open / irradiance
        value = self.seen.texels.reflected.mean(-1) * irradiance * self.fit.geometry.file * self.seen.brighter
        if bent is not None:
            lit = bent.lit()
            around, value = around * lit, value / lit
        return around, np.log(np.maximum(value, LEAST))

    def step(self) -> tuple[F64, F64]:
        """(change of the free numbers, their covariance)."""
        fit, free = self.fit, self.fit.free
        elimination = self._elimination()
        normal, pull, scores = self._sums(elimination)
        normal, pull, scores = normal[np.ix_(free, free)], pull[free], scores[free]
        variance = (fit.factor * self.scatter)**2
        meat = (scores**2).sum(1)
        ratio = meat / np.maximum(normal.diagonal() * self.scatter**2, LEAST)
        alike = max(float(np.median(ratio)) if len(ratio) else 1.0, 1.0)  # observations for one that is independent
        means, now = fit.means[np.ix_(free, free)], fit.packed()[free]
        for _ in range(LEARNT if fit.learns else 1):
            prior = 1 / fit.spread()[free] ** 2
            covariance = np.linalg.inv(normal / (variance * alike) + np.diag(prior) + means)
            gradient = pull / (variance * alike) - prior * (now - fit.expected[free]) - means @ (now - fit.start[free])
            step = covariance @ gradient
            if fit.learns:
                fit.learn(now + step, covariance.diagonal())
        return step, covariance

    def _columns(self, v: int) -> tuple[list[int], F64]:
        """(numbers, (T, n) slopes) of what layer ``v`` depends on."""
        fit, G = self.fit, self.fit.groups
        place = int(fit.sample.view[v])
        numbers: list[int] = []
        columns: list[F64] = []
        for light in fit.sample.rig.views[place].lights:
            group, share = fit.group[light.name], self.seen.share[v, light.name]
            numbers += [3 * group, 3 * group + 1, 3 * group + 2, 3 * G + group]
            columns += [*(share[:, None] * self.seen.slopes[light.name]).T, share]
        numbers.append(4 * G + place)
        columns.append(np.ones(len(self.left)))
        shared = 4 * G + fit.views
        numbers += range(shared, shared + SHARED)
        columns += [fit.geometry.cosine[:, v], self.around[:, v], self.logarithm[:, v],
                    *(self.share[:, v] * shape[:, v] for shape in self.seen.diffuse)]
        power = 1.0 if self.seen.bent is None else self.seen.bent.power
        columns = [column * power for column in columns]
        for n, slot in enumerate(fit.slots):
            numbers.append(shared + SHARED + n)
            columns.append(np.where(fit.sample.slot == slot, self.level[:, v], 0.0))
        return numbers, np.stack(columns, -1)

    def _sums(self, elimination: Elimination) -> tuple[F64, F64, F64]:
        """Normal matrix and gradient with base colours eliminated, and the gradient of each cluster."""
        count, rest = len(self.fit.prior), elimination.remains(self.left)
        _, cluster = np.unique(self.fit.sample.cluster, return_inverse=True)
        clusters = int(cluster.max()) + 1
        normal, pull, scores = np.zeros((count, count)), np.zeros(count), np.zeros((count, clusters))
        across = np.zeros((len(rest), elimination.columns.shape[-1], count))
        for v in range(rest.shape[1]):
            numbers, columns = self._columns(v)
            weighted = elimination.weight[:, v, None] * columns
            np.add.at(normal, np.ix_(numbers, numbers), columns.T @ weighted)
            np.add.at(pull, numbers, weighted.T @ rest[:, v])
            for number, column in zip(numbers, (weighted * rest[:, v, None]).T, strict=True):
                scores[number] += np.bincount(cluster, column, minlength=clusters)
            across[:, :, numbers] += elimination.columns[:, v, :, None] * weighted[:, None]
        return normal - elimination.taken(across), pull, scores
