"""The turns and strengths of worlds that explain a sample, each texel's base colour and roughness eliminated.

The cost of a turn has valleys, and roughness bends to a wrong one.  So numbers are searched on a grid, with all
materials fitted at each of its points; a parabola through the lowest ones has the answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..data import F64, I32, Bool
from ..evaluation.folds import scatter
from ..evaluation.joint_material import OneMaterial
from ..evaluation.sampled_texels import parts
from ..job import Progress, Steps
from .paint import base_colours, paints_of
from .rig_numbers import CAUCHY
from .texel_materials import lobes_of, materials_of
from .world_sample import Changed, LightAt, WorldSample

TURN_STEP, STRENGTH_STEP = np.radians(1.0), 0.02  # of the grids: of a turn, and of the logarithm of a strength
WIDE = 2.0  # steps over which slopes are taken
LEAST_STEP = 0.3  # that is worth a change
LIKELY, MANY_LIKELY = 2.0, 3.0  # standard errors from which on a slope is followed, of one number and of several
MOST = 12  # turns that have numbers of their own: of more, each world is turned as a whole
FAR = (8, 4, 2, 1)  # of these steps: in which a world as a whole is searched ...
NEAR = (2, 1)  # ... and each turn of it, about where the world was found
FARTHEST = 24  # steps from what is given
SWEEPS = 3  # over all numbers
PASSES = 4  # of a robust fit
CLEARLY = 0.9  # of what is left over, below which a level is believed
LEAST = 1e-12


@dataclass(frozen=True)
class WorldNumbers:
    """What is to be changed of K environments and their W worlds."""

    turn: F64  # (K,) radians about Z
    log_strength: F64  # (W,)


@dataclass(frozen=True)
class Valley:
    """The cost of a number about a point: a parabola through three points of the grid, WIDE steps apart."""

    costs: F64  # (3, T)

    def bottom(self, some: Bool | None = None) -> float:
        """Where it is lowest, in steps from the point; ``some``: (T,) of the texels alone."""
        before, here, after = (self.costs if some is None else self.costs[:, some]).sum(1)
        bend = before - 2 * here + after
        return WIDE * float(np.clip(0.5 * (before - after) / bend, -1, 1)) if bend > LEAST else 0.0

    def error(self, cluster: I32) -> float:
        """Standard error of the bottom, in steps; (T,) clusters of texels, which err alike."""
        before, here, after = self.costs
        bend, at = before - 2 * here + after, self.bottom() / WIDE
        slopes = np.bincount(np.unique(cluster, return_inverse=True)[1], (after - before) / 2 + at * bend)
        return WIDE * float(np.sqrt((slopes**2).sum()) / bend.sum()) if bend.sum() > LEAST else np.inf

    def slopes(self, cluster: I32, likely: float) -> bool:
        """Whether the point lies beside the bottom, beyond the scatter of clusters and by what is worth a change.

        ``likely``: standard errors.
        """
        before, here, after = self.costs
        down = before - after
        beyond = abs(float(down.sum())) > likely * scatter(down, cluster)
        level = float((before - 2 * here + after).sum()) > LEAST and abs(self.bottom()) < LEAST_STEP
        return beyond and not level


class WorldFit:
    """Costs of changes, on a grid.  A point is K turns and W logarithms of strengths, in steps."""

    def __init__(self, sample: WorldSample, light: LightAt) -> None:
        """``light``: of the sample's environments."""
        self.sample, self.light = sample, light
        self.turns, self.worlds = len(sample.names), len(sample.worlds)
        given = sample.rig.texels
        self._paints = paints_of(given)
        self._costs: dict[tuple[float, ...], F64] = {}
        # A level of its own bends to a world that is wrong: it must explain clearly more than a plain dielectric's.
        plain, free = (materials_of(sample.rig, given, levels=levels) for levels in (False, True))
        units = [self._unit_of(materials) for materials in (plain, free)]
        self.materials = free if units[1] < CLEARLY * units[0] else plain
        self.unit = units[self.materials is free]

    def _unit_of(self, materials: dict[int, OneMaterial]) -> float:
        """From which on errors count less, by what the materials leave over as given."""
        self.materials, self.unit = materials, 1.0
        left, good = self._left(self.sample.under(self.sample.given, np.zeros(self.worlds)))
        return CAUCHY * (1.4826 * float(np.median(np.abs(left[good]))) + 1e-4) if good.any() else 1.0

    @property
    def turn_numbers(self) -> list[F64]:
        """Directions between points: each turn."""
        return list(np.eye(self.turns + self.worlds)[:self.turns]) if self.turns <= MOST else self._wholes

    @property
    def strength_numbers(self) -> list[F64]:
        """Directions between points: each strength that anything shows."""
        strengths = list(np.eye(self.turns + self.worlds)[self.turns:])
        if self.sample.lamps:
            return strengths
        mean = sum(strengths, np.zeros(self.turns + self.worlds)) / self.worlds
        return [strength - mean for strength in strengths[1:]]  # brightness as a whole belongs to the base colours

    @property
    def _wholes(self) -> list[F64]:
        """All turns of a world alike."""
        return [np.array([*(each == name for each in self.sample.names), *np.zeros(self.worlds)], float)
                for name in self.sample.worlds]

    def change(self, point: F64) -> WorldNumbers:
        """What a point amounts to."""
        return WorldNumbers(point[:self.turns] * TURN_STEP, point[self.turns:] * STRENGTH_STEP)

    def valley(self, point: F64, number: F64) -> Steps[Valley]:
        """About a point."""
        costs = []
        for step in (-WIDE, 0.0, WIDE):
            costs.append((yield from self._cost(point + step * number)))
        return Valley(np.stack(costs))

    def found(self) -> Steps[F64]:
        """The lowest point: worlds as a whole first, then each number by itself."""
        point = np.zeros(self.turns + self.worlds)
        for whole in self._wholes:
            point = yield from self._lower(point, whole, FAR)
        for _ in range(SWEEPS):
            start = point
            for number in self.strength_numbers:  # to its bottom: an error of 1 % turns worlds by a degree
                point = yield from self._lower(point, number, FAR)
                point = point + (yield from self.valley(point, number)).bottom() * number
            for number in self.turn_numbers:
                point = yield from self._lower(point, number, NEAR)
            if np.allclose(start, point, atol=0.05):
                break
        return point

    def _lower(self, point: F64, number: F64, steps: Sequence[int]) -> Steps[F64]:
        """Along one number, by ever smaller steps."""
        lowest = float((yield from self._cost(point)).sum())
        for step in steps:
            for way in (-step, step):
                while np.abs(point + way * number).max() <= FARTHEST:
                    cost = float((yield from self._cost(point + way * number)).sum())
                    if cost >= lowest:
                        break
                    point, lowest = point + way * number, cost
        return point

    def _cost(self, point: F64) -> Steps[F64]:
        """(T,) of a point."""
        key = tuple(np.round(point, 6).tolist())
        if key not in self._costs:
            yield Progress(0.0, "calibrate", "worlds")
            change = self.change(point)
            light = yield from self.light(change.turn)
            self._costs[key] = self.costs(self.sample.under(light, change.log_strength))
        return self._costs[key]

    def costs(self, changed: Changed) -> F64:
        """(T,) of what a changed light leaves over."""
        left, good = self._left(changed)
        quality = np.where(good, self.sample.rig.texels.quality, 0.0)
        return np.asarray((quality * np.log1p((left / self.unit) ** 2)).sum(1))

    def _left(self, changed: Changed) -> tuple[F64, Bool]:
        """(T, V) log of observed over explained radiance, and where it is good."""
        texels = changed.texels
        lobes = lobes_of(self.sample.rig, texels, self.materials)
        diffuse, specular = (part[..., 0] for part in parts(texels, lobes))
        observed = texels.reflected.mean(-1)
        good: Bool = self.sample.rig.texels.usable() & (observed > 0)
        quality = np.where(good, texels.quality / np.maximum(observed, texels.typical().mean(-1)) ** 2, 0.0)
        weight, left = quality, np.zeros_like(observed)
        for _ in range(PASSES):
            base = base_colours(self._paints, weight, diffuse, observed - specular)
            explained = np.maximum(base * diffuse + specular, LEAST)
            left = np.log(np.where(good, observed / explained, 1.0))
            weight = quality / (1 + (left / self.unit) ** 2)
        return left, good
