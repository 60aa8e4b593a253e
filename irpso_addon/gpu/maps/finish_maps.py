"""The maps stage: base colour to what was found, holes filled, seams padded, and how sure each texel is."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import moderngl
import numpy as np

from ...core.data import F32, I32, Bool, Maps, SceneData
from ...core.job import Progress
from ..device.context import Device
from ..gbuffer.gbuffer import GBufferMaps
from ..observe.observations import Observations
from ..solve import live_readback
from ..solve.model_ladder import LadderResult
from .albedo import ITERATIONS, AlbedoSolver
from .fill import fill
from .partial_solve import PartialSolve


@dataclass(frozen=True)
class CoarseSurroundings:
    """What is known of a block's coarse cells from before, (h, w, 3) each: its larger holes are filled from it."""

    base: F32
    lobes: F32
    level: F32


@dataclass(frozen=True)
class FinishedMaps:
    """The maps, and what they were made from; the textures go with `release`."""

    maps: Maps
    found: LadderResult  # joined to what was kept
    good: Bool  # texels solved, whose base colour some camera shows
    solved: Bool
    shown: Bool  # texels whose base colour some camera shows
    relative: F32  # RMS relative residual
    albedo: AlbedoSolver
    base: moderngl.Texture  # holes filled
    textures: Sequence[moderngl.Texture]

    def release(self) -> None:
        """Free the textures."""
        for texture in self.textures:
            texture.release()


def make_maps(
    device: Device, scene: SceneData, ndf: str, coverage: Bool, grid: GBufferMaps, observations: Observations,
    found: LadderResult, slots: I32, part: PartialSolve, around: CoarseSurroundings | None = None,
) -> Generator[Progress, None, FinishedMaps]:
    """Solve base colour, fill holes and pad seams.  ``slots``: (h, w) material of each covered texel, -1 elsewhere."""
    solved, observed = found.texels.solved, found.texels.observations
    lambert = _lambert(scene, found, slots)
    relative = live_readback.relative_error(
        np.where(lambert, found.texels.lambert_residual, found.texels.residual), observed)
    found = part.join_found(found, scene.start)
    lobes, level = _filled_lobes(device, found, lambert, around)
    beckmann = ndf == "beckmann" and "two-lobe" in found.model.values()
    albedo = AlbedoSolver(device, grid, observations, lobes, level, beckmann, around.base if around else None)
    if found.base is None:
        base = yield from albedo.solve(iterations=0 if found.cancelled else ITERATIONS)
    else:  # the method has searched it itself
        base = device.texture(grid.position.width, grid.position.height,
                              data=np.concatenate([found.base, solved[..., None]], -1).astype(np.float32))
    own_base = device.read(base)
    shown = own_base[..., 3] > 0.25
    filled_base = filled(device, part.join_base(own_base), around.base if around else None)
    good = solved & shown
    texels = found.texels
    # Without a lobe no roughness was solved for: what can be trusted or not is the base colour.
    rough, sigma = np.where(lambert, np.float32(1), texels.roughness), np.where(lambert, np.float32(0), texels.sigma)
    doubt = np.where(lambert, texels.base_sigma, sigma)
    pairs = device.read(lobes)[..., :3].copy()
    maps = Maps(
        base_color=device.read(filled_base)[..., :3].copy(),
        roughness=pairs[..., 0].copy(),
        confidence=np.where(good, confidence(rough, doubt, observed, good), np.float32(0)),
        error=np.where(good, relative, 0.0).astype(np.float32),
        filled=~(good | part.known),
        coverage=coverage,
        roughness_sigma=np.where(good, sigma, 0.0).astype(np.float32),
        base_sigma=np.where(good, texels.base_sigma, 0.0).astype(np.float32),
        lobes=pairs if found.lobes is not None else None,
        specular=device.read(level)[..., 0].copy() if level is not None and found.level is not None else None,
    )
    maps = part.join_maps(maps, part.share(good))
    textures = [texture for texture in (base, filled_base, lobes, level) if texture is not None]
    return FinishedMaps(maps, found, good, solved, shown, relative, albedo, filled_base, textures)


def _lambert(scene: SceneData, found: LadderResult, slots: I32) -> Bool:
    """(h, w) texels of materials without a lobe."""
    names = enumerate(scene.mesh.slot_names)
    return np.isin(slots, [slot for slot, name in names if found.model.get(name) == "lambert"])


def _filled_lobes(
    device: Device, found: LadderResult, lambert: Bool, around: CoarseSurroundings | None,
) -> tuple[moderngl.Texture, moderngl.Texture | None]:
    """(roughness1, roughness2, weight) and, where some material's is not 0.5, Specular IOR Level; holes filled."""
    r, known = found.texels.roughness, found.texels.solved.astype(np.float32)
    lobes = np.stack([r, r, np.ones_like(r)], -1) if found.lobes is None else found.lobes
    lobes = np.where(lambert[..., None], np.float32(1.0), lobes)  # any roughness renders alike; 1 reads as "no gloss"
    lobes = np.concatenate([lobes, known[..., None]], -1)
    filled_level = None
    if found.level is not None or "lambert" in found.model.values():
        level = np.full_like(r, 0.5) if found.level is None else found.level
        level = np.where(lambert, np.float32(0.0), level)
        filled_level = filled(device, np.stack([level, level, level, known], -1), around.level if around else None)
    return filled(device, lobes, around.lobes if around else None), filled_level


def filled(device: Device, values: F32, around: F32 | None = None) -> moderngl.Texture:
    """The texture of (h, w, 4) values with holes (alpha 0) filled."""
    known = device.texture(values.shape[1], values.shape[0], data=values.astype(np.float32))
    result = fill(device, known, around)
    known.release()
    return result


def confidence(roughness: F32, sigma: F32, observations: F32, solved: Bool) -> F32:
    """(h, w) 0 to 1: half where the standard error of roughness is 0.05; nothing from edges of shadow alone.

    Where a texel departs from the median of 3 x 3 by more than that, its departure is taken: data that are wrong, not
    noisy, make texels sure of different things.
    """
    around = np.pad(np.where(solved, roughness, np.nan), 1, constant_values=np.nan)
    h, w = roughness.shape
    near = np.stack([around[y:y + h, x:x + w] for y in range(3) for x in range(3)])
    near = np.where(np.isnan(near), roughness, near)
    apart = roughness - np.partition(near, 4, axis=0)[4]
    return live_readback.confidence(np.maximum(sigma, np.abs(apart)), observations)
