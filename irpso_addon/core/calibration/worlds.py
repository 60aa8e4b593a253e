"""Whether worlds are turned, or made brighter: only where left-out views are then predicted better.

Half of the texels say what is to be changed; of the other half, views are left out in turn and predicted under it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..data import F64, Bool, View
from ..evaluation.folds import Folds, Judge, rises, scatter, split
from ..evaluation.sampled_texels import predicted
from ..job import Steps
from .calibrate import LEAST_TEXELS
from .contest import GIVEN, HALF, LEAST_SEEN, SURE, WORSE
from .rig_numbers import CAUCHY
from .texel_materials import lobes_of
from .world_fit import LEAST_STEP, LIKELY, MANY_LIKELY, STRENGTH_STEP, TURN_STEP, WorldFit, WorldNumbers
from .world_sample import Around, Changed, LightAt, WorldSample

CHANGED = "changed"
MOST_WORLDS = 6  # that are judged: the light of each is drawn anew for each turn, which takes a second or more
EXPLAINED = 0.15  # error of left-out radiance above which a turn may take up what the model of the material lacks


@dataclass(frozen=True)
class WorldsJudged:
    """A change that is worth making, or at least worth saying."""

    keys: tuple[tuple[str, float], ...]  # (K,) of the environments, as given
    change: WorldNumbers
    error: WorldNumbers  # standard errors
    given: PredictionError  # of left-out views, as the scene is given
    changed: PredictionError
    explained: bool = True  # whether the model explains the views then; else the change may hide what it lacks

    @property
    def sure_turns(self) -> list[bool]:
        """(K,) whether each is turned beyond doubt."""
        return _sure(self.change.turn, self.error.turn, LEAST_STEP * TURN_STEP)

    @property
    def sure_strengths(self) -> list[bool]:
        """(W,) whether each world is brighter or darker beyond doubt."""
        return _sure(self.change.log_strength, self.error.log_strength, LEAST_STEP * STRENGTH_STEP)


def _sure(values: F64, errors: F64, least: float) -> list[bool]:
    return [bool(abs(value) > max(SURE * error, least)) for value, error in zip(values, errors, strict=True)]


def are_few(views: Sequence[View]) -> bool:
    """Whether the views' worlds are few enough to be judged."""
    return len({view.environment.world[0] for view in views if view.environment is not None}) <= MOST_WORLDS


def judge_worlds(sample: WorldSample, light: LightAt) -> Steps[WorldsJudged | None]:
    """What is to be changed of the worlds; None where nothing is, or where too little is seen to judge it.

    Of a change after which the views are not `explained`, only a line is made.
    """
    folds, sample = split(sample.rig.texels), sample.clean()
    if folds is None or int(sample.rig.texels.usable().any(1).sum()) < LEAST_TEXELS:
        return None
    fit = WorldFit(sample, light)
    some = _explained(fit, folds)
    if not some.all():
        sample = sample.part(some)
        fit = WorldFit(sample, _of_some(light, some))
    point = np.zeros(fit.turns + fit.worlds)
    if not (yield from _slopes(fit, point)):
        return None
    point = yield from fit.found()
    found = yield from _found(fit, point)
    if not any((*found.sure_turns, *found.sure_strengths)):
        return None
    contest = WorldContest(sample, folds, fit)
    contest.add(GIVEN, [sample.under(sample.given, np.zeros(fit.worlds))] * 2)
    halves = []
    for others in contest.halves[::-1]:
        change = (yield from _found(fit, point, others)).change
        halves.append(sample.under((yield from fit.light(change.turn)), change.log_strength))
    contest.add(CHANGED, halves)
    if not contest.is_better():
        return None
    return replace(found, given=contest.judge.error(GIVEN), changed=contest.judge.error(CHANGED),
                   explained=contest.is_explained())


def _explained(fit: WorldFit, folds: Folds) -> Bool:
    """(T,) texels of the materials that the model explains as given; all, where it explains none or too few.

    No dielectric explains a metal, whose texels would turn a world that is right.
    """
    sample = fit.sample
    slots, some = np.unique(sample.rig.slot), np.zeros(len(sample.rig.slot), bool)
    for slot in slots if len(slots) > 1 else ():
        own = sample.rig.slot == slot
        part = sample.part(own)
        contest = WorldContest(part, folds, fit)
        contest.add(GIVEN, [part.under(part.given, np.zeros(fit.worlds))] * 2)
        some |= own & (contest.judge.error(GIVEN).relative_rms < EXPLAINED)
    enough = int(sample.rig.texels.usable()[some].any(1).sum()) >= LEAST_TEXELS
    return some if enough else np.ones_like(some)


