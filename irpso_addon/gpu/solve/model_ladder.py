"""The solve stage: which model each material needs, and its numbers at every texel."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import replace
from typing import Any

import moderngl
import numpy as np

from ...core.data import F32, Bool
from ...core.errors import BadInput, Cancelled
from ...core.job import Progress, share_of
from ...core.models import CELL, Fit, choose
from ...core.params import SolveSettings
from ...core.tiled.tiled_plan import Noise, PriorKnowledge
from ..device.context import Device
from ..observe.observation_atlas import CameraSource, Source, tiles
from .ladder_records import EarlierResult, LadderResult, Materials
from .material_sample import Squares, packed
from .material_solves import SAMPLE, MaterialSolves, best_seen
from .metal_ladder import MetalLadder
from .model_prediction import Decision, ModelPrediction, solves_metals
from .paint_beside_metal import explains_better
from .paper_swarm import PaperSwarm
from .prediction_trials import Fitted
from .solver import Solver
from .texel_records import WELL_KNOWN, SolvedTexels
from .tilt_size import tilt_size

TILTS_SHARE = 0.02  # of the progress: to look at how large tilts are


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
        self.solves = MaterialSolves(device, source, settings, self.last, self.solver, self.masks)
        self.metals = MetalLadder(self.solves, scale_known)
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
            result = self.solves.read((yield from self.solver.solve_two()))
        elif model == "one-lobe-specular":
            result = yield from self.solves.specular(list(self.masks))
        elif model == "one-lobe-metallic":
            result = yield from self._metallic(list(self.masks))
        elif model == "auto":
            result = yield from self._auto()
        else:
            result = self.solves.read((yield from self.solver.solve()))
        present = [name for name, mask in self.masks.items() if mask.any()]
        if model == "auto":
            result.painted |= self.last.painted  # also where none of the paint is here
        else:
            result.model, result.why = dict.fromkeys(present, model), dict.fromkeys(present, "chosen")
        result.cancelled, result.priors = self.solver.cancelled, self.solves.priors
        result.noise, result.robust = self.solver.noise_of | self.noise, (
            self.solver.robust if self.robust is None else self.robust)
        return result

    def _size_tilts(self) -> Generator[Progress, None, None]:
        """By how much normals are off: blocks of a map go by what the small map has shown.

        A stop is left to the search, which solves a first tile and ends.
        """
        if self.source.tilts is None:
            return
        noise, texels = self.solver.before.noise, np.logical_or.reduce(list(self.masks.values()))
        if noise:
            deviation = next(iter(noise.values())).tilt
        elif texels.any() and isinstance(self.source, CameraSource):
            steps = tilt_size(self.device, self.source, texels, self.settings)
            try:
                deviation = yield from share_of(steps, 0.0, TILTS_SHARE)
            except Cancelled:
                self.solver.cancelled = True
                return
        else:
            return
        self.source.tilts = replace(self.source.tilts, deviation=deviation)

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
            result = self.solves.read(self.solver.alone(searched))
            larger = yield from self._climb(result)
            if any(self.solves.decided[name].prior is None for name in larger.get("one-lobe", [])):
                result.texels = self.solves.read((yield from self.solver.among_neighbours(searched))).texels
                self.noise, self.robust = {1: self.solver.noise_of[1]}, self.solver.robust
            owned.hand_over(self.solver.noise_map)
        yield from self.metals.find(result, larger)
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
                if name in self.last.predictions:
                    result.predictions[name] = self.last.predictions[name]
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
        solves, decided = self.solves, self.solves.decided
        for name in larger.get("one-lobe", []):
            if decided[name].prior is not None or decided[name].diffuse_roughness is not None:
                result.take((yield from solves.one_lobe(name)), self.masks[name])
        for name in larger.get("one-lobe-specular", []):
            one = decided[name]
            known = one.levels_differ or (one.level, one.coat, one.diffuse_roughness) != (None, None, None)
            solved = solves.one_lobe(name) if known else solves.specular([name])
            result.take((yield from solved), self.masks[name])
        if "one-lobe-metallic" in larger:
            names, without = larger["one-lobe-metallic"], result.texels
            part = yield from self._metallic(names)
            metals = self._texels(names)
            result.plain = explains_better(without, part.texels, metals & part.texels.solved)
            result.take(part, metals)
            for name in names:
                yield from self.metals.beside_paint(name, without, part.texels, result)
        if "two-lobe" in larger:
            names = larger["two-lobe"]
            maps = yield from self.solver.solve_two(solves.tiles(names))
            result.take(solves.read(maps), self._texels(names))

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
        numbers: dict[str, Any] = {"level": decision.level, "coat": decision.coat, "prior": decision.prior,
                                   "metallic": decision.metallic or None,
                                   "diffuse_roughness": decision.diffuse_roughness or None}
        if decision.prior is not None and decision.prior.one_value:
            sigma = _one_value_error(result.texels, texels, decision, decision.prior.sigma)
            numbers["prior"] = replace(decision.prior, sigma=sigma)
        self.solves.decide(name, **{key: value for key, value in numbers.items() if value is not None})

    def _metallic(self, names: list[str]) -> Generator[Progress, None, LadderResult]:
        """One lobe of each material with its Metallic and Specular IOR Level."""
        if not solves_metals(self.device, self.solver.source):
            raise BadInput("model one-lobe-metallic: there are more views than it can take without a GPU; leave views "
                           "out, or choose another model")
        names = [name for name in names if self.masks[name].any()] or names
        result: LadderResult | None = None
        for name in names:
            if self.solves.decided[name].metallic is None:
                one = ModelPrediction(self.device, self.source, self.settings).metal(self.masks[name])
                self.solves.decide(name, metallic=one.metallic, level=one.level)
            part = yield from self.solves.one_lobe(name)
            if result is None:
                result = part
            else:
                result.take(part, self.masks[name])
            if self.solver.cancelled:
                break
        assert result is not None
        return result

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
            squares = Squares(tuple(best_seen(texels, result.texels.observations)), SAMPLE)
            packed_source = packed(self.device, self.source, texels, squares)
            solver = Solver(self.device, packed_source, replace(self.settings, loss="squares"),
                            start=self._start_of(squares))
            solver.shown = False
            sample = packed_source.covered
            plain = self.solves.read((yield from solver.solve())).texels
            two = self.solves.read((yield from solver.solve_two())).texels
            one = np.ones_like(plain.residual)
            fits = {"lambert": Fit(plain.lambert_residual, np.zeros_like(one)),
                    "one_lobe": Fit(plain.residual, one),
                    "two_lobe": Fit(two.residual, one + two.determined - plain.determined)}
            if not self.scale_known or (yield from self.solves.levels.differs(solver, sample)):
                level = yield from self.solves.levels.levels(solver, {name: sample}, tiles(solver.atlas, sample))
                self.fitted_levels[name] = float(level[sample][0])
                solver.use_level(level)
                other = self.solves.read((yield from solver.solve())).texels
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

    def _texels(self, names: list[str]) -> Bool:
        """(h, w) those of some materials."""
        return np.asarray(np.logical_or.reduce([self.masks[name] for name in names]))

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
