"""The solve stage: which model each material needs, and its numbers at every texel."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass, field, replace

import moderngl
import numpy as np

from ...core.data import F32, F64, I32, Bool
from ...core.job import Progress
from ...core.models import CELL, Fit, choose
from ...core.params import SolveSettings
from ...core.tiled.tiled_plan import Noise, PriorKnowledge
from ..device.context import Device
from ..observe.observation_atlas import Source, Tile, tiles
from .paper_swarm import PaperSwarm
from .solver import Solver
from .texel_records import RoughnessMaps, SolvedTexels, read_residual, read_support

SAMPLE = 64  # texels: width of the square on which larger models are tried
SAMPLES = 2  # squares of each material
LEVEL_STEP = 0.4  # of Specular IOR Level: first step of its search
LEVEL_ROUNDS = 5  # each divides the step by 3
LEVEL_KNOWN = 2  # of them that are left out where all levels are known from before
LEVEL_WINDOW = 9  # texels: over which a level by texel is pooled
LEVEL_LOOK = (0.4, 0.5, 0.6)
LEVEL_SAME = 0.05  # a level so near to 0.5 is 0.5


@dataclass(frozen=True)
class EarlierResult:
    """What is taken over from an earlier result, by material."""

    model: Mapping[str, str] = field(default_factory=dict)  # instead of choosing
    levels: Mapping[str, float] = field(default_factory=dict)  # Specular IOR Level to begin at
    fixed: frozenset[str] = frozenset()  # materials whose level must stay ...
    level: F32 | None = None  # ... (h, w) as it is here; None: 0.5
    lobes: F32 | None = None  # (h, w, 4) where the search begins: roughness1, roughness2, weight; whether known


@dataclass
class LadderResult:
    """What the solve stage gives; arrays on the texel grid."""

    texels: SolvedTexels
    model: dict[str, str] = field(default_factory=dict)  # by material
    why: dict[str, str] = field(default_factory=dict)
    levels: dict[str, float] = field(default_factory=dict)
    lobes: F32 | None = None  # (h, w, 3) roughness1, roughness2, weight
    level: F32 | None = None  # (h, w) Specular IOR Level
    base: F32 | None = None  # (h, w, 3) where the method searches it itself
    noise: dict[int, Noise] = field(default_factory=dict)  # of the data, by the number of lobes
    robust: bool = False  # whether outliers were disbelieved
    cancelled: bool = False


class Ladder:
    """Solves for a model, or for the one that each material needs."""

    def __init__(
        self, device: Device, source: Source, settings: SolveSettings, slots: I32, names: tuple[str, ...],
        last: EarlierResult | None = None, before: PriorKnowledge | None = None,
    ) -> None:
        """``slots``: (h, w) material slot of each texel, -1 where there is none; ``names``: of the slots' materials.

        ``before``: as of `Solver`.
        """
        self.device, self.source, self.settings, self.last = device, source, settings, last or EarlierResult()
        lobes = self.last.lobes
        self.start = None if lobes is None else device.texture(lobes.shape[1], lobes.shape[0], data=lobes)
        self.solver = Solver(device, source, settings, start=self.start, before=before)
        # Slots of one material decide together.
        self.masks: dict[str, Bool] = {
            name: np.isin(slots, [slot for slot, other in enumerate(names) if other == name])
            for name in dict.fromkeys(names)}

    def solve(self) -> Generator[Progress, None, LadderResult]:
        """Climb as far as the settings say, or the data pay for."""
        model = self.settings.model
        if self.settings.method == "paper":
            return (yield from self._paper())
        if model == "two-lobe":
            found = self._read((yield from self.solver.solve_two()))
        elif model == "one-lobe-specular":
            found = yield from self._specular(list(self.masks))
        else:
            found = self._read((yield from self.solver.solve()))
        present = [name for name, mask in self.masks.items() if mask.any()]
        found.model = dict.fromkeys(present, model)
        found.why = dict.fromkeys(present, "asked for")
        if model == "auto":
            yield from self._climb(found)
        found.cancelled = self.solver.cancelled
        found.noise, found.robust = self.solver.found, self.solver.robust
        return found

    def _read(self, maps: RoughnessMaps) -> LadderResult:
        found = LadderResult(maps.read(self.device), lobes=maps.read_pairs(self.device))
        maps.release()
        return found

    def _paper(self) -> Generator[Progress, None, LadderResult]:
        """The swarm as published: every number searched, nothing shared but its equation (4)."""
        model = "one-lobe" if self.settings.model == "auto" else self.settings.model
        swarm = PaperSwarm(self.device, self.source, self.settings, model)
        maps = yield from swarm.solve()
        best, more = self.device.read(maps.best).copy(), self.device.read(maps.more).copy()
        for thing in (swarm, maps.best, maps.more):
            thing.release()
        seen = more[..., 3] > 0
        unknown = np.full(seen.shape, 0.5, np.float32)  # the method gives no standard errors
        texels = SolvedTexels(best[..., 3], unknown, unknown, seen, observations=seen.astype(np.float32),
                              residual=more[..., 2], lambert_residual=unknown, base_sigma=unknown)
        found = LadderResult(texels, base=best[..., :3])
        if model == "two-lobe":
            found.lobes = np.stack([best[..., 3], more[..., 0], more[..., 1]], -1)
        found.model = dict.fromkeys(self.masks, model)
        found.why = dict.fromkeys(self.masks, "method paper searches one model for all")
        found.cancelled = swarm.cancelled
        return found

    # ---- evidence

    def _climb(self, found: LadderResult) -> Generator[Progress, None, None]:
        """From one lobe down to none, or up, by each material's evidence; changes ``found``."""
        larger: dict[str, list[str]] = {}
        for name, mask in self.masks.items():
            texels = mask & found.texels.solved
            if not texels.any():
                found.model.pop(name, None)
                found.why.pop(name, None)
                continue
            if name in self.last.model:
                found.model[name], found.why[name] = self.last.model[name], "as in the last result"
                larger.setdefault(found.model[name], []).append(name)
                continue
            fitted = found.texels
            none = Fit(fitted.lambert_residual, np.zeros_like(fitted.residual))
            one = Fit(fitted.residual, np.ones_like(fitted.residual))  # in full: no lobe needs no neighbours
            found.model[name], found.why[name] = self._choose(texels, fitted.observations, lambert=none, one_lobe=one)
            if found.model[name] == "one-lobe" and not self.solver.cancelled:
                found.model[name], found.why[name] = yield from self._try_larger(name, texels, found)
                larger.setdefault(found.model[name], []).append(name)
        for name in larger.get("one-lobe-specular", []):
            self._put(found, (yield from self._specular([name])), [name])
        if "two-lobe" in larger:
            names = larger["two-lobe"]
            maps = yield from self.solver.solve_two(self._tiles(self.solver, names))
            self._put(found, self._read(maps), names)

    def _choose(self, texels: Bool, observations: F32, **fits: Fit) -> tuple[str, str]:
        h, w = texels.shape
        row, column = np.mgrid[:h, :w] // CELL
        cells = (row * (w // CELL + 1) + column).astype(np.int32)
        chosen = {name.replace("_", "-"): Fit(fit.residual[texels], fit.searched[texels]) for name, fit in fits.items()}
        return choose(observations[texels], chosen, cells[texels], self.source.model_error,
                      self.source.least_gain)

    def _try_larger(self, name: str, texels: Bool, found: LadderResult) -> Generator[Progress, None, tuple[str, str]]:
        """Two lobes, and another specular level, on the squares where a material is seen best.

        All by squares: what one lobe does not explain would else be disbelieved as outliers, and speak for no other.
        """
        solver = Solver(self.device, self.source, replace(self.settings, loss="squares"), (SAMPLE, SAMPLE),
                        self.start)
        solver.shown = False
        try:
            places = self._best_seen(solver, texels, found.texels.observations)
            plain = self._read((yield from solver.solve(places))).texels if self.solver.robust else found.texels
            two = self._read((yield from solver.solve_two(places))).texels
            sample = texels & _inside(texels.shape, places, SAMPLE)
            one = np.ones_like(plain.residual)
            fits = {"lambert": Fit(plain.lambert_residual, np.zeros_like(one)),
                    "one_lobe": Fit(plain.residual, one),
                    "two_lobe": Fit(two.residual, one + two.determined - plain.determined)}
            if (yield from self._level_differs(solver, sample, places)):
                level = yield from self._levels(solver, {name: texels}, places)
                self._set_level(solver, level)
                other = self._read((yield from solver.solve(places))).texels
                fits["one_lobe_specular"] = Fit(other.residual, one)
            if solver.cancelled:
                self.solver.cancelled = True
                return found.model[name], found.why[name]
            return self._choose(sample, plain.observations, **fits)
        finally:
            self._set_level(solver, None)
            solver.release()

    def _level_differs(self, solver: Solver, sample: Bool, places: list[Tile]) -> Generator[Progress, None, bool]:
        """Whether a Specular IOR Level other than 0.5 may explain the sample better: one look to either side."""
        costs = []
        for level in LEVEL_LOOK:
            self._set_level(solver, np.full(sample.shape, level, np.float32))
            costs.append(float((yield from self._cost(solver, places))[sample].sum()))
        bend = np.polyfit(LEVEL_LOOK, costs, 2)
        return bool(bend[0] <= 0 or abs(-0.5 * bend[1] / bend[0] - 0.5) > LEVEL_SAME)

    def _best_seen(self, solver: Solver, texels: Bool, observations: F32) -> list[Tile]:
        seen = np.where(texels, observations, 0.0)
        worth = {(x, y): float(seen[y:y + SAMPLE, x:x + SAMPLE].sum()) for x, y in tiles(solver.atlas, texels)}
        return sorted(worth, key=lambda tile: -worth[tile])[:SAMPLES]

    def _tiles(self, solver: Solver, names: Iterable[str]) -> list[Tile]:
        wanted = np.logical_or.reduce([self.masks[name] for name in names])
        return tiles(solver.atlas, wanted)

    def _put(self, found: LadderResult, part: LadderResult, names: list[str]) -> None:
        """Take over what another model found for some materials."""
        inside = np.logical_or.reduce([self.masks[name] for name in names]) & part.texels.solved
        if part.lobes is not None:
            r = found.texels.roughness
            found.lobes = np.where(inside[..., None], part.lobes, np.stack([r, r, np.ones_like(r)], -1))
        if part.level is not None:
            before = np.full_like(part.level, 0.5) if found.level is None else found.level
            found.level = np.where(inside, part.level, before)
        found.texels = found.texels.where(inside, part.texels)
        found.levels |= part.levels

    # ---- Specular IOR Level

    def _specular(self, names: list[str]) -> Generator[Progress, None, LadderResult]:
        """One lobe with the level that fits, one for each material or by texel."""
        by_texel = self.settings.specular == "texel"
        names = [name for name in names if self.masks[name].any()] or names
        masks = {name: self.masks[name] for name in names}
        solver = self.solver if by_texel else Solver(
            self.device, self.source, self.settings, (SAMPLE, SAMPLE), self.start)
        solver.shown = False
        places = tiles(solver.atlas, np.logical_or.reduce(list(masks.values())))
        if not by_texel and not self.last.fixed.issuperset(names):
            best, support = yield from solver.search(places)
            seen = read_support(self.device, support).observations
            best.release()
            support.release()
            places = [place for mask in masks.values() for place in self._best_seen(solver, mask, seen)]
        level = yield from self._levels(solver, masks, places)
        self.solver.cancelled |= solver.cancelled
        if solver is not self.solver:
            self._set_level(solver, None)
            solver.release()
        self._set_level(self.solver, level)
        self.solver.shown = True
        found = self._read((yield from self.solver.solve(self._tiles(self.solver, names))))
        self._set_level(self.solver, None)
        found.level = level
        if not by_texel:
            found.levels = {name: float(level[mask][0]) for name, mask in masks.items()
                            if mask.any() and (name not in self.last.fixed or name in self.last.levels)}
        return found

    def _levels(
        self, solver: Solver, masks: dict[str, Bool], places: list[Tile],
    ) -> Generator[Progress, None, F32]:
        """The level that leaves the least noise, (h, w): per texel pooled over its window, or one for each mask.

        A search that narrows: five levels about the best so far, a parabola through the lowest three, a third of
        the step.  At every level each texel finds its own roughness.
        """
        level = np.full(next(iter(masks.values())).shape, 0.5, np.float32)
        known = [name for name in masks if name in self.last.levels]
        for name in known:
            level[masks[name]] = self.last.levels[name]
        for name in self.last.fixed.intersection(masks):
            level[masks[name]] = 0.5 if self.last.level is None else self.last.level[masks[name]]
        skipped = LEVEL_KNOWN if len(known) == len(masks) else 0
        step = LEVEL_STEP / 3.0**skipped
        for _ in range(skipped, LEVEL_ROUNDS):
            if solver.cancelled or self.last.fixed.issuperset(masks):
                break
            offsets = step * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
            costs = []
            for offset in offsets:
                self._set_level(solver, np.clip(level + offset, 0.02, 1.0).astype(np.float32))
                costs.append((yield from self._cost(solver, places)))
            level = self._improved(level, offsets, np.stack(costs), masks)
            step /= 3.0
        return level

    def _cost(self, solver: Solver, places: list[Tile]) -> Generator[Progress, None, F64]:
        """How badly a solver's level explains each texel, (h, w): n log of the noise that the best roughness leaves."""
        best, support = yield from solver.search(places)
        residual = read_residual(self.device, best, 1).astype(np.float64)
        found = read_support(self.device, support)
        best.release()
        support.release()
        observations = found.observations.astype(np.float64)
        informed = found.observed & (observations >= 3.0)
        floor = max(solver.noise, 1e-4) ** 2
        return np.asarray(informed * observations * np.log(residual / np.maximum(observations, 1.0) + floor))

    def _improved(self, level: F32, offsets: F64, costs: F64, masks: dict[str, Bool]) -> F32:
        result = level.copy()
        if self.settings.specular == "texel" and self.settings.model == "one-lobe-specular":
            pooled = np.stack([_box(cost, LEVEL_WINDOW) for cost in costs])
            result = level + _lowest(offsets, pooled).astype(np.float32)
            for name in self.last.fixed.intersection(masks):
                result[masks[name]] = level[masks[name]]
        else:
            for mask in (mask for name, mask in masks.items() if name not in self.last.fixed):
                pooled = costs[:, mask].sum(axis=1)[:, None, None]
                result[mask] = level[mask] + np.float32(_lowest(offsets, pooled)[0, 0])
        return np.clip(result, 0.02, 1.0)

    def _set_level(self, solver: Solver, level: F32 | None) -> None:
        if solver.level is not None:
            solver.level.release()
        solver.level = None if level is None else self._texture(level)

    def _texture(self, values: F32) -> moderngl.Texture:
        h, w = values.shape
        return self.device.texture(w, h, 1, values)

    def release(self) -> None:
        """Free the solver and where it began."""
        self.solver.release()
        if self.start is not None:
            self.start.release()


def _inside(shape: tuple[int, ...], places: list[Tile], width: int) -> Bool:
    result = np.zeros(shape, bool)
    for x, y in places:
        result[y:y + width, x:x + width] = True
    return result


def _box(values: F64, width: int) -> F64:
    """Sum over a square window."""
    half = width // 2
    padded = np.pad(values, ((half + 1, half), (half + 1, half)))
    total = padded.cumsum(0).cumsum(1)
    return np.asarray(total[width:, width:] - total[:-width, width:] - total[width:, :-width] + total[:-width, :-width])


def _lowest(offsets: F64, costs: F64) -> F64:
    """Where the parabola through the lowest of (5, h, w) costs and its neighbours has its bottom, (h, w).

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
