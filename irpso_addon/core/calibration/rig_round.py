"""One linearisation of what a sample shows, by the numbers of its rig.

The logarithm of radiance.  Each texel's own numbers are eliminated (variable projection, Golub and Pereyra, SIAM J.
Numer. Anal. 10, 1973); each material has one roughness and Specular IOR Level, and what its highlights show counts
little.  Cauchy weights; standard errors from the scores of clusters of neighbouring texels (the sandwich of Huber
1967), which err alike.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np

from ..data import F64, I32, Bool
from ..evaluation.joint_material import OneMaterial
from ..evaluation.sampled_texels import Lobes, SampledTexels
from ..images.response import curved
from ..shading.lights import light_basis
from ..vectors import dot
from .paint import Elimination, OwnNumbers, Paint, base_colours
from .rig import RigChange
from .rig_numbers import CAUCHY, RigNumbers
from .rig_sample import RigSample, Seen, to_middle
from .shade import AroundInShade, around_in_shade
from .texel_materials import lobes_of, shown_by

OUTLYING = 3.0  # standard deviations at which errors are cut off
LEARNT = 200  # rounds in which it is learnt what places and powers typically are off by
DIFFUSE = 0.5  # share of the diffuse in what is no highlight
LEAST = 1e-12
STEP = 0.02  # relative, of roughness: for derivatives
GRAZING = 0.05  # cosine to a lamp: below it, what a tilt does is not linear


def in_common(rest: F64, seen: Bool, cluster: I32, most: float) -> float:
    """Root mean product of what two texels of a cluster, (T,), have in (T, V) ``rest``, cut off at ``most``."""
    rest, order = np.where(seen, np.clip(rest, -most, most), 0.0), np.argsort(cluster, kind="stable")
    first = np.unique(cluster[order], return_index=True)[1]
    total, count = (np.add.reduceat(of[order], first, axis=0) for of in (rest, seen.astype(np.float64)))
    products = float((total**2).sum() - (rest**2).sum()) / max(float((count * (count - 1)).sum()), 1.0)
    return float(np.sqrt(max(products, 0.0)))


class RigRound:
    """One linearisation.  (T, V) arrays are of texels and layers."""

    def __init__(
        self, sample: RigSample, paints: list[Paint], change: RigChange, seen: Seen, materials: dict[int, OneMaterial],
        tilts: bool = False, before: RigRound | None = None,
    ) -> None:
        """``seen``: the sample under the change; ``tilts``: texels have them; ``before``: under nearly the same one."""
        self.sample, self.paints, self.change, self.seen = sample, paints, change, seen
        texels = seen.texels
        lobes = lobes_of(sample, texels, materials, None if before is None else before.lobes.roughness[:, 0])
        self.lobes: Lobes = lobes
        diffuse, specular = self._parts(lobes)
        rougher = self._parts(replace(lobes, roughness=lobes.roughness * (1 + STEP)))
        self.observed = texels.reflected.mean(-1)
        fine = np.ones(self.observed.shape, bool)
        for v, place in enumerate(sample.view):
            for light in sample.rig.views[place].lights:
                fine[:, v] &= seen.fine[light.name]
        self.good: Bool = texels.usable() & (self.observed > 0) & fine
        self.weight: F64 = np.where(self.good, 1.0 if before is None else before.weight, 0.0)
        for _ in range(3):
            weight = np.where(self.good, self.weight / np.maximum(self.observed, 1e-4) ** 2, 0.0)
            base = base_colours(paints, weight, diffuse, self.observed - specular)
            predicted = np.maximum(base * diffuse + specular, LEAST)
            share = np.clip(base * diffuse / predicted, 0, 1)
            bend = (base * rougher[0] + rougher[1] - predicted) / (predicted * STEP)
            left = np.log(np.where(self.good, self.observed / predicted, 1.0))
            clear = self.good & (sample.clarity > 0.5)
            self.scatter = 1.4826 * float(np.median(np.abs(left[clear]))) + 1e-4 if clear.any() else 1.0
            robust = 1 / (1 + (left / (CAUCHY * self.scatter)) ** 2)
            self.weight = np.where(self.good, share**2 * robust * sample.clarity, 0.0)
        self.base, self.predicted = base, predicted
        self.around, self.logarithm, self.white, self.contrast = self._bends()
        # Errors are those of the files: a response that made all of them alike would leave none.
        self.diffuse, self.share = share, share * self.contrast
        self.bend, self.left = bend * self.contrast, left * self.contrast
        self.scatter *= float(np.median(self.contrast[self.good])) if self.good.any() else 1.0
        self.tilts: tuple[F64, ...] = ()
        if tilts:
            self._tilt()

    def beside_tilts(self) -> RigRound:
        """The same where texels have tilts."""
        other = copy(self)
        for name in ("own", "elimination"):
            vars(other).pop(name, None)
        other._tilt()
        return other

    def _tilt(self) -> None:
        self.tilts = self._tilts()
        for _ in range(3):
            rest = self._elimination().remains(self.left)
            self.scatter = 1.4826 * float(np.median(np.abs(rest[self.good]))) + 1e-4 if self.good.any() else 1.0
            self.weight = np.where(self.good, self.diffuse**2 / (1 + (rest / (CAUCHY * self.scatter)) ** 2), 0.0)

    def _parts(self, lobes: Lobes, texels: SampledTexels | None = None) -> tuple[F64, F64]:
        """(T, V) each: what is reflected for each unit of base colour, and whatever that is."""
        diffuse, specular = shown_by(self.seen.texels if texels is None else texels, lobes)
        return diffuse[..., 0], specular[..., 0]

    def _levels(self, slots: list[int]) -> list[F64]:
        """(T, V) slopes of log radiance by the Specular IOR Level of each of some materials."""
        if not slots:
            return []
        diffuse, specular = self._parts(replace(self.lobes, level=self.lobes.level + STEP))
        slopes = (self.base * diffuse + specular - self.predicted) / (self.predicted * STEP)
        return [np.where((self.sample.slot == slot)[:, None], slopes, 0.0) for slot in slots]

    def common(self) -> float:
        """Relative: the part of what is left over that neighbouring texels have in common, which noise is not."""
        rest = self.elimination.remains(self.left) if self.tilts else self.left
        seen = self.good & (self.share > DIFFUSE) & (self.sample.clarity > 0.5)
        return in_common(rest, seen, self.sample.cluster, OUTLYING * self.scatter)

    def around_in_shade(self) -> AroundInShade | None:
        """Light from all around, as places in the shade show it."""
        return around_in_shade(self.sample, self.base, self.seen.shown, self.sample.geometry.open)

    @cached_property
    def elimination(self) -> Elimination:
        """Of the texels' own numbers, under the last weights."""
        return self._elimination()

    def _elimination(self) -> Elimination:
        return Elimination(self.own, self.weight, self.scatter)

    @cached_property
    def own(self) -> OwnNumbers:
        """The texels' own numbers."""
        return OwnNumbers(
            self.paints, self.share, self.bend, self.tilts, self.metals if self.sample.metals else None)

    @cached_property
    def turned(self) -> F64:
        """(3, T, V) slopes of log radiance by what highlights do if all lamps move along each axis of their groups."""
        slopes = []
        for axis in range(3):
            lobes = self.sample.geometry.turned(self.change, self.seen.texels.lobes, axis, STEP)
            white, rest = self._parts(self.lobes, replace(self.seen.texels, lobes=lobes))
            slopes.append((self.base * white + rest - self.predicted) / (self.predicted * STEP))
        return np.stack(slopes)

    @cached_property
    def metals(self) -> F64:
        """(T, V) slopes of log radiance by Metallic."""
        step = np.where(self.lobes.metallic > 0.5, -STEP, STEP)
        white, rest = self._parts(replace(self.lobes, metallic=self.lobes.metallic + step))
        slopes = (self.base * white + rest - self.predicted) / (self.predicted * step[:, None])
        return np.asarray(slopes * self.contrast)

    def _tilts(self) -> tuple[F64, F64]:
        """(T, V) slopes of log radiance by radians of the normal, each way; highlights, which count little, apart."""
        sample, lights = self.sample, self.sample.rig.lights(self.change)
        ways = light_basis(sample.normal)
        one, other = (np.zeros(self.left.shape) for _ in ways)
        steep: dict[str, list[F64]] = {}
        for name, light in lights.items():
            to_light = to_middle(light, sample.position)
            cosine = np.maximum(dot(to_light, sample.normal), GRAZING)
            steep[name] = [dot(to_light, way) / cosine for way in ways]
        for v, place in enumerate(sample.view):
            for light in sample.rig.views[place].lights:
                for slopes, of in zip((one, other), steep[light.name], strict=True):
                    slopes[:, v] += self.share[:, v] * self.seen.share[v, light.name] * of
        return one, other

    def _bends(self) -> tuple[F64, F64, F64, F64]:
        """(T, V) slopes of log radiance by light from all around, and by the logarithms of the response's exponent and
        of its shoulder; and the curve's contrast, the slope of the files' logarithm by that of radiance.
        """
        sample, bent = self.sample, self.seen.bent
        irradiance = np.maximum(sample.texels.irradiance.mean(-1), LEAST)
        around = sample.light * sample.geometry.open / irradiance
        value = self.seen.texels.reflected.mean(-1) * irradiance * sample.geometry.file * self.seen.brighter
        if bent is not None:
            lit = bent.lit()
            around, value = around * lit, value / lit
        power, shoulder = (1.0, 1.0) if bent is None else (bent.power, bent.shoulder)
        shown = np.clip(curved(value, power, shoulder), 0.0, 1.0)  # by the files
        contrast = power * (1 - (1 - 1 / shoulder) * shown)
        return around, np.log(np.maximum(value, LEAST)), (1 - shown) / contrast, contrast

    def step(self, numbers: RigNumbers, factor: float) -> tuple[F64, F64]:
        """(change of the free numbers, their covariance).

        ``factor``: what observations scatter by, times what they show.
        """
        free = numbers.free
        normal, pull, scores = self._sums(numbers, self.elimination)
        variance = (factor * self.scatter)**2
        meat = (scores**2).sum(1)
        ratio = meat / np.maximum(normal.diagonal() * self.scatter**2, LEAST)
        alike = max(float(np.median(ratio)) if len(ratio) else 1.0, 1.0)  # observations for one that is independent
        means, now = numbers.means[np.ix_(free, free)], numbers.packed(self.change)[free]
        for _ in range(LEARNT):
            prior = 1 / numbers.spread(self.change)[free] ** 2
            covariance = np.linalg.inv(normal / (variance * alike) + np.diag(prior) + means)
            gradient = (pull / (variance * alike) - prior * (now - numbers.expected[free])
                        - means @ (now - numbers.start[free]))
            step = covariance @ gradient
            if not (numbers.learns and numbers.learn(now + step, covariance.diagonal())):
                break
        return step, covariance

    def brightness_by_places(self, numbers: RigNumbers) -> F64:
        """(V, N) slopes of the logarithm of each view's brightness by its lamps' places: the means of its texels."""
        sample, slopes = self.sample, np.zeros((numbers.views, numbers.count))
        layers = np.bincount(sample.view, minlength=numbers.views)
        for v, place in enumerate(sample.view):
            good = self.good[:, v]
            for light in sample.rig.views[place].lights if good.any() else ():
                first, share = 3 * numbers.group[light.name], self.seen.share[v, light.name]
                slopes[place, first:first + 3] += (
                    share[:, None] * self.seen.slopes[light.name])[good].mean(0) / layers[place]
        return slopes

    def _columns(self, numbers: RigNumbers, v: int) -> tuple[list[int], list[F64]]:
        """(places in the vector, (T,) slopes each) of what layer ``v`` depends on, levels of materials apart."""
        sample = self.sample
        place = int(sample.view[v])
        at: list[int] = []
        columns: list[F64] = []
        for light in sample.rig.views[place].lights:
            group, share = numbers.group[light.name], self.seen.share[v, light.name]
            at += [3 * group, 3 * group + 1, 3 * group + 2, numbers.powers.start + group]
            columns += [*(share * slope for slope in self.seen.slopes[light.name].T), share]
            if self.sample.metals:
                for axis, slope in enumerate(self.turned[:, :, v]):
                    columns[axis - 4] = columns[axis - 4] + share * slope
        at.append(numbers.gains.start + place)
        columns.append(np.ones(len(self.left)))
        at += range(numbers.shared.start, numbers.diffuse.start)
        columns += [sample.geometry.cosine[:, v], self.around[:, v], self.logarithm[:, v], self.white[:, v]]
        if numbers.place[numbers.diffuse.start] >= 0:
            at += range(numbers.diffuse.start, numbers.diffuse.stop)
            columns += [self.share[:, v] * shape[:, v] for shape in self.seen.diffuse]
        return at, columns

    def _sums(self, numbers: RigNumbers, elimination: Elimination) -> tuple[F64, F64, F64]:
        """Of the free numbers: normal matrix and gradient, base colours eliminated, and each cluster's gradient."""
        count, rest = len(numbers.free), elimination.remains(self.left)
        normal, pull, pulls = np.zeros((count, count)), np.zeros(count), np.zeros((count, len(rest)))
        own = np.ascontiguousarray(elimination.columns.transpose(1, 2, 0))  # (V, m, T)
        across = np.zeros((own.shape[1], count, len(rest)))
        levels = self._levels(numbers.slots)
        for v in range(rest.shape[1]):
            at, columns = self._columns(numbers, v)
            at = [*at, *range(numbers.levels.start, numbers.levels.stop)]
            columns += [level[:, v] for level in levels]
            places = numbers.place[at]
            slopes = self.contrast[:, v] * np.stack(columns)[places >= 0]
            places = places[places >= 0]
            weighted = elimination.weight[:, v] * slopes
            np.add.at(normal, np.ix_(places, places), slopes @ weighted.T)
            np.add.at(pull, places, weighted @ rest[:, v])
            shares = own[v][:, None] * weighted
            for n, number in enumerate(places):
                across[:, number] += shares[:, n]
                pulls[number] += weighted[n] * rest[:, v]
        order = np.argsort(self.sample.cluster, kind="stable")
        first = np.unique(self.sample.cluster[order], return_index=True)[1]
        return normal - elimination.taken(across), pull, np.add.reduceat(pulls[:, order], first, axis=1)