def _of_some(light: LightAt, some: Bool) -> LightAt:
    """On some of the texels alone."""
    def at(turns: F64) -> Steps[Around]:
        return (yield from light(turns)).part(some)

    return at


def _slopes(fit: WorldFit, point: F64) -> Steps[bool]:
    """Whether some number is beside its valley's bottom."""
    numbers = [*fit.turn_numbers, *fit.strength_numbers]
    likely = LIKELY if len(numbers) == 1 else MANY_LIKELY
    for number in numbers:
        if (yield from fit.valley(point, number)).slopes(fit.sample.rig.cluster, likely):
            return True
    return False


def _found(fit: WorldFit, point: F64, some: Bool | None = None) -> Steps[WorldsJudged]:
    """Where the numbers' valleys are lowest about a point; ``some``: (T,) of the texels alone."""
    error = np.zeros(len(point))
    for number in fit.strength_numbers:  # without light drawn anew: turns are judged at their bottoms
        valley = yield from fit.valley(point, number)
        point = point + valley.bottom(some) * number
        error[number != 0] += valley.error(fit.sample.rig.cluster) * np.abs(number[number != 0])  # it may be infinite
    at = point
    for number in fit.turn_numbers:
        valley = yield from fit.valley(point, number)
        at = at + valley.bottom(some) * number
        error[number != 0] += valley.error(fit.sample.rig.cluster) * np.abs(number[number != 0])  # it may be infinite
    none = PredictionError(0.0, 0.0)
    return WorldsJudged(fit.sample.keys, fit.change(at), fit.change(error), none, none)


class WorldContest:
    """What the given worlds and changed ones predict of left-out views."""

    def __init__(self, sample: WorldSample, folds: Folds, fit: WorldFit) -> None:
        self.sample, self.folds, self.fit = sample, folds, fit
        odd: Bool = np.unique(sample.rig.cluster, return_inverse=True)[1] % 2 == 1
        self.halves = [odd, ~odd]
        self.judge = Judge(sample.rig.texels, folds)
        self.judge.add("lambert", [predicted(sample.rig.texels, None, ~out) for out in folds.left_out])
        self.seen: dict[str, Sequence[Changed]] = {}
        self.left: dict[str, F64] = {}  # (T, V) log of predicted over observed radiance, 0 if not judged

    def add(self, name: str, seen: Sequence[Changed]) -> None:
        """``seen``: as a light has them, of each half of the texels."""
        self.seen[name] = seen
        given = self.sample.rig.texels.reflected
        shown = [np.zeros_like(given) for _ in self.folds.left_out]
        one = np.ones(given.shape[:2])
        for half, changed in zip(self.halves, seen, strict=True):
            for value, out in zip(shown, self.folds.left_out, strict=True):
                texels = changed.texels
                known = replace(texels, quality=np.where(out, 0.0, texels.quality))
                lobes = lobes_of(self.sample.rig, known, self.fit.materials)
                value[half] = (predicted(texels, lobes, ~out) * changed.brighter)[half]
        for value, out in zip(shown, self.folds.left_out, strict=True):
            one[:, out] = value[:, out].mean(-1)
        self.judge.add(name, shown)
        observed = given.mean(-1)
        some = self.judge.judged & (observed > 0) & (one > 0)
        self.left[name] = np.log(np.where(some, one, 1.0) / np.where(some, observed, 1.0))

    def is_better(self) -> bool:
        """Whether texels that had no part in it agree, beyond the scatter, and left-out views are predicted better."""
        cost = {name: sum(self.fit.costs(changed) * half for half, changed in zip(self.halves, seen, strict=True))
                for name, seen in self.seen.items()}
        gain = np.asarray(cost[GIVEN] - cost[CHANGED])
        unit = CAUCHY * self.scale(CHANGED)
        loss = {name: float(np.log1p((left / unit) ** 2).sum()) for name, left in self.left.items()}
        cluster, of = self.sample.rig.cluster, self.judge.candidates
        return bool(gain.sum() > scatter(gain, cluster) and loss[CHANGED] < loss[GIVEN]
                    and not rises(of[GIVEN], of[CHANGED], WORSE, cluster))

    def is_explained(self) -> bool:
        """Whether the model explains the left-out views; else less than half of the error must be left."""
        return (self.judge.error(CHANGED).relative_rms < EXPLAINED
                or self.scale(CHANGED) < HALF * self.scale(GIVEN))

    def scale(self, name: str) -> float:
        """Robust standard deviation of what predictions of left-out views are off by, relative."""
        left = self.left[name]
        return 1.4826 * max(float(np.median(np.abs(left[left != 0]))), LEAST_SEEN)
