"""The solve stage: which model each material needs, and its numbers at every texel."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable
from dataclasses import replace
from typing import Any

import moderngl
import numpy as np

from ...core.data import F32, Bool, Coat, JointPrior
from ...core.errors import BadInput
from ...core.job import Progress
from ...core.models import CELL, Fit, choose
from ...core.params import SolveSettings
from ...core.tiled.tiled_plan import Noise, PriorKnowledge
from ..device.context import Device
from ..observe.observation_atlas import CameraSource, Source, Tile, tiles
from .ladder_records import EarlierResult, LadderResult, Materials
from .material_sample import Squares, packed
from .model_prediction import METAL_LAYERS, Decision, Fitted, ModelPrediction, solves_metals, worth
from .paint_beside_metal import METAL, explains_better, metal_of, parts_of, take_parts, unexplained
from .paper_swarm import PaperSwarm
from .solver import Solver
from .specular_level import LevelSearch
from .texel_records import WELL_KNOWN, RoughnessMaps, SolvedTexels, read_support
from .tilt_size import tilt_size

SAMPLE = 64  # texels: width of the square on which larger models are tried
SAMPLES = 2  # squares of each material


class Ladder:
    """Solves for a model, or for the one that each material needs."""

    def __init__(
        self, device: Device, source: Source, settings: SolveSettings, materials: Materials,
        last: EarlierResult | None = None, before: PriorKnowledge | None = None, *, scale_known: bool = True,
    ) -> None:
        """``before``: as of `Solver`.  ``scale_known``: as of `core.models.choose`."""
        self.scale_known = scale_known
        self.device, self.source, self.settings, self.last = device, source, settings, last or EarlierResult()
        lobes = self.last.lobes
        self.start = None if lobes is None else device.texture(lobes.shape[1], lobes.shape[0], data=lobes)
        self.solver = Solver(device, source, settings, start=self.start, before=before)
        self.masks = materials.masks()
        self.levels = LevelSearch(device, settings, self.last)
        # By material, where prediction has chosen them:
        self.priors: dict[str, JointPrior] = dict(self.last.priors)
        self.decided_metallic: dict[str, float] = dict(self.last.metallic)
        self.decided_levels: dict[str, float] = {
            name: level for name, level in self.last.levels.items()
            if name in self.last.metallic or name in self.last.coats or name in self.last.diffuse_roughness}
        self.decided_coats: dict[str, Coat] = dict(self.last.coats)
        self.decided_rough: dict[str, float] = dict(self.last.diffuse_roughness)
        self.paint: dict[str, Bool] = {}  # (h, w) of materials in which metal was found beside it
        # Of texels without a prior, where there are such: blocks of a map go by them.  A material's prior makes others.
        self.noise: dict[int, Noise] = {}
        self.robust: bool | None = None
        self.fitted_levels: dict[str, float] = {}  # by material, where evidence has tried another than 0.5

    def solve(self) -> Generator[Progress, None, LadderResult]:
        """Climb as far as the settings say, or the data pay for."""
        model = self.settings.model
        if self.settings.method == "paper":
            return (yield from self._paper())
        yield from self._size_tilts()
        if model == "two-lobe":
            result = self._read((yield from self.solver.solve_two()))
        elif model == "one-lobe-specular":
            result = yield from self._specular(list(self.masks))
        elif model == "one-lobe-metallic":
            result = yield from self._metallic(list(self.masks))
        elif model == "auto":
            result = yield from self._auto()
        else:
            result = self._read((yield from self.solver.solve()))
        present = [name for name, mask in self.masks.items() if mask.any()]
        if model == "auto":
            result.painted |= self.last.painted  # also where none of the paint is here
        else:
            result.model, result.why = dict.fromkeys(present, model), dict.fromkeys(present, "chosen")
        result.cancelled, result.priors = self.solver.cancelled, self.priors
        result.noise, result.robust = self.solver.noise_of | self.noise, (
            self.solver.robust if self.robust is None else self.robust)
        return result

    def _size_tilts(self) -> Generator[Progress, None, None]:
        """By how much normals are off: blocks of a map go by what the small map has shown."""
        if self.source.tilts is None:
            return
        noise, texels = self.solver.before.noise, np.logical_or.reduce(list(self.masks.values()))
        if noise:
            deviation = next(iter(noise.values())).tilt
        elif texels.any() and isinstance(self.source, CameraSource):
            deviation = yield from tilt_size(self.device, self.source, texels, self.settings)
        else:
            return
        self.source.tilts = replace(self.source.tilts, deviation=deviation)

    def _read(self, maps: RoughnessMaps) -> LadderResult:
        result = LadderResult(maps.read(self.device), lobes=maps.read_pairs(self.device))
        maps.release()
        return result

    def _paper(self) -> Generator[Progress, None, LadderResult]:
        """The swarm as published: every number searched, nothing shared but its equation (4)."""
        model = "one-lobe" if self.settings.model == "auto" else self.settings.model
        with self.device.scope():
            swarm = PaperSwarm(self.device, self.source, self.settings, model)
            maps = yield from swarm.solve()
            best, more = self.device.read(maps.best).copy(), self.device.read(maps.more).copy()
        seen = more[..., 3] > 0
        unknown = np.full(seen.shape, 0.5, np.float32)  # the method gives no standard errors
        texels = SolvedTexels(best[..., 3], unknown, unknown, seen, observations=seen.astype(np.float32),
                              residual=more[..., 2], lambert_residual=unknown, base_sigma=unknown)
        result = LadderResult(texels, base=best[..., :3])
        if model == "two-lobe":
            result.lobes = np.stack([best[..., 3], more[..., 0], more[..., 1]], -1)
        result.model = dict.fromkeys(self.masks, model)
        result.why = dict.fromkeys(self.masks, "method paper searches one model for all")
        result.cancelled = swarm.cancelled
        return result

    # ---- evidence

    def _auto(self) -> Generator[Progress, None, LadderResult]:
        """The model of each material by what its texels' own searches show; then its numbers."""
        with self.device.scope() as owned:
            searched = yield from self.solver.searched()
            result = self._read(self.solver.alone(searched))
            larger = yield from self._climb(result)
            if any(name not in self.priors for name in larger.get("one-lobe", [])):
                result.texels = self._read((yield from self.solver.among_neighbours(searched))).texels
                self.noise, self.robust = {1: self.solver.noise_of[1]}, self.solver.robust
            owned.hand_over(self.solver.noise_map)
        yield from self._find_metals(result, larger)
        yield from self._solve_larger(result, larger)
        return result

    def _climb(self, result: LadderResult) -> Generator[Progress, None, dict[str, list[str]]]:
        """From one lobe down to none, or up, by each material's evidence.  Returns materials by model."""
        larger: dict[str, list[str]] = {}
        for name, mask in self.masks.items():
            texels = mask & result.texels.solved
            if not texels.any():
                result.model.pop(name, None)
                result.why.pop(name, None)
                continue
            if name in self.last.model:
                result.model[name], result.why[name] = self.last.model[name], "as in the last result"
                larger.setdefault(result.model[name], []).append(name)
                continue
            fitted = result.texels
            none = Fit(fitted.lambert_residual, np.zeros_like(fitted.residual))
            one = Fit(fitted.residual, np.ones_like(fitted.residual))  # in full: no lobe needs no neighbours
            result.model[name], result.why[name] = self._choose(texels, fitted.observations, lambert=none, one_lobe=one)
            if result.model[name] == "one-lobe" and not self.solver.cancelled:
                result.model[name], result.why[name] = yield from self._try_larger(name, texels, result)
            if not self.solver.cancelled:
                yield from self._predict(name, texels, result)
            larger.setdefault(result.model[name], []).append(name)
        return larger

    def _solve_larger(self, result: LadderResult, larger: dict[str, list[str]]) -> Generator[Progress, None, None]:
        """What a search for one lobe at level 0.5 does not answer; changes ``result``."""
        for name in (name for name in larger.get("one-lobe", []) if name in self.priors or name in self.decided_rough):
            self._put(result, (yield from self._one_lobe(name)), [name])
        for name in larger.get("one-lobe-specular", []):
            decided = (name in self.decided_levels or name in self.decided_coats or name in self.decided_rough
                       or self._levels_differ(name))
            solved = self._one_lobe(name) if decided else self._specular([name])
            self._put(result, (yield from solved), [name])
        if "one-lobe-metallic" in larger:
            names, without = larger["one-lobe-metallic"], result.texels
            part = yield from self._metallic(names)
            metals = np.logical_or.reduce([self.masks[name] for name in names]) & part.texels.solved
            result.plain = explains_better(without, part.texels, metals)
            self._put(result, part, names)
            for name in names:
                yield from self._beside_paint(name, without, part.texels, result)
        if "two-lobe" in larger:
            names = larger["two-lobe"]
            maps = yield from self.solver.solve_two(self._tiles(self.solver, names))
            self._put(result, self._read(maps), names)

    def _predict(self, name: str, texels: Bool, result: LadderResult) -> Generator[Progress, None, None]:
        """Keep the model, or take another one that predicts better what left-out lamps show."""
        if self.settings.method == "draft":
            return
        decision = yield from ModelPrediction(self.device, self.source, self.settings).decide(
            texels, Fitted(result.model[name], self.fitted_levels.get(name, 0.5)))
        if decision.cancelled:
            self.solver.cancelled = True
            return
        result.why[name] = f"{decision.why}; within the fit, {result.model[name]} by {result.why[name]}"
        result.model[name] = decision.model
        if decision.prediction is not None:
            result.predictions[name] = decision.prediction
        if decision.prior is not None:
            self.priors[name] = decision.prior
            if decision.prior.one_value:
                sigma = _one_value_error(result.texels, texels, decision, decision.prior.sigma)
                self.priors[name] = replace(decision.prior, sigma=sigma)
        if decision.level is not None:
            self.decided_levels[name] = decision.level
        if decision.metallic > 0:
            self.decided_metallic[name] = decision.metallic
        if decision.coat is not None:
            self.decided_coats[name] = decision.coat
        if decision.diffuse_roughness > 0:
            self.decided_rough[name] = decision.diffuse_roughness

    def _one_lobe(self, name: str, paint: bool = False) -> Generator[Progress, None, LadderResult]:
        """One lobe of a material under its prior, at what is decided: level (else 0.5), Metallic (else 0), coat, and
        Diffuse Roughness.

        ``paint``: of the part that is no metal, for which neither prior nor Metallic holds.
        """
        level = unsure = None
        if name in self.decided_levels:
            level = np.full(self.masks[name].shape, self.decided_levels[name], np.float32)
        elif self._levels_differ(name):
            ((level, unsure),) = yield from self.solver.levels_under(
                [self.priors[name]], self._tiles(self.solver, [name]))
        self.solver.use_level(level)
        self.solver.use_metallic(0.0 if paint else self.decided_metallic.get(name, 0.0))
        self.solver.use_coat(self.decided_coats.get(name))
        self.solver.use_diffuse_roughness(self.decided_rough.get(name, 0.0))
        self.solver.joint = None if paint else self.priors.get(name)
        part = self._read((yield from self.solver.solve(self._tiles(self.solver, [name]))))
        self.solver.joint = None
        self.solver.use_level(None)
        self.solver.use_metallic(0.0)
        self.solver.use_coat(None)
        self.solver.use_diffuse_roughness(0.0)
        if unsure is not None:
            sigma = np.minimum(np.hypot(part.texels.sigma, np.sqrt(unsure)), np.float32(0.5))
            part.texels = replace(part.texels, sigma=sigma)
        if level is not None:
            part.level = np.where(self.masks[name], level, np.float32(0.5))
        if name in self.decided_levels:
            part.levels = {name: self.decided_levels[name]}
        if name in self.decided_metallic:
            part.metallic = {name: self.decided_metallic[name]}
        if name in self.decided_coats:
            part.coats = {name: self.decided_coats[name]}
        if name in self.decided_rough:
            part.diffuse_roughness = {name: self.decided_rough[name]}
        return part

    def _levels_differ(self, name: str) -> bool:
        """Whether each texel of a material has its own level, under the material's prior."""
        return name in self.priors and self.priors[name].level_strength > 0

    def _metallic(self, names: list[str]) -> Generator[Progress, None, LadderResult]:
        """One lobe of each material with its Metallic and Specular IOR Level."""
        if not solves_metals(self.device, self.solver.source):
            raise BadInput(f"model one-lobe-metallic: without a GPU it takes at most {METAL_LAYERS} views, a third of "
                           "that under coloured lamps; leave views out, or choose another model")
        names = [name for name in names if self.masks[name].any()] or names
        result: LadderResult | None = None
        for name in names:
            if name not in self.decided_metallic:
                one = ModelPrediction(self.device, self.source, self.settings).metal(self.masks[name])
                self.decided_metallic[name], self.decided_levels[name] = one.metallic, one.level
            part = yield from self._one_lobe(name)
            if result is None:
                result = part
            else:
                self._put(result, part, [name])
            if self.solver.cancelled:
                break
        assert result is not None
        return result

    def _beside_paint(
        self, name: str, without: SolvedTexels, metal: SolvedTexels, result: LadderResult,
    ) -> Generator[Progress, None, None]:
        """Metal and paint in one material, each solved by itself, where there are both; changes ``result``.

        ``without``: its texels solved without Metallic.  ``metal``: with one Metallic for all.
        """
        again = name in self.last.painted
        if self.solver.cancelled or name in self.decided_coats or (name in self.last.model and not again):
            return
        mask, before = self.masks[name], self.last.paint if again else self.paint.get(name)
        parts = parts_of(without, metal, mask, before)
        if parts is not None and before is None:
            yield from self._decide_metal(name, parts.inner_metal, result)
            if self.solver.cancelled:
                return
            metal = (yield from self._one_lobe(name)).texels
            parts = parts_of(without, metal, mask, parts.paint)
        if parts is None:
            return
        if not (self.scale_known or again):
            level = yield from self._level({name: parts.paint}, by_texel=False)
            self.decided_levels[name] = float(level[parts.paint][0])
        take_parts(result, name, mask, parts)
        done = ~mask
        for texels, paint in ((parts.metal, False), (parts.paint, True)):
            if texels.any():
                self.solver.use_texels(texels)
                part = yield from self._one_lobe(name, paint)
                self._put(result, part, [name])
                done |= part.texels.solved
        self.solver.use_texels(None)
        result.texels = replace(result.texels, solved=result.texels.solved & done)  # fewer when stopped

    def _find_metals(self, result: LadderResult, larger: dict[str, list[str]]) -> Generator[Progress, None, None]:
        """Metal in materials that prediction took for paint, as where paint is chipped; changes both."""
        for model in [model for model in larger if model != "one-lobe-metallic"]:
            for name in [name for name in larger[model] if name not in self.last.model]:
                yield from self._find_metal(name, result)
                if result.model[name] != model:
                    larger[model].remove(name)
                    larger.setdefault("one-lobe-metallic", []).append(name)
            if not larger[model]:
                del larger[model]

    def _find_metal(self, name: str, result: LadderResult) -> Generator[Progress, None, None]:
        """That of one material; changes ``result``.

        Its texels are searched again with a Metallic where far more is left of them than of most.
        """
        prediction = result.predictions.get(name)
        if (self.solver.cancelled or prediction is None or not worth(prediction.error)
                or not solves_metals(self.device, self.solver.source)):
            return
        texels = self.masks[name] & result.texels.solved
        odd = unexplained(result.texels, texels)
        if odd is None:
            return
        one = ModelPrediction(self.device, self.source, self.settings).metal(odd)
        if one.metallic < METAL:
            return
        decided: tuple[dict[str, Any], ...] = (
            self.priors, self.decided_metallic, self.decided_levels, self.decided_coats, self.decided_rough)
        kept, why = [values.pop(name, None) for values in decided], result.why[name]
        noise, robust = dict(self.solver.noise_of), self.solver.robust
        self.decided_metallic[name], self.decided_levels[name] = one.metallic, one.level
        self.solver.use_texels(odd)
        metal = (yield from self._one_lobe(name)).texels
        self.solver.use_texels(None)
        parts = None if self.solver.cancelled else metal_of(result.texels, metal, texels)
        if parts is not None and (yield from self._decide_metal(name, parts.inner_metal, result)):
            yield from self._judge_paint(name, parts.inner_paint, result)
            self.paint[name], result.model[name] = parts.paint, "one-lobe-metallic"
            return
        result.why[name], self.solver.noise_of, self.solver.robust = why, noise, robust
        for values, value in zip(decided, kept, strict=True):
            values.pop(name, None)
            if value is not None:
                values[name] = value

    def _judge_paint(self, name: str, texels: Bool, result: LadderResult) -> Generator[Progress, None, None]:
        """How well one lobe predicts the paint beside a metal: the part that is predicted worse stands for both."""
        found = yield from ModelPrediction(self.device, self.source, self.settings).decide(texels, Fitted("one-lobe"))
        self.solver.cancelled |= found.cancelled
        if found.prediction is not None:
            result.predictions[name] = max(
                result.predictions[name], found.prediction, key=lambda part: (not part.fits, part.error.relative_rms))

    def _decide_metal(self, name: str, texels: Bool, result: LadderResult) -> Generator[Progress, None, bool]:
        """Metallic and prior of a material's metal alone, (h, w) ``texels``; of the material where it is no mere metal.

        Returns whether prediction takes a metal.
        The prior of metal and paint together holds for neither, and the level is the paint's: a metal's hardly shows.
        """
        found = yield from ModelPrediction(self.device, self.source, self.settings).decide(texels, Fitted("one-lobe"))
        self.solver.cancelled |= found.cancelled
        if found.cancelled:
            return False
        self.decided_levels.pop(name, None)
        self.priors.pop(name, None)
        result.why[name] = f"paint beside metal: of the metal alone, {found.why}; of all, {result.why[name]}"
        metal = found.model == "one-lobe-metallic" and found.coat is None
        if metal:
            self.decided_metallic[name] = found.metallic
            if found.prior is not None:
                self.priors[name] = found.prior
            if found.prediction is not None:
                result.predictions[name] = found.prediction
        return metal

    def _choose(self, texels: Bool, observations: F32, **fits: Fit) -> tuple[str, str]:
        h, w = texels.shape
        row, column = np.mgrid[:h, :w] // CELL
        cells = (row * (w // CELL + 1) + column).astype(np.int32)
        chosen = {name.replace("_", "-"): Fit(fit.residual[texels], fit.searched[texels]) for name, fit in fits.items()}
        return choose(observations[texels], chosen, cells[texels], self.source.model_error,
                      self.source.least_gain, self.scale_known)

    def _try_larger(self, name: str, texels: Bool, result: LadderResult) -> Generator[Progress, None, tuple[str, str]]:
        """Two lobes, and another specular level, on the squares where a material is seen best.

        All by squares: what one lobe does not explain would else be disbelieved as outliers, and speak for no other.
        """
        with self.device.scope():
            squares = Squares(tuple(_best_seen(texels, result.texels.observations)), SAMPLE)
            packed_source = packed(self.device, self.source, texels, squares)
            solver = Solver(self.device, packed_source, replace(self.settings, loss="squares"),
                            start=self._start_of(squares))
            solver.shown = False
            sample = packed_source.covered
            plain = self._read((yield from solver.solve())).texels
            two = self._read((yield from solver.solve_two())).texels
            one = np.ones_like(plain.residual)
            fits = {"lambert": Fit(plain.lambert_residual, np.zeros_like(one)),
                    "one_lobe": Fit(plain.residual, one),
                    "two_lobe": Fit(two.residual, one + two.determined - plain.determined)}
            if not self.scale_known or (yield from self.levels.differs(solver, sample)):
                level = yield from self.levels.levels(solver, {name: sample}, tiles(solver.atlas, sample))
                self.fitted_levels[name] = float(level[sample][0])
                solver.use_level(level)
                other = self._read((yield from solver.solve())).texels
                fits["one_lobe_specular"] = Fit(other.residual, one)
        if solver.cancelled:
            self.solver.cancelled = True
            return result.model[name], result.why[name]
        return self._choose(sample, plain.observations, **fits)

    def _start_of(self, squares: Squares) -> moderngl.Texture | None:
        if self.start is None:
            return None
        data = squares.pack_texture(self.device, self.start)
        return self.device.texture(data.shape[1], data.shape[0], data=data)

    def _tiles(self, solver: Solver, names: Iterable[str]) -> list[Tile]:
        wanted = np.logical_or.reduce([self.masks[name] for name in names])
        return tiles(solver.atlas, wanted)

    def _put(self, result: LadderResult, part: LadderResult, names: list[str]) -> None:
        """Take over what another model found for some materials."""
        inside = np.logical_or.reduce([self.masks[name] for name in names]) & part.texels.solved
        if part.lobes is not None:
            r = result.texels.roughness
            result.lobes = np.where(inside[..., None], part.lobes, np.stack([r, r, np.ones_like(r)], -1))
        if part.level is not None:
            before = np.full_like(part.level, 0.5) if result.level is None else result.level
            result.level = np.where(inside, part.level, before)
        result.texels = result.texels.where(inside, part.texels)
        result.levels |= part.levels
        result.metallic |= part.metallic
        result.coats |= part.coats
        result.diffuse_roughness |= part.diffuse_roughness

    # ---- Specular IOR Level

    def _specular(self, names: list[str]) -> Generator[Progress, None, LadderResult]:
        """One lobe with the level that fits, one for each material or by texel."""
        by_texel = self.settings.specular == "texel"
        names = [name for name in names if self.masks[name].any()] or names
        masks = {name: self.masks[name] for name in names}
        level = yield from self._level(masks, by_texel)
        self.solver.use_level(level)
        self.solver.shown = True
        if len(names) == 1 and names[0] in self.priors:  # of an earlier result
            self.solver.joint = self.priors[names[0]]
        result = self._read((yield from self.solver.solve(self._tiles(self.solver, names))))
        self.solver.joint = None
        self.solver.use_level(None)
        result.level = level
        if not by_texel:
            result.levels = {name: float(level[mask][0]) for name, mask in masks.items()
                             if mask.any() and (name not in self.last.fixed or name in self.last.levels)}
        return result

    def _level(self, masks: dict[str, Bool], by_texel: bool) -> Generator[Progress, None, F32]:
        """The level of some materials' texels, found on all of these or, one for each material, on samples."""
        with self.device.scope():
            solver = self.solver if by_texel else Solver(
                self.device, self.source, self.settings, (SAMPLE, SAMPLE), self.start)
            solver.shown = False
            places = tiles(solver.atlas, np.logical_or.reduce(list(masks.values())))
            if not by_texel and not self.last.fixed.issuperset(masks):
                _, support = yield from solver.search(places)
                seen = read_support(self.device, support).observations
                places = [place for mask in masks.values() for place in _best_seen(mask, seen)]
            level = yield from self.levels.levels(solver, masks, places)
            self.solver.cancelled |= solver.cancelled
            return level

    def release(self) -> None:
        """Free the solver and where it began."""
        self.solver.release()
        if self.start is not None:
            self.start.release()


def _one_value_error(found: SolvedTexels, texels: Bool, decision: Decision, sigma: float) -> float:
    """Standard error of one value, which is wrong as far as texels differ; ``sigma``: that of what is right for all.

    ``found``: their own searches, which know neither level nor Diffuse Roughness, so that they say little beside these.
    """
    if decision.differ:
        sigma = math.hypot(sigma, found.spread(texels))
    if decision.model == "one-lobe" and decision.diffuse_roughness == 0:
        # The larger one: that the lobes of some texels are blurred more by pixels makes both.
        sigma = max(sigma, found.spread(texels, WELL_KNOWN))
    return sigma


def _best_seen(texels: Bool, observations: F32) -> list[Tile]:
    """The squares of SAMPLE texels that hold the most observations of a material."""
    seen = np.where(texels, observations, 0.0)
    height, width = texels.shape
    corners = [(x, y) for y in range(0, height, SAMPLE) for x in range(0, width, SAMPLE)
               if texels[y:y + SAMPLE, x:x + SAMPLE].any()]
    worth = {(x, y): float(seen[y:y + SAMPLE, x:x + SAMPLE].sum()) for x, y in corners}
    return sorted(worth, key=lambda tile: -worth[tile])[:SAMPLES]
