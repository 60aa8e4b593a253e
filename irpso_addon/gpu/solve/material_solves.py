"""Solves materials one at a time, with the numbers that are decided for each."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...core.data import F32, Bool, Coat, JointPrior
from ...core.job import Progress
from ...core.params import SolveSettings
from ..device.context import Device
from ..observe.observation_atlas import Source, Tile, tiles
from .ladder_records import EarlierResult, LadderResult
from .solver import Solver
from .specular_level import LevelSearch
from .texel_records import RoughnessMaps, read_support

SAMPLE = 64  # texels: width of the squares on which a level, or a larger model, is tried
SAMPLES = 2  # squares of each material


@dataclass(frozen=True)
class Decided:
    """What prediction, or an earlier result, has decided of a material; None: what is not decided."""

    prior: JointPrior | None = None
    level: float | None = None
    metallic: float | None = None
    coat: Coat | None = None
    diffuse_roughness: float | None = None

    @property
    def levels_differ(self) -> bool:
        """Whether each texel has its own level, under the material's prior."""
        return self.level is None and self.prior is not None and self.prior.level_strength > 0


def _of(last: EarlierResult, name: str) -> Decided:
    metallic, coat = last.metallic.get(name), last.coats.get(name)
    rough = last.diffuse_roughness.get(name)
    level = None if metallic is None and coat is None and rough is None else last.levels.get(name)
    return Decided(last.priors.get(name), level, metallic, coat, rough)


class MaterialSolves:
    """Solves the texels of some materials for one lobe."""

    def __init__(self, device: Device, source: Source, settings: SolveSettings, last: EarlierResult,
                 solver: Solver, masks: dict[str, Bool]) -> None:
        """``solver``: of all texels.  ``masks``: (h, w) the texels of each material."""
        self.device, self.source, self.settings, self.last = device, source, settings, last
        self.solver, self.masks = solver, masks
        self.levels = LevelSearch(device, settings, last)
        self.decided = {name: _of(last, name) for name in {**masks, **last.priors}}

    def decide(self, name: str, **numbers: Any) -> None:
        """Change some of what is decided of a material."""
        self.decided[name] = replace(self.decided[name], **numbers)

    @property
    def priors(self) -> dict[str, JointPrior]:
        """By material, of those that have one."""
        return {name: found.prior for name, found in self.decided.items() if found.prior is not None}

    def tiles(self, names: Iterable[str]) -> list[Tile]:
        """Those that hold texels of some materials."""
        return tiles(self.solver.atlas, np.logical_or.reduce([self.masks[name] for name in names]))

    def read(self, maps: RoughnessMaps) -> LadderResult:
        """Read maps back, and free them."""
        result = LadderResult(maps.read(self.device), lobes=maps.read_pairs(self.device))
        maps.release()
        return result

    def one_lobe(self, name: str, paint: bool = False) -> Generator[Progress, None, LadderResult]:
        """One lobe of a material under its prior, at what is decided: level (else 0.5), Metallic (else 0), coat, and
        Diffuse Roughness.

        ``paint``: of the part that is no metal, for which neither prior nor Metallic holds.
        """
        decided, mask, level, unsure = self.decided[name], self.masks[name], None, None
        if decided.level is not None:
            level = np.full(mask.shape, decided.level, np.float32)
        elif decided.prior is not None and decided.levels_differ:
            ((level, unsure),) = yield from self.solver.levels_under([decided.prior], self.tiles([name]))
        self.solver.use_level(level)
        self.solver.use_metallic(0.0 if paint else decided.metallic or 0.0)
        self.solver.use_coat(decided.coat)
        self.solver.use_diffuse_roughness(decided.diffuse_roughness or 0.0)
        self.solver.joint = None if paint else decided.prior
        part = self.read((yield from self.solver.solve(self.tiles([name]))))
        self.solver.joint = None
        self.solver.use_level(None)
        self.solver.use_metallic(0.0)
        self.solver.use_coat(None)
        self.solver.use_diffuse_roughness(0.0)
        if unsure is not None:
            sigma = np.minimum(np.hypot(part.texels.sigma, np.sqrt(unsure)), np.float32(0.5))
            part.texels = replace(part.texels, sigma=sigma)
        if level is not None:
            part.level = np.where(mask, level, np.float32(0.5))
        if decided.level is not None:
            part.levels = {name: decided.level}
        if decided.metallic is not None:
            part.metallic = {name: decided.metallic}
        if decided.coat is not None:
            part.coats = {name: decided.coat}
        if decided.diffuse_roughness is not None:
            part.diffuse_roughness = {name: decided.diffuse_roughness}
        return part

    def specular(self, names: list[str]) -> Generator[Progress, None, LadderResult]:
        """One lobe with the level that fits, one for each material or by texel."""
        by_texel = self.settings.specular == "texel"
        names = [name for name in names if self.masks[name].any()] or names
        masks = {name: self.masks[name] for name in names}
        level = yield from self.level(masks, by_texel)
        self.solver.use_level(level)
        self.solver.shown = True
        if len(names) == 1:  # of an earlier result
            self.solver.joint = self.decided[names[0]].prior
        result = self.read((yield from self.solver.solve(self.tiles(names))))
        self.solver.joint = None
        self.solver.use_level(None)
        result.level = level
        if not by_texel:
            result.levels = {name: float(level[mask][0]) for name, mask in masks.items()
                             if mask.any() and (name not in self.last.fixed or name in self.last.levels)}
        return result

    def level(self, masks: dict[str, Bool], by_texel: bool) -> Generator[Progress, None, F32]:
        """The level of some materials' texels, found on all of these or, one for each material, on samples."""
        with self.device.scope():
            solver = self.solver if by_texel else Solver(
                self.device, self.source, self.settings, (SAMPLE, SAMPLE), self.solver.start)
            solver.shown = False
            places = tiles(solver.atlas, np.logical_or.reduce(list(masks.values())))
            if not by_texel and not self.last.fixed.issuperset(masks):
                _, support = yield from solver.search(places)
                seen = read_support(self.device, support).observations
                places = [place for mask in masks.values() for place in best_seen(mask, seen)]
            level = yield from self.levels.levels(solver, masks, places)
            self.solver.cancelled |= solver.cancelled
            return level


def best_seen(texels: Bool, observations: F32) -> list[Tile]:
    """The squares of SAMPLE texels that hold the most observations of a material."""
    seen = np.where(texels, observations, 0.0)
    height, width = texels.shape
    corners = [(x, y) for y in range(0, height, SAMPLE) for x in range(0, width, SAMPLE)
               if texels[y:y + SAMPLE, x:x + SAMPLE].any()]
    worth = {(x, y): float(seen[y:y + SAMPLE, x:x + SAMPLE].sum()) for x, y in corners}
    return sorted(worth, key=lambda tile: -worth[tile])[:SAMPLES]
