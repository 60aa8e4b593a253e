"""The relief of a flat sample: a board, a leaf or a card is a plane to its mesh, while its surface has bumps.

Under a flash they show in highlights, whose strength differs from place to place.  So each texel's level is found
beside its tilt, at one roughness of the material, and highlights count in what left-out views judge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..data import F64, Bool
from ..evaluation.folds import Candidate, Folds, Judge, scatter, split
from ..evaluation.joint_material import JointSearch, OneMaterial
from ..evaluation.sampled_texels import Lobes, SampledTexels, one_lobe, predicted
from ..job import Progress, Steps, share_of
from .judge import (
    ALL,
    GIVEN,
    LARGE,
    LEAST_TILT,
    LEAST_VIEWS,
    NO_BETTER,
    SURE,
    NormalsJudged,
    judge_normals,
    large_scale,
)
from .tilt_fit import Beside, TiltsFound, fit_tilts
from .tilt_sample import TiltSample

FLAT = np.cos(np.radians(5.0))  # of the angle between the normals of a flat sample and their mean
NUMBERS = 4  # of each texel: base colour, level, tilt
SMALL = "small"  # what is not common to whole regions
PASSES = 4  # of tilts and the material in turn
BETTER = 0.9  # ratio to which both errors must fall


def judge_normals_and_relief(sample: TiltSample) -> Steps[NormalsJudged | str]:
    """As `judge_normals`, of which what is flat has another chance."""
    found = yield from share_of(judge_normals(sample), 0.0, 0.5)
    if found != NO_BETTER or not is_flat(sample):
        return found
    relief = yield from share_of(_relief(sample), 0.5, 1.0)
    return found if relief is None else relief


def is_flat(sample: TiltSample) -> bool:
    """Whether the given normals are those of a plane."""
    mean = sample.rig.normal.mean(0)
    return bool((sample.rig.normal @ mean).min() > FLAT * np.linalg.norm(mean))


def _relief(sample: TiltSample) -> Steps[NormalsJudged | None]:
    """None: it predicts left-out views not clearly better."""
    sample = sample.part(sample.texels.usable().sum(1) >= LEAST_VIEWS)
    folds = split(sample.texels, NUMBERS)
    if folds is None:
        return None
    flat = _of_slots(sample, _materials(sample, sample.texels))
    yield Progress(0.0, "normals")
    relief = _Relief.of(sample, flat)
    if relief is None:
        return None
    yield Progress(0.2, "normals")
    contest = _Contest(sample, flat, relief, folds)
    for fold, left_out in enumerate(folds.left_out):
        contest.predict(~left_out)
        yield Progress(0.2 + 0.8 * (fold + 1) / len(folds.left_out), "normals")
    return contest.judged()


@dataclass(frozen=True)
class _Relief:
    """What all views say of a sample."""

    materials: dict[int, OneMaterial]
    tilts: TiltsFound

    @classmethod
    def of(cls, sample: TiltSample, flat: Lobes) -> _Relief | None:
        """None: it is too low to matter."""
        found, materials = fit_tilts(sample, flat, beside=Beside.LEVEL), dict[int, OneMaterial]()
        for _ in range(PASSES):
            deviation = found.deviation()
            if deviation < LEAST_TILT:
                return None
            tilt = found.under(deviation)[0]
            materials = _materials(sample, sample.tilted(tilt)[0])
            lobes = replace(_of_slots(sample, materials), level=found.lobes.level)
            found = fit_tilts(sample, lobes, start=tilt, beside=Beside.LEVEL, deviation=deviation)
        return None if found.deviation() < LEAST_TILT else cls(materials, found)


class _Contest:
    """What a plane and a relief predict of left-out views; each texel has its own level in both."""

    def __init__(self, sample: TiltSample, flat: Lobes, relief: _Relief, folds: Folds) -> None:
        self.sample, self.flat, self.relief = sample, flat, relief
        self.deviation = relief.tilts.deviation()
        self.start, self.lobes = relief.tilts.under(self.deviation)[0], relief.tilts.lobes
        self.judge = Judge(sample.texels, folds)
        self.predictions: dict[str, list[F64]] = {"lambert": [], GIVEN: [], LARGE: [], SMALL: [], ALL: []}

    def predict(self, known: Bool) -> None:
        """One fold."""
        sample, none = self.sample, np.zeros_like(self.start)
        self.predictions["lambert"].append(predicted(sample.texels, None, known))
        self.predictions[GIVEN].append(self._under(none, self.flat, known))
        found = fit_tilts(sample, self.lobes, known, self.start, beside=Beside.LEVEL, deviation=self.deviation)
        tilt = found.under(self.deviation)[0]
        large = large_scale(sample, tilt)
        for name, tilts in ((LARGE, large), (SMALL, tilt - large), (ALL, tilt)):
            self.predictions[name].append(self._under(tilts, found.lobes, known))

    def _under(self, tilt: F64, lobes: Lobes, known: Bool) -> F64:
        lobes = fit_tilts(self.sample, lobes, known, tilt, beside=Beside.LEVEL, deviation=0.0).lobes
        seen, more = self.sample.tilted(tilt)
        return predicted(seen, lobes, known) * more[..., None]

    def judged(self) -> NormalsJudged | None:
        """Only if both errors fall far below those of the plane, and below those of what regions have in common."""
        for name, predictions in self.predictions.items():
            self.judge.add(name, predictions)
        of, tilts = self.judge.candidates, self.relief.tilts
        if not (self._better(of[GIVEN], of[ALL], BETTER) and self._better(of[LARGE], of[ALL], 1.0)):
            return None
        given, refined = (self.judge.error(name).relative_rms for name in (GIVEN, ALL))
        return NormalsJudged(self.relief.materials, tilts.scatter, self.deviation, given, refined, Beside.LEVEL,
                             large=self._better(of[SMALL], of[ALL], 1.0, 1.0))

    def _better(self, before: Candidate, after: Candidate, ratio: float, sure: float = SURE) -> bool:
        """Whether the root mean squares of radiance and of L* fall by a ratio and so many standard errors."""
        clusters = self.sample.rig.cluster
        return all(new.sum() < ratio**2 * old.sum() and (old - new).sum() > sure * scatter(old - new, clusters)
                   for old, new in ((before.squares, after.squares), (before.lightness, after.lightness)))


def _materials(sample: TiltSample, texels: SampledTexels) -> dict[int, OneMaterial]:
    """One roughness and level for each material slot; ``texels``: of the sample, under some tilts."""
    known = np.ones(len(sample.rig.view), bool)
    texels.usable()  # once for all parts
    return {int(slot): JointSearch(texels.part(sample.rig.slot == slot), metals=False).fit(known).specular
            for slot in np.unique(sample.rig.slot)}


def _of_slots(sample: TiltSample, materials: dict[int, OneMaterial]) -> Lobes:
    roughness, level = (np.array([getattr(materials[int(slot)], name) for slot in sample.rig.slot])
                        for name in ("roughness", "level"))
    return one_lobe(roughness, level)
