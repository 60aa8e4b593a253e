"""The size of lamps that are all alike, told from how softly their light ends and how far it spreads highlights.

A lamp with a size shines a little beyond where a surface turns away from its middle, and its highlights are wider than
the material's.  Taken for a point, it makes materials too rough.  One number is found, and no other of the rig's with
it: the size under which neighbouring texels leave least over in common.  They must leave clearly less, and left-out
views must be predicted better.  What the sample knows of pixels, such as how wide they are, stays as it was observed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..data import F64, Light
from ..evaluation.folds import Folds
from ..evaluation.sampled_texels import predicted
from ..job import Steps
from ..shading.lights import extent_of, light_irradiance, ring_sample, shines_evenly, with_extent
from ..vectors import dot, length
from .contest import ANY, GIVEN, Contest
from .rig import Rig, RigChange
from .rig_fit import RigFound, fit_rig
from .rig_numbers import Free
from .rig_sample import LEAST_COSINE, RigSample, to_camera
from .standard_errors import COMMON, parts_of
from .texel_materials import lobes_of

ALIKE = 0.01  # relative: sizes that differ by less are one
STEP, WIDEST = 0.1, 0.6  # half of the width, over the distance: between sizes that are tried; the largest one
LEAST_COMMON = 0.003  # of the radiance, that neighbours leave over in common: an exact scene leaves less
LESS = 0.95  # of it: what a first step must leave for others to be tried
LEFT = 0.8  # of it: what the size that is taken may leave
OBSERVED = 0.15  # of the change: by which pixels and shadows, as they were observed, make it wrong (decision 0066)
RING = 4  # points of a lamp: they have its first and second moments
CHANGED = "changed"


@dataclass(frozen=True)
class LampSize:
    """Half of the width of all lamps, metres; of SUNs the half angle, radians."""

    extent: float
    error: float  # standard error
    given: PredictionError  # of left-out views, as the scene is given
    changed: PredictionError

    def corrected(self, sample: RigSample) -> RigSample:
        """A sample as if its lamps were of this size."""
        return sized(sample, self.extent)[0]

    def beside(self, change: RigChange, error: RigChange) -> tuple[RigChange, RigChange]:
        """A change of the corrected rig as one of the given rig, and its standard errors."""
        return replace(change, extent=self.extent), replace(error, extent=self.error)


def lamp_size(sample: RigSample, folds: Folds, first: RigFound) -> Steps[LampSize | None]:
    """The size that explains most of what is left over, where all lamps are given alike; None: there is none.

    ``first``: the materials of the sample.
    """
    given, reach = _given(sample.rig)
    if given is None or first.common[1] < LEAST_COMMON:
        return None
    search = _Search(sample, reach, given / reach, first)
    best = yield from search.best()
    if best is None:
        return None
    under, brighter = sized(sample, reach * best)
    then = yield from _materials(under)
    if then.common[1] > LEFT * first.common[1] or (yield from _rival(sample)) < then.common[1]:
        return None
    contest = Contest(sample, first, folds, highlights=True)
    lobes = lobes_of(under, under.texels, then.materials)
    contest.add(CHANGED, [predicted(under.texels, lobes, ~out, ANY) * brighter[..., None] for out in folds.left_out])
    before, after = contest.judge.error(GIVEN), contest.judge.error(CHANGED)
    ratio = max(after.relative_rms / before.relative_rms, after.lightness / before.lightness)
    if ratio > 1 or not contest.beats(CHANGED, GIVEN):
        return None
    error = yield from search.error(best)
    error = max(error, OBSERVED * abs(best - given / reach))
    return LampSize(reach * best, reach * error, before, after)


def _rival(sample: RigSample) -> Steps[float]:
    """What neighbours leave over in common where another single number explains the pictures: the least of it.

    Light from all around reaches what faces away from a lamp too.
    """
    none = Free(False, False, levels=not sample.scale_known)
    least = np.inf
    for free in (replace(none, ambient=True), replace(none, vignetting=True), replace(none, response=True)):
        found = yield from fit_rig(sample, free)
        least = min(least, found.common[1])
    return float(least)


class _Search:
    """Sizes over their distance, and what neighbours then leave over in common."""

    def __init__(self, sample: RigSample, reach: float, given: float, first: RigFound) -> None:
        self.sample, self.reach, self.given = sample, reach, given
        self.common = {given: first.common[1]}

    def best(self) -> Steps[float | None]:
        """The lowest place of a parabola through the best size and its neighbours; None: no other is better."""
        for far in ((2 * STEP,) if self.given < STEP / 2 else (STEP, -STEP)):
            size = self.given + far
            if (yield from self._at(size)) < LESS * self.common[self.given]:
                break
        else:
            return None
        for way in (STEP, -STEP):
            while 0 < size < WIDEST and (yield from self._at(size + way)) < (yield from self._at(size)):
                size += way
        return _lowest(*self._around(max(size, 0.0)))

    def error(self, best: float) -> Steps[float]:
        """Its standard error: how far the lowest places of two parts of the texels are from each other."""
        sizes, _ = self._around(min(self.common, key=lambda size: self.common[size]))
        lowest = []
        for part in parts_of(self.sample)[0]:
            common = []
            for size in sizes:
                found = yield from _materials(sized(part, self.reach * size)[0])
                common.append(found.common[1])
            lowest.append(_lowest(sizes, common))
        return COMMON * max(abs(lowest[0] - lowest[1]) / 2, abs(sum(lowest) / 2 - best))

    def _around(self, size: float) -> tuple[list[float], list[float]]:
        """A size that was tried with the two nearest to it, and what they leave."""
        sizes = sorted(sorted(self.common, key=lambda other: abs(other - size))[:3])
        return sizes, [self.common[each] for each in sizes]

    def _at(self, size: float) -> Steps[float]:
        size = min(max(size, 0.0), WIDEST)
        for known, common in self.common.items():
            if abs(known - size) < STEP / 4:
                return common
        found = yield from _materials(sized(self.sample, self.reach * size)[0])
        self.common[size] = found.common[1]
        return self.common[size]


def _lowest(sizes: list[float], common: list[float]) -> float:
    """Of a parabola through three sizes and the squares of what they leave, between them."""
    curve, slope, _ = np.polyfit(sizes, np.square(common), 2)
    lowest = -slope / (2 * curve) if curve > 0 else sizes[int(np.argmin(common))]
    return float(np.clip(lowest, sizes[0], sizes[-1]))


def sized(sample: RigSample, extent: float) -> tuple[RigSample, F64]:
    """The sample with lamps of another size, and (T, V) their light over that of the given ones."""
    lights = {light.name: light for view in sample.rig.views for light in view.lights}
    other = {name: with_extent(light, extent) for name, light in lights.items()}
    before, after = ({name: light_irradiance(light, sample.position, sample.normal) for name, light in of.items()}
                     for of in (lights, other))
    texels = sample.texels
    lobes, brighter = texels.lobes.copy(), np.ones(texels.cos_v.shape)
    for v, place in enumerate(sample.view):
        view = sample.rig.views[place]
        old, new = (sum((float(np.mean(light.power)) * of[light.name] for light in view.lights), np.zeros(1))
                    for of in (before, after))
        fine = (old > 0) & (new > 0)
        brighter[:, v] = np.where(fine, new / np.where(fine, old, 1.0), 1.0)
        V = to_camera(view.camera, sample.position)
        for n, light in enumerate(view.lights):
            share = after[light.name] / np.where(before[light.name] > 0, before[light.name], 1.0) / brighter[:, v]
            lobes[:, v, n] = _spread(lobes[:, v, n], _disc(other[light.name], sample, V), _disc(light, sample, V))
            lobes[:, v, n, 3] *= np.where(fine, share, 1.0)
    views = tuple(replace(view, lights=tuple(other[light.name] for light in view.lights)) for view in sample.rig.views)
    lit = np.stack([sum((after[light.name] for light in views[place].lights), np.zeros(1)) > 0
                    for place in sample.view], -1)
    shade = None if sample.shade is None else np.where(lit[..., None], np.nan, sample.shade)
    return replace(sample, rig=replace(sample.rig, views=views), shade=shade, texels=replace(
        texels, reflected=texels.reflected / brighter[..., None], lobes=lobes)), brighter


def _disc(light: Light, sample: RigSample, V: F64) -> F64:
    """(T, 3): sin2h and radius2 of the disc that half vectors make, and the cosine to the light; as observed.glsl."""
    N, count = sample.normal, RING if extent_of(light) > 0 else 1
    offs, cosines = np.empty((count, len(N), 3)), np.empty((count, len(N)))
    for k in range(count):
        L, _ = ring_sample(light, sample.position, np.full(len(N), k / count))
        L = L / length(L)[..., None]
        H = L + V
        offs[k], cosines[k] = np.cross(N, H) / np.maximum(length(H), 1e-12)[..., None], dot(N, L)
    weight = np.maximum(cosines, 0.0)
    weight = weight / np.maximum(weight.sum(0), 1e-12)
    middle = (weight[..., None] * offs).sum(0)
    sin2h = dot(middle, middle)
    half_trace = 0.5 * np.maximum((weight * dot(offs, offs)).sum(0) - sin2h, 0.0)
    along = np.maximum((weight * dot(offs, middle) ** 2).sum(0) - sin2h**2, 0.0)
    radius2 = 4 * (along + half_trace**2) / np.maximum(sin2h + half_trace, 1e-30)
    return np.stack([np.maximum(sin2h + 2 * half_trace - 0.5 * radius2, 0.0), radius2, (weight * cosines).sum(0)], -1)


def _spread(lobe: F64, now: F64, given: F64) -> F64:
    """(T, 4) a lobe as observed, its lamp's size changed by as much as the texel's own geometry says."""
    spread = lobe.copy()
    spread[:, :3] += now - given
    spread[:, 0], spread[:, 1] = np.clip(spread[:, 0], 0.0, 1.0), np.maximum(spread[:, 1], 0.0)
    spread[:, 2] = np.clip(spread[:, 2], LEAST_COSINE, 1.0)
    spread[:, 3] *= np.clip(lobe[:, 2], LEAST_COSINE, 1.0) / spread[:, 2]
    return spread


def _given(rig: Rig) -> tuple[float | None, float]:
    """The one size that all lamps are given with, None if there is none; and their typical distance."""
    lights = {light.name: light for view in rig.views for light in view.lights}
    extents = [extent_of(light) for light in lights.values()]
    reach = float(np.median([group.reach for group in rig.groups])) if rig.groups else 1.0
    alike = extents and np.ptp(extents) <= ALIKE * max(extents) and len({
        (light.kind, light.shape) for light in lights.values()}) == 1
    fine = alike and all(shines_evenly(light) and not light.kept for light in lights.values()) and not any(
        group.carried for group in rig.groups)  # cameras see no place that faces away from their flash
    return (float(np.mean(extents)) if fine else None), reach


def _materials(sample: RigSample) -> Steps[RigFound]:
    return (yield from fit_rig(sample, Free(False, False, levels=not sample.scale_known), rounds=1))
