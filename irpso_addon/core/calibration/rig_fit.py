"""Places and powers of lamps, and exposures, that explain a sample of texels best: Gauss-Newton (see rig_round.py)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..data import F64
from ..evaluation.folds import Folds
from ..evaluation.joint_material import OneMaterial
from ..job import Progress, Steps
from .paint import Elimination, paints_of
from .rig import RigChange
from .rig_numbers import Free, RigNumbers, tell_typical
from .rig_round import DIFFUSE, LEAST, RigRound
from .rig_sample import RigSample
from .shade import AroundInShade
from .texel_materials import materials_of

ROUNDS, AGAIN = 6, 3  # from what is given; from what was found
SETTLED = 2e-4  # of a lamp's distance, relative power or gain
MOST_AMBIENT = 1.0  # of the lamps' typical irradiance: a fit that wants more runs away
LONGEST = 0.15  # of a lamp's distance: a step
REFITS = (0, 3)  # rounds in which the materials are fitted
WORSE = 1.02  # ratio of what is left over: a step that makes it larger is too long
HUBER, TYPICAL_ROUNDS = 1.345, 20  # standard deviations from which on a value is an outlier; of the mean of powers


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
    prior: F64  # standard deviation of each number before the sample was looked at; of lamps as it was learnt


@dataclass(frozen=True)
class ViewBrightness:
    """By how much each view is brighter or darker than the typical one, beside what was given: (V,) logarithms.

    That is surer than which part of it is its lamps' power, which their distance, and which its exposure.
    """

    change: F64
    error: F64


def fit_rig(
    sample: RigSample, free: Free, start: RigFound | None = None, rounds: int | None = None,
    factor: float | None = None, again: int = AGAIN, prior: F64 | None = None,
) -> Steps[RigFound]:
    """The change of the rig that explains a sample.  ``start``: of more texels, or with other numbers free.

    Materials are those of ``start``, for ``again`` rounds, unless ``rounds`` says how many there are to be.
    ``factor``: what observations scatter by, times what they show; then lamps are as far off as they typically are, if
    `tell_typical`, or as ``prior`` says, that of a fit to the same sample with the same numbers free.
    """
    refit = start is None or rounds is not None
    return RigFit(sample, free, start, refit, factor, prior).found((rounds or ROUNDS) if refit else again)


def left_over(sample: RigSample, found: RigFound) -> F64:
    """(T, V) logarithm of radiance over what was found; NaN where highlights show, or nothing is known.

    Base colours are those of all cameras: their own would take up an exposure that a camera's views have in common.
    """
    paints = [replace(paint, cameras=(np.ones(len(paint.layers), bool),)) for paint in paints_of(sample.texels)]
    seen = sample.geometry.under(found.change)
    now = RigRound(sample, paints, found.change, seen, found.materials)
    return np.where(now.good & (now.share > DIFFUSE), now.left, np.nan)


def around_of(sample: RigSample, found: RigFound) -> AroundInShade | None:
    """What places in the shade say of light from all around under the rig that was found; None: nothing."""
    return _round(sample, found).around_in_shade()


def base_of(sample: RigSample, found: RigFound) -> F64:
    """(T, V) base colours under the rig that was found."""
    return _round(sample, found).base


def beside_tilts(sample: RigSample, found: RigFound, folds: Folds) -> list[F64]:
    """Of each fold, (T, V, C) radiance of the left-out views over the given irradiance, where texels are tilted.

    Base colours, roughnesses and tilts are those that the other views say.
    """
    now = _round(sample, found, tilts=True)
    result = []
    for left_out in folds.left_out:
        own = Elimination(now.own, now.weight * ~left_out, now.scatter)
        result.append(sample.texels.reflected * np.exp(-own.remains(now.left))[..., None])
    return result


def _round(sample: RigSample, found: RigFound, tilts: bool = False) -> RigRound:
    """Under what was found."""
    seen = sample.geometry.under(found.change)
    return RigRound(sample, paints_of(sample.texels), found.change, seen, found.materials, tilts)


class RigFit:
    """The rounds of `fit_rig`."""

    def __init__(
        self, sample: RigSample, free: Free, start: RigFound | None = None, refit: bool = True,
        factor: float | None = None, prior: F64 | None = None,
    ) -> None:
        """``refit``: whether the materials are, too; else they are those of ``start``."""
        self.sample, self.free, self.refit, self.factor = sample, free, refit, 1.0 if factor is None else factor
        learns = factor is not None and prior is None and tell_typical(sample.rig, free)
        self.numbers = numbers = RigNumbers(sample, free, learns)
        if prior is not None:
            numbers.prior = prior.copy()
        self.paints = paints_of(sample.texels)
        self.begins, self.done, self.settled = start is None, 0, False
        self.materials: dict[int, OneMaterial] = {} if start is None else start.materials
        self.change = RigChange.none(numbers.groups, numbers.views)
        if start is not None:
            self.change = numbers.unpacked(numbers.packed(start.change)[numbers.free])  # what is not free is as given
            if sample.rig.one_flash:
                self.change = replace(self.change, log_power=np.zeros(1))  # it follows from the place: see finish.py
            numbers.start = numbers.packed(self.change)
        self.now: RigRound | None = None
        self.before: tuple[float, RigChange] | None = None
        self.given: tuple[float, float] | None = None

    def found(self, rounds: int) -> Steps[RigFound]:
        """After so many rounds in all, or as soon as nothing moves any more."""
        numbers = self.numbers
        while self.done < rounds and not self.settled:
            yield Progress(self.done / rounds, "calibrate")
            self._next()
            self.done += 1
        now, given = self.now, self.given
        assert now is not None and given is not None
        error = numbers.unpacked(np.sqrt(np.maximum(self.covariance.diagonal(), 0.0)))
        return RigFound(_centred(self.change, bool(numbers.kept.any())), error, now.scatter, given[0],
                        (given[1], now.common()), self.materials, self._brightness(now), numbers.prior)

    def _next(self) -> None:
        """One round."""
        numbers = self.numbers
        now = self.now = self._linearised()
        if self.free.ambient:
            numbers.expect(now.around_in_shade())
        if self.sample.metals and self.before is not None and now.scatter > WORSE * self.before[0]:
            half = 0.5 * (numbers.packed(self.change) + numbers.packed(self.before[1]))
            self.change = numbers.unpacked(half[numbers.free])
            return
        self.before = now.scatter, self.change
        step, self.covariance = now.step(numbers, self.factor)
        self.given = self.given or (now.scatter, now.common())
        self.change = self._moved(step)
        self.materials = self._levelled(self.materials, step)
        still = np.abs(step[:len(step) - len(numbers.slots)]).max(initial=0.0) < SETTLED
        self.settled = bool(still) and self.done + 1 not in REFITS

    def _linearised(self) -> RigRound:
        """What the sample shows under the change so far."""
        if self.refit and self.done == 0:
            self.materials, now = self._begun()
            return now
        seen, before = self.sample.geometry.under(self.change), self.now
        if self.refit and self.done in REFITS:
            self.materials = materials_of(self.sample, seen.texels, self.free.levels)
            before = None  # beside other materials a texel's roughness may lie far from the last one
        return RigRound(self.sample, self.paints, self.change, seen, self.materials, self.free.tilts, before)

    def _begun(self) -> tuple[dict[int, OneMaterial], RigRound]:
        """Materials and round under the rig that fits of other numbers begin with too: given, or found last."""
        geometry, levels = self.sample.geometry, self.free.levels
        kept = geometry.begun if self.begins else geometry.again
        key = levels, self.numbers.packed(self.change).tobytes()
        if key not in kept:
            if not self.begins:
                kept.clear()
            seen = geometry.under(self.change)
            materials = materials_of(self.sample, seen.texels, levels)
            kept[key] = materials, RigRound(self.sample, self.paints, self.change, seen, materials)
        materials, now = kept[key]
        return materials, now.beside_tilts() if self.free.tilts else now

    def _brightness(self, now: RigRound) -> ViewBrightness:
        slopes = self.numbers.slopes_of_brightness(self.sample) + now.brightness_by_places(self.numbers)
        change = slopes @ self.numbers.packed(self.change)
        apart = (slopes - slopes.mean(0))[:, self.numbers.free]
        variance = (apart @ self.covariance * apart).sum(1)
        return ViewBrightness(change - typical(change), np.sqrt(np.maximum(variance, 0.0)))

    def _levelled(self, materials: dict[int, OneMaterial], step: F64) -> dict[int, OneMaterial]:
        """With the steps of their levels."""
        slots = self.numbers.slots
        return materials | {slot: replace(materials[slot], level=float(np.clip(materials[slot].level + by, 0.02, 1.0)))
                            for slot, by in zip(slots, step[len(step) - len(slots):], strict=True) if slot in materials}

    def _moved(self, step: F64) -> RigChange:
        change = self.numbers.unpacked(step)
        lengths = np.linalg.norm(change.offset, axis=1, keepdims=True)
        offset = change.offset * np.minimum(1.0, LONGEST / np.maximum(lengths, LEAST))
        ambient = float(np.clip(self.change.ambient + change.ambient, 0.0, MOST_AMBIENT))
        return RigChange(self.change.offset + offset, self.change.log_power + change.log_power,
                         self.change.log_gain + change.log_gain, self.change.vignetting + change.vignetting,
                         ambient, self.change.log_response + change.log_response,
                         max(self.change.log_shoulder + change.log_shoulder, 0.0),
                         self.change.cosine + change.cosine, self.change.transmission + change.transmission,
                         self.change.rough + change.rough)


def _centred(change: RigChange, kept: bool) -> RigChange:
    """With typical powers and gains as they were given: one lamp that is off changes no other.

    ``kept``: some lamps are sure, and with them what the others' powers are to be compared with.
    """
    return replace(change, log_power=change.log_power - (0.0 if kept else typical(change.log_power)),
                   log_gain=change.log_gain - typical(change.log_gain))


def typical(values: F64) -> float:
    """A mean to which outliers count as much as what is a little off (Huber, Ann. Math. Stat. 35, 1964).

    Of lamps that are all a little off it is nearer to the truth than their median.
    """
    middle = float(np.median(values))
    reach = HUBER * max(1.4826 * float(np.median(np.abs(values - middle))), LEAST)
    for _ in range(TYPICAL_ROUNDS):
        weight = np.minimum(1.0, reach / np.maximum(np.abs(values - middle), LEAST))
        middle = float((weight * values).sum() / weight.sum())
    return middle
