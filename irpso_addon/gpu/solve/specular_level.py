"""The Specular IOR Level that explains a material's observations, where it is not taken to be 0.5."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import moderngl
import numpy as np

from ...core.data import F32, F64, Bool
from ...core.job import Progress
from ...core.params import SolveSettings
from ..device.context import Device
from ..observe.observation_atlas import Tile, tiles
from .ladder_records import EarlierResult
from .solver import Solver
from .texel_records import Support, read_support
from .tile_passes import KernelPass

STEPS = (0.14, 0.03, 0.005, 0.001)  # between the levels of each round: the first reaches from 0 to 1
KNOWN = 1  # of them that are left out where all levels are known from before
LOOK = 0.04  # between the levels about 0.5 that say whether it may be another
TRIED = np.arange(8.0) - 3.5  # levels of a round, in steps from the best so far: two outputs of four
BOUNDS = 0.02, 1.0  # of a Specular IOR Level
REFINED = 3  # Levenberg-Marquardt steps of roughness at each
LEVEL_WINDOW = 9  # texels: over which a level by texel is pooled
LEVEL_SAME = 0.05  # a level so near to 0.5 is 0.5


@dataclass(frozen=True)
class _Start:
    """Where levels are tried from."""

    valleys: moderngl.Texture  # of the search kernel
    support: Support


class LevelSearch:
    """Tries levels with a solver; each texel finds its own roughness at each of them."""

    def __init__(self, device: Device, settings: SolveSettings, last: EarlierResult) -> None:
        self.device, self.settings, self.last = device, settings, last

    def differs(self, solver: Solver, sample: Bool) -> Generator[Progress, None, bool]:
        """Whether a Specular IOR Level other than 0.5 may explain the sample better: looks to either side."""
        half, places = np.full(sample.shape, 0.5, np.float32), tiles(solver.atlas, sample)
        with self.device.scope():
            start = yield from self._start(solver, half, places)
            costs = (yield from self._costs(solver, start, half, LOOK, places))[:, sample].sum(1)
        bend = np.polyfit(LOOK * TRIED, costs, 2)
        return bool(bend[0] <= 0 or abs(-0.5 * bend[1] / bend[0]) > LEVEL_SAME)

    def levels(
        self, solver: Solver, masks: dict[str, Bool], places: list[Tile],
    ) -> Generator[Progress, None, F32]:
        """The level that leaves the least noise, (h, w): per texel pooled over its window, or one for each mask.

        A search that narrows: eight levels about the best so far, a parabola through the lowest three, a finer step.
        At every level each texel finds its own roughness.
        """
        level = np.full(next(iter(masks.values())).shape, 0.5, np.float32)
        known = [name for name in masks if name in self.last.levels]
        for name in known:
            level[masks[name]] = self.last.levels[name]
        for name in self.last.fixed.intersection(masks):
            level[masks[name]] = 0.5 if self.last.level is None else self.last.level[masks[name]]
        if self.last.fixed.issuperset(masks):
            return level
        with self.device.scope():
            start = yield from self._start(solver, level, places)
            for step in STEPS[KNOWN if len(known) == len(masks) else 0:]:
                if solver.cancelled:
                    break
                costs = yield from self._costs(solver, start, level, step, places)
                level = self._improved(level, np.asarray(step * TRIED), costs, masks)
        return level

    def _start(self, solver: Solver, level: F32, places: list[Tile]) -> Generator[Progress, None, _Start]:
        """Each texel's roughness at some levels, from a search."""
        solver.use_level(level)
        best, maps = yield from solver.search(places)
        return _Start(best, read_support(self.device, maps))

    def _costs(
        self, solver: Solver, start: _Start, level: F32, step: float, places: list[Tile],
    ) -> Generator[Progress, None, F64]:
        """How badly levels about each texel's ``level`` explain it, (8, h, w).

        n log of the noise that the best roughness leaves.
        """
        with self.device.scope():
            centre = self.device.texture(level.shape[1], level.shape[0], 1, level)
            outputs = solver.textures(2)
            yield from solver.run(places, (0.0, 1.0), KernelPass(
                "solve/level_costs.kernel", outputs, {"u_valleys": start.valleys, "u_centre": centre},
                {"u_level_first": float(step * TRIED[0]), "u_level_step": step, "u_level_bounds": BOUNDS,
                 "u_steps": REFINED}))
            residual = np.concatenate([self.device.read(texture) for texture in outputs], -1).astype(np.float64)
        observations = start.support.observations.astype(np.float64)
        informed = start.support.observed & (observations >= 3.0)
        floor = max(solver.noise, 1e-4) ** 2
        mean = np.moveaxis(residual, -1, 0) / np.maximum(observations, 1.0)
        return np.asarray(informed * observations * np.log(mean + floor))

    def _improved(self, level: F32, offsets: F64, costs: F64, masks: dict[str, Bool]) -> F32:
        result = level.copy()
        if self.settings.specular == "texel" and self.settings.model == "one-lobe-specular":
            pooled = np.stack([box(cost, LEVEL_WINDOW) for cost in costs])
            result = level + _lowest(offsets, pooled).astype(np.float32)
            for name in self.last.fixed.intersection(masks):
                result[masks[name]] = level[masks[name]]
        else:
            for mask in (mask for name, mask in masks.items() if name not in self.last.fixed):
                pooled = costs[:, mask].sum(axis=1)[:, None, None]
                result[mask] = level[mask] + np.float32(_lowest(offsets, pooled)[0, 0])
        return np.clip(result, *BOUNDS)


def box(values: F64, width: int) -> F64:
    """Sum over a square window."""
    half = width // 2
    padded = np.pad(values, ((half + 1, half), (half + 1, half)))
    total = padded.cumsum(0).cumsum(1)
    return np.asarray(total[width:, width:] - total[:-width, width:] - total[width:, :-width] + total[:-width, :-width])


def _lowest(offsets: F64, costs: F64) -> F64:
    """Where the parabola through the lowest of (N, h, w) costs and its neighbours has its bottom, (h, w).

    In the middle where all costs are alike.
    """
    best = np.clip(costs.argmin(axis=0), 1, len(offsets) - 2)
    left, here, right = (np.take_along_axis(costs, best[None] + i, axis=0)[0] for i in (-1, 0, 1))
    bend = left - 2.0 * here + right
    shift = np.where(bend > 0, 0.5 * (left - right) / np.where(bend > 0, bend, 1.0), 0.0)
    edge = np.where(right < here, 1.0, np.where(left < here, -1.0, 0.0))
    shift = np.where((left < here) | (right < here), edge, shift)
    flat = costs.max(axis=0) - costs.min(axis=0) <= 1e-6  # sums over windows round
    return np.where(flat, 0.0, offsets[best] + np.clip(shift, -1.0, 1.0) * (offsets[1] - offsets[0]))
