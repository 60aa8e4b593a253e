"""Metal and paint in one material: which of its texels are which, and the numbers of both."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

from ...core.data import Bool, MaterialPrediction
from ...core.job import Progress
from .drawn_base_trials import CLEAR
from .ladder_records import LadderResult
from .material_solves import Decided, MaterialSolves
from .model_prediction import ModelPrediction, solves_metals, worth
from .paint_beside_metal import METAL, metal_of, parts_of, take_parts, unexplained
from .prediction_trials import METALS, Fitted
from .texel_records import SolvedTexels


class MetalLadder:
    """What `Ladder` does for metal beside paint."""

    def __init__(self, solves: MaterialSolves, scale_known: bool) -> None:
        """``scale_known``: as of `core.models.choose`."""
        self.solves, self.solver, self.scale_known = solves, solves.solver, scale_known
        self.prediction = ModelPrediction(solves.device, solves.source, solves.settings)
        self.paint: dict[str, Bool] = {}  # (h, w) of materials in which metal was found beside it

    def beside_paint(
        self, name: str, without: SolvedTexels, metal: SolvedTexels, result: LadderResult,
    ) -> Generator[Progress, None, None]:
        """Metal and paint in one material, each solved by itself, where there are both; changes ``result``.

        ``without``: its texels solved without Metallic.  ``metal``: with one Metallic for all.
        """
        solves, last = self.solves, self.solves.last
        again = name in last.painted
        coated = solves.decided[name].coat is not None
        if self.solver.cancelled or coated or (name in last.model and not again):
            return
        mask, before = solves.masks[name], last.paint if again else self.paint.get(name)
        parts = parts_of(without, metal, mask, before)
        if parts is not None and before is None:
            yield from self._decide_metal(name, parts.inner_metal, result)
            if self.solver.cancelled:
                return
            metal = (yield from solves.one_lobe(name)).texels
            parts = parts_of(without, metal, mask, parts.paint)
        if parts is None:
            return
        if not (self.scale_known or again):
            level = yield from solves.level({name: parts.paint}, by_texel=False)
            solves.decide(name, level=float(level[parts.paint][0]))
        take_parts(result, name, mask, parts)
        done = ~mask
        for texels, paint in ((parts.metal, False), (parts.paint, True)):
            if texels.any():
                self.solver.use_texels(texels)
                part = yield from solves.one_lobe(name, paint)
                result.take(part, mask)
                done |= part.texels.solved
        self.solver.use_texels(None)
        result.texels = replace(result.texels, solved=result.texels.solved & done)  # fewer when stopped

    def find(self, result: LadderResult, larger: dict[str, list[str]]) -> Generator[Progress, None, None]:
        """Metal in materials that prediction took for paint, as where paint is chipped; changes both.

        ``larger``: materials by model.
        """
        for model in [model for model in larger if model != "one-lobe-metallic"]:
            for name in [name for name in larger[model] if name not in self.solves.last.model]:
                yield from self._find(name, result)
                if result.model[name] != model:
                    larger[model].remove(name)
                    larger.setdefault("one-lobe-metallic", []).append(name)
            if not larger[model]:
                del larger[model]

    def _find(self, name: str, result: LadderResult) -> Generator[Progress, None, None]:
        """That of one material; changes ``result``.

        Its texels are searched again with a Metallic where far more is left of them than of most.
        """
        solves, prediction = self.solves, result.predictions.get(name)
        if (self.solver.cancelled or prediction is None or not worth(prediction.error)
                or not solves_metals(solves.device, self.solver.source)):
            return
        texels = solves.masks[name] & result.texels.solved
        odd = unexplained(result.texels, texels)
        if odd is None:
            return
        one = self.prediction.metal(odd)
        if one.metallic < METAL:
            return
        kept, why = solves.decided[name], result.why[name]
        noise, robust = dict(self.solver.noise_of), self.solver.robust
        solves.decided[name] = Decided(metallic=one.metallic, level=one.level)
        self.solver.use_texels(odd)
        metal = (yield from solves.one_lobe(name)).texels
        self.solver.use_texels(None)
        parts = None if self.solver.cancelled else metal_of(result.texels, metal, texels)
        if parts is not None and (yield from self._decide_metal(name, parts.inner_metal, result)):
            if seems_metal(result.predictions[name]):
                yield from self._judge_paint(name, parts.inner_paint, result)
                self.paint[name], result.model[name] = parts.paint, "one-lobe-metallic"
                return
        solves.decided[name], result.why[name], result.predictions[name] = kept, why, prediction
        self.solver.noise_of, self.solver.robust = noise, robust

    def _judge_paint(self, name: str, texels: Bool, result: LadderResult) -> Generator[Progress, None, None]:
        """How well one lobe predicts the paint beside a metal: the part that is predicted worse stands for both."""
        found = yield from self.prediction.decide(texels, Fitted("one-lobe", beside=True))
        self.solver.cancelled |= found.cancelled
        if found.prediction is not None:
            result.predictions[name] = max(
                result.predictions[name], found.prediction, key=lambda part: (not part.fits, part.error.relative_rms))

    def _decide_metal(self, name: str, texels: Bool, result: LadderResult) -> Generator[Progress, None, bool]:
        """Metallic and prior of a material's metal alone, (h, w) ``texels``; of the material where it is no mere metal.

        Returns whether prediction takes a metal.
        The prior of metal and paint together holds for neither, and the level is the paint's: a metal's hardly shows.
        """
        found = yield from self.prediction.decide(texels, Fitted("one-lobe", beside=True))
        self.solver.cancelled |= found.cancelled
        if found.cancelled:
            return False
        self.solves.decide(name, level=None, prior=None)
        result.why[name] = f"paint beside metal: of the metal alone, {found.why}; of all, {result.why[name]}"
        if found.model != "one-lobe-metallic" or found.coat is not None:
            return False
        self.solves.decide(name, metallic=found.metallic, prior=found.prior)
        if found.prediction is not None:
            result.predictions[name] = found.prediction
        return True


def seems_metal(found: MaterialPrediction) -> bool:
    """Whether what stands out of paint is a metal, which leads: it is predicted, or far better than without Metallic.

    In both errors: of what no model predicts, a metal may flash where others only miss what is bright.
    """
    plain = [error for name, error in found.tried.items() if name not in METALS]
    return found.fits or (
        found.error.relative_rms < (1 - CLEAR) * min(error.relative_rms for error in plain)
        and found.error.lightness < (1 - CLEAR) * min(error.lightness for error in plain))
