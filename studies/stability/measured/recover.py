"""What the product finds of a material, texel by texel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from irpso_addon.core.data import F32, F64, Bool, Coat, MaterialPrediction
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.tables import principled_table
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe.observation_atlas import LEAST_GAIN, MODEL_ERROR, ArraySource, ObservedTexels
from irpso_addon.gpu.solve.ladder_records import LadderResult, Materials
from irpso_addon.gpu.solve.model_ladder import Ladder
from studies.bench.opengl import result

from .rig import NORMAL, Geometry

NAME = "material"
NEAREST = 0.15  # share of the texels by which a uniform material is told


@dataclass(frozen=True)
class Principled:
    """Numbers of the product's models: of one texel, (), or of many, (n,) or (h, w)."""

    model: str  # a rung of core.models.LADDER
    base: F64  # (..., 3)
    roughness: F64  # (...)
    roughness2: F64  # (...) that of the other lobe, where there are two
    weight: F64  # (...) of the lobe with ``roughness``
    level: F64  # (...) Specular IOR Level
    metallic: float = 0.0  # one number for the material
    coat: Coat | None = None
    diffuse_roughness: float = 0.0

    def __call__(self, L: F64, V: F64) -> F64:
        """The BRDF, 1/sr, (..., 3), of directions (..., 3)."""
        if self.model == "two-lobe":
            return brdf.two_lobe(self.base, (self.roughness, self.roughness2, self.weight), L, V, NORMAL, "ggx")
        return brdf.principled(self.base, self.roughness, L, V, NORMAL, self.level, self.metallic, self.coat,
                               self.diffuse_roughness)

    def at(self, places: Any) -> Principled:
        """Those of some texels."""
        return Principled(self.model, self.base[places], self.roughness[places], self.roughness2[places],
                          self.weight[places], self.level[places], self.metallic, self.coat, self.diffuse_roughness)


@dataclass(frozen=True)
class Recovered:
    """Maps (h, w) of one solve."""

    maps: Principled
    solved: Bool
    nearest: F64  # (h, w) 1 - (N.H)^2 of the texel's observation that came nearest to the half vector
    prediction: MaterialPrediction | None = None  # by which ``auto`` chose the rung

    def uniform(self) -> Principled:
        """One value for the whole material: medians over the texels that came nearest to a highlight.

        The others cannot know it, and take the lobe that best explains the model's error far from it.
        """
        near = self.solved & (self.nearest <= np.quantile(self.nearest[self.solved], NEAREST))
        of = self.maps.at(near)
        roughness, roughness2, weight, level = (
            np.asarray(np.median(v)) for v in (of.roughness, of.roughness2, of.weight, of.level))
        return Principled(of.model, np.median(of.base, axis=0), roughness, roughness2, weight, level, of.metallic,
                          of.coat, of.diffuse_roughness)


def recover(device: Device, seen: Geometry, rgb: F32, model: str, **settings: Any) -> Recovered:
    """Solve for one material's maps by ``model``, auto or one of the ladder's rungs.  rgb: (h, w, K, 3), 1/sr."""
    # Lamps and irradiance let ``auto`` leave lamps out and predict the radiance that they show.
    observed = ObservedTexels(rgb, seen.quality, seen.cos_v, seen.lobes, seen.groups, seen.irradiance, seen.lamps)
    source = ArraySource(device, observed, principled_table())
    # No model is exact here, as none is in pictures: those the sources of pictures allow for.
    source.model_error, source.least_gain = MODEL_ERROR, LEAST_GAIN
    h, w = seen.quality.shape[:2]
    slots = np.where((seen.quality > 0).any(-1), 0, -1).astype(np.int32)
    ladder = Ladder(device, source, SolveSettings(size=max(h, w, 16), model=model, **settings),
                    Materials(slots, (NAME,)))
    fitted: LadderResult = result(ladder.solve())
    chosen = fitted.model[NAME]
    level = np.full((h, w), 0.5, np.float32) if fitted.level is None else fitted.level
    if chosen == "lambert":
        level = np.zeros((h, w), np.float32)
    decided = ladder.solves.decided[NAME]
    base = _base(device, ladder, fitted, level)
    for resource in (ladder, source):
        resource.release()
    rough = fitted.texels.roughness.astype(np.float64)
    lobes = fitted.lobes if fitted.lobes is not None else np.stack([rough, rough, np.ones_like(rough)], -1)
    first, second, weight = np.moveaxis(lobes.astype(np.float64), -1, 0)
    maps = Principled(chosen, base, first, second, weight, level.astype(np.float64), decided.metallic or 0.0,
                      decided.coat, decided.diffuse_roughness or 0.0)
    nearest = np.where(seen.quality > 0, seen.lobes[..., 0, 0], 1.0).min(-1).astype(np.float64)
    return Recovered(maps, fitted.texels.solved, nearest, fitted.predictions.get(NAME))


def _base(device: Device, ladder: Ladder, fitted: LadderResult, level: F32) -> F64:
    """Base colour (h, w, 3) of each texel from its own observations."""
    h, w = level.shape
    solver, decided = ladder.solver, ladder.solves.decided[NAME]
    solver.level = device.texture(w, h, 1, level) if np.any(level != 0.5) else None
    solver.use_metallic(decided.metallic or 0.0)
    solver.use_coat(decided.coat)
    solver.use_diffuse_roughness(decided.diffuse_roughness or 0.0)
    lobes = 1 if fitted.lobes is None else 2
    at = fitted.texels
    values = (np.stack([at.roughness, at.sigma, at.determined, at.solved], -1) if fitted.lobes is None
              else np.concatenate([fitted.lobes, fitted.lobes[..., :1]], -1))
    texture = device.texture(w, h, 4, values.astype(np.float32))
    albedo = result(solver.albedo(texture, lobes))
    base = device.read(albedo)[..., :3].astype(np.float64)
    for made in (texture, albedo, *([solver.level] if solver.level else [])):
        made.release()
    solver.level = None
    return base
