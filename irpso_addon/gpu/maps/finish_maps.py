"""The maps stage: base colour to what was found, holes filled, seams padded, and how sure each texel is."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace

import moderngl
import numpy as np

from ...core.checks.solve_checks import CONTRADICTORY
from ...core.data import F32, F64, I32, Bool, Maps, SceneData
from ...core.errors import Cancelled
from ...core.job import Progress
from ...core.maps.barely_shown import within_material
from ...core.maps.mixture import MIXED, between_paints, mixture
from ...core.models import NUMBERS_OF_TWO
from ...core.shading.brdf import ROUGHNESS_MIN
from ..device.context import Device
from ..gbuffer.gbuffer import GBufferMaps
from ..observe.observations import Observations
from ..solve import live_readback
from ..solve.ladder_records import LadderResult
from ..solve.neighbours import NOISE_FLOOR
from ..solve.sparse_ladder import SparseLadder
from ..solve.texel_records import SolvedTexels
from .albedo import ITERATIONS, AlbedoSolver, Gloss
from .drawn_base import draw_bases, drawn_sigmas
from .fill import fill
from .partial_solve import PartialSolve
from .variogram import borrowed_variance

MATERIAL_ALONE = np.float32(0.5)  # times confidence, where nothing tells how much the material's roughness varies
CHANCE, NUMBERS = 2.5, 2.0  # standard errors by which a texel's residual may be off; numbers that its fit takes up
EXCESS = 8.0  # times the square of a residual beyond chance: no edge, but another shape
NO_METAL, METAL = 0.05, 0.95  # Metallic between them is no material's, but a mean of its texels', or of what it lacks
SMOOTHEST = np.float32(1.001 * ROUGHNESS_MIN)  # the search ends here: the truth may be anywhere below
BOUND = 100.0  # strength of a material's prior from which on it holds texels within 7 % of its value: it alone speaks


@dataclass(frozen=True)
class _Believed:
    """Roughness of each texel, and what speaks for it."""

    texels: SolvedTexels
    slots: I32  # (h, w) material of each solved texel that has a lobe, -1 elsewhere
    share: F32  # (h, w) 0..1: how far its own data determine it
    unfit: Bool  # (h, w) that no model explains, or of a material that none does
    bound: Bool  # (h, w) of a material that leaves its texels little choice: by its prior, or by its Metallic

    def without(self, some: Bool) -> _Believed:
        """The same, but that no model explains some texels, (h, w)."""
        return replace(self, unfit=self.unfit | some)


@dataclass(frozen=True)
class CoarseSurroundings:
    """What is known of a block's coarse cells from before, (h, w, 3) each: its larger holes are filled from it."""

    base: F32
    lobes: F32
    level: F32


@dataclass(frozen=True)
class SolvedTexelGrid:
    """What the maps are made from."""

    grid: GBufferMaps  # shows the solved texels alone
    slots: I32  # (h, w) material of each covered texel, -1 elsewhere
    observations: Observations
    ladder: LadderResult
    ndf: str
    sparse: SparseLadder | None = None  # what ``ladder`` was made from, where not every texel was solved


@dataclass(frozen=True)
class FinishedMaps:
    """The maps, and what they were made from; the textures belong to the scope."""

    maps: Maps
    ladder: LadderResult  # joined to what a partial solve leaves as it was
    good: Bool  # texels solved, whose base colour some camera shows
    solved: Bool
    shown: Bool  # texels whose base colour some camera shows
    relative: F32  # RMS relative residual
    contradicted: float  # share of the good texels of whose views the model leaves far more than of its material's
    plain: dict[str, float]  # of metals: share of the good texels that look like no metal, and are solved as one
    paint: dict[str, float]  # of metals that are in part paint: its share of the covered texels
    albedo: AlbedoSolver
    base: moderngl.Texture  # holes filled

    def squared_residuals(self, where: Bool) -> F64:
        """(n,) squares of ``relative``, each at most 1: what is black in all pictures is off by thousands of times."""
        return np.minimum(self.relative[where].astype(np.float64), 1.0) ** 2


def make_maps(
    device: Device, scene: SceneData, texels: SolvedTexelGrid, part: PartialSolve,
    around: CoarseSurroundings | None = None,
) -> Generator[Progress, None, FinishedMaps]:
    """Solve base colour, fill holes and pad seams."""
    own = texels.ladder.texels
    lambert = _lambert(scene, texels)
    relative = live_readback.relative_error(np.where(lambert, own.lambert_residual, own.residual), own.observations)
    joined = part.join_ladder(texels.ladder, scene.start)
    lobes, level = _filled_lobes(device, joined, lambert, around)
    beckmann = texels.ndf == "beckmann" and "two-lobe" in joined.model.values()
    metallic = _filled_metallic(device, scene, texels, joined)
    gloss = Gloss(lobes, level, metallic, _filled_coat(device, scene, texels, joined),
                  _filled_by_material(device, scene, texels, joined.diffuse_roughness),
                  _filled_by_material(device, scene, texels, {
                      name: found.by_light for name, found in joined.predictions.items() if found.by_light}), beckmann)
    albedo = AlbedoSolver(device, texels.grid, texels.observations, gloss, around.base if around else None)
    if joined.base is None:
        base = device.read((yield from albedo.solve(iterations=0 if joined.cancelled else ITERATIONS)))
    else:  # the method has searched it itself
        base = np.concatenate([joined.base, own.solved[..., None]], -1).astype(np.float32)
    if texels.sparse is not None:  # base colour tells where one material ends
        joined = part.join_ladder(texels.sparse.everywhere(base[..., :3]), scene.start)
        lobes, level = _filled_lobes(device, joined, lambert, around)
        metallic = _filled_metallic(device, scene, texels, joined)
        albedo.take(lobes, level, metallic)
    shown = base[..., 3] > 0.25
    own_slots = texels.slots if joined.paint is None else np.where(joined.paint, -1, texels.slots)  # paint has no prior
    drawing = joined.texels.observations, own_slots, scene.mesh.slot_names, texels.ladder.priors
    good = own.solved & shown
    # Of a part, what the last result left elsewhere says what is typical of a material.
    left = relative if part.last is None else np.where(good, relative, part.last.error)
    parts = _parts(scene, texels, joined)
    excess = unexplained(left, own.observations, np.where(good | part.known, parts, -1))
    odd, around_lit = excess > EXCESS, any(view.environment is not None for view in scene.views)
    kept = within_material(draw_bases(base, *drawing), good & ~odd, ~good | odd if around_lit else ~good, parts)
    base_texture = filled(device, part.join_base(kept), around.base if around else None)
    torn = (left > CONTRADICTORY) & odd
    pairs = device.read(lobes)[..., :3].copy()
    believed = _believed(scene, texels, joined, lambert, parts).without(torn)
    try:
        yield Progress(1.0, "maps", "standard errors")
    except Cancelled:  # the maps are of no use without
        albedo.cancelled = True
    painted = device.read(base_texture)[..., :3].copy()
    maps = Maps(
        base_color=painted,
        roughness=pairs[..., 0].copy(),
        error=np.where(good, relative, 0.0).astype(np.float32),
        filled=~(good | part.known),
        coverage=texels.slots >= 0,
        lobes=pairs if joined.lobes is not None else None,
        specular=device.read(level)[..., 0].copy() if level is not None and joined.level is not None else None,
        metallic=device.read(metallic)[..., 0].copy() if metallic is not None and joined.painted else None,
        **_certainty(believed, own.observations, lambert, good,
                     max(albedo.pixels_per_texel, MIXED**-2) ** -0.5, excess, painted,
                     drawn_sigmas(believed.texels.base_sigma * np.sqrt(excess), base, *drawing),
                     around_lit),
    )
    maps = part.join_maps(maps, part.share(good))
    contradicted = float(np.mean(torn[good])) if good.any() else 0.0
    paint = {name: float(np.mean(maps.metallic[_of(scene, texels, [name])] == 0))
             for name in joined.painted} if maps.metallic is not None else {}
    return FinishedMaps(maps, joined, good, own.solved, shown, relative, contradicted, _plain(scene, texels, good),
                        paint, albedo, base_texture)


def _plain(scene: SceneData, texels: SolvedTexelGrid, good: Bool) -> dict[str, float]:
    """By material: the share of a metal's ``good`` texels, (h, w), that look like no metal."""
    plain = texels.ladder.plain
    if plain is None:
        return {}
    own = {name: _of(scene, texels, [name]) & good for name in texels.ladder.metallic
           if name not in texels.ladder.painted}
    return {name: float(np.mean(plain[mine])) for name, mine in own.items() if mine.any()}


def _parts(scene: SceneData, texels: SolvedTexelGrid, joined: LadderResult) -> I32:
    """(h, w) material of each texel, -1 where there is none; of paint beside metal a number of its own."""
    return texels.slots if joined.paint is None else np.where(
        joined.paint & (texels.slots >= 0), texels.slots + len(scene.mesh.slot_names), texels.slots)


def _believed(
    scene: SceneData, texels: SolvedTexelGrid, joined: LadderResult, lambert: Bool, parts: I32,
) -> _Believed:
    """``joined``: what was solved, among what a partial solve leaves as it was.  ``parts``: as of `_parts`."""
    ladder, found = texels.ladder, replace(joined.texels, base_sigma=_base_sigma(scene, texels, joined))
    two = _of(scene, texels, [name for name, model in ladder.model.items() if model == "two-lobe"])
    unfit = _of(scene, texels, [name for name, found in ladder.predictions.items() if not found.fits])
    if ladder.plain is not None:
        unfit |= ladder.plain
    bound = _of(scene, texels, [name for name, prior in ladder.priors.items() if prior.strength >= BOUND]
                + [name for name, value in ladder.metallic.items() if NO_METAL < value < METAL])
    if joined.paint is not None:
        bound &= ~joined.paint  # it has neither
    share = np.clip(found.determined / np.where(two, np.float32(NUMBERS_OF_TWO), np.float32(1)), 0, 1)
    slots = np.where(found.solved & ~lambert, parts, -1)
    return _Believed(found, slots, share.astype(np.float32), unfit, bound)


def _certainty(
    believed: _Believed, observations: F32, lambert: Bool, good: Bool, pixel: float, excess: F32, base: F32,
    base_own: F32, around: bool,
) -> dict[str, F32]:
    """The maps that say how sure each texel is, by role; ``pixel``: its width in texels; ``excess``: `unexplained`.

    ``base``: base colour, holes filled.  ``base_own``: its standard error, paints that meet aside.  ``around``: whether
    a world or meshes that glow light some view.

    Without a lobe no roughness was solved for: what can be trusted or not is the base colour.
    """
    texels = believed.texels
    own = texels.sigma**2 + mixture(texels.roughness, texels.sigma, texels.solved, pixel)
    smoothest = texels.roughness - texels.sigma <= SMOOTHEST
    own += np.where(smoothest, np.float32(ROUGHNESS_MIN**2 / 3), np.float32(0))
    borrowed, told = borrowed_variance(texels.roughness, texels.sigma, believed.share, believed.slots, pixel, base)
    # The less its own data determine it, the more it matters how far it may be off because it is its neighbours'.  From
    # the mean of several data it differs by half of the mean square difference of two (decision 0017).
    error = np.sqrt(own + (1 - believed.share) * np.maximum(borrowed / 2 - own, 0))
    rough, sigma = np.where(lambert, np.float32(1), texels.roughness), np.where(lambert, np.float32(0), error)
    doubt = np.where(lambert, texels.base_sigma, sigma)
    whole = np.where(told & ~believed.bound, np.float32(1), MATERIAL_ALONE)
    sure = confidence(rough, doubt * excess, observations, good) * whole
    # Under lamps a texel's own error of base colour is stated too wide already (decision 0062).
    paints = between_paints(base, base_own, good, pixel) if around else np.float32(0)
    return {"confidence": np.where(good & ~believed.unfit, sure, np.float32(0)),
            "roughness_sigma": np.where(good, sigma, 0.0).astype(np.float32),
            "base_sigma": np.where(good, np.sqrt(base_own**2 + paints), 0.0).astype(np.float32)}


def _base_sigma(scene: SceneData, texels: SolvedTexelGrid, joined: LadderResult) -> F32:
    """(h, w) standard errors of base colour, by the observations of each texel."""
    result = joined.texels.base_sigma.copy()
    for name, found in joined.predictions.items():
        result[_of(scene, texels, [name])] *= np.float32(found.noise_by_light)
    return result


def unexplained(relative: F32, observations: F32, slots: I32) -> F32:
    """(h, w), at least 1: how many times less sure a texel is because its model leaves more than its material's does.

    ``relative``: RMS relative residual.  ``observations``: good ones.  ``slots``: material of each solved texel, -1
    elsewhere.  Noise leaves about the same in each texel of a material.  What leaves more than chance does, such as a
    shadow that the mesh does not cast, is in many of a texel's observations, so that it stays in their mean.
    """
    result = np.ones_like(relative)
    off = 2 / (9 * np.maximum(observations - NUMBERS, 1))
    chance = (1 + CHANCE * np.sqrt(off) / (1 - off)) ** 3  # of chi-squared over its median: Wilson and Hilferty (1931)
    for slot in np.unique(slots[slots >= 0]):
        mine = slots == slot
        typical = max(float(np.median(relative[mine])), NOISE_FLOOR)
        result[mine] = np.maximum((relative[mine] / typical) ** 2 / chance[mine], 1)
    return result


def _lambert(scene: SceneData, texels: SolvedTexelGrid) -> Bool:
    """(h, w) texels of materials without a lobe."""
    return _of(scene, texels, [name for name, model in texels.ladder.model.items() if model == "lambert"])


def _of(scene: SceneData, texels: SolvedTexelGrid, materials: list[str]) -> Bool:
    """(h, w) texels of some materials."""
    return np.isin(texels.slots, [slot for slot, name in enumerate(scene.mesh.slot_names) if name in materials])


def _filled_lobes(
    device: Device, ladder: LadderResult, lambert: Bool, around: CoarseSurroundings | None,
) -> tuple[moderngl.Texture, moderngl.Texture | None]:
    """(roughness1, roughness2, weight) and, where some material's is not 0.5, Specular IOR Level; holes filled."""
    r, known = ladder.texels.roughness, ladder.texels.solved.astype(np.float32)
    lobes = np.stack([r, r, np.ones_like(r)], -1) if ladder.lobes is None else ladder.lobes
    lobes = np.where(lambert[..., None], np.float32(1.0), lobes)  # any roughness renders alike; 1 reads as "no gloss"
    lobes = np.concatenate([lobes, known[..., None]], -1)
    filled_level = None
    if ladder.level is not None or "lambert" in ladder.model.values():
        level = np.full_like(r, 0.5) if ladder.level is None else ladder.level
        level = np.where(lambert, np.float32(0.0), level)
        filled_level = filled(device, np.stack([level, level, level, known], -1), around.level if around else None)
    return filled(device, lobes, around.lobes if around else None), filled_level


def _filled_metallic(
    device: Device, scene: SceneData, texels: SolvedTexelGrid, ladder: LadderResult,
) -> moderngl.Texture | None:
    """Metallic, where some material has any: one value for each, also where nothing was solved; 0 on its paint."""
    if not any(ladder.metallic.values()):
        return None
    values = np.zeros(texels.slots.shape, np.float32)
    for name, value in ladder.metallic.items():
        values[_of(scene, texels, [name])] = value
    covered = texels.slots >= 0
    whole = filled(device, np.stack([values, values, values, covered.astype(np.float32)], -1))
    if ladder.paint is None:
        return whole
    with device.scope():  # where it was not solved, and in seams, as near by: never in between
        near = filled(device, np.stack([*3 * [ladder.paint], ladder.texels.solved], -1).astype(np.float32))
        paint = (device.read(near)[..., 0] > 0.5) & (_of(scene, texels, list(ladder.painted)) | ~covered)
        whole.write(np.where(paint[..., None], np.float32(0), device.read(whole)).tobytes())
    return whole


def _filled_coat(
    device: Device, scene: SceneData, texels: SolvedTexelGrid, ladder: LadderResult,
) -> moderngl.Texture | None:
    """(weight, roughness, as of `Gloss.by_light`), where some material has a coat: as Metallic.

    Without one it weighs nothing.
    """
    if not ladder.coats:
        return None
    values = np.zeros((*texels.slots.shape, 4), np.float32)
    values[..., 1] = next(iter(ladder.coats.values())).roughness
    for name, coat in ladder.coats.items():
        values[_of(scene, texels, [name]), :2] = coat.weight, coat.roughness
    for name, found in ladder.predictions.items():
        values[_of(scene, texels, [name]), 2] = found.by_light
    values[..., 3] = texels.slots >= 0
    return filled(device, values)


def _filled_by_material(
    device: Device, scene: SceneData, texels: SolvedTexelGrid, by_name: Mapping[str, float],
) -> moderngl.Texture | None:
    """A number that some materials have, 0 of the others: as Metallic; None where none has it."""
    if not by_name:
        return None
    values = np.zeros(texels.slots.shape, np.float32)
    for name, value in by_name.items():
        values[_of(scene, texels, [name])] = value
    covered = (texels.slots >= 0).astype(np.float32)
    return filled(device, np.stack([values, values, values, covered], -1))


def filled(device: Device, values: F32, around: F32 | None = None) -> moderngl.Texture:
    """The texture of (h, w, 4) values with holes (alpha 0) filled."""
    with device.scope() as owned:
        known = device.texture(values.shape[1], values.shape[0], data=values.astype(np.float32))
        result = fill(device, known, around)
        owned.hand_over(result)
        return result


def confidence(roughness: F32, sigma: F32, observations: F32, solved: Bool) -> F32:
    """(h, w) 0 to 1: half where three standard errors of roughness are 0.1; nothing from edges of shadow alone.

    Where a texel departs from the median of 3 x 3 by more than that, its departure is taken: data that are wrong, not
    noisy, make texels sure of different things.
    """
    around, known = np.pad(roughness, 1), np.pad(solved, 1)
    h, w = roughness.shape
    near = np.empty((9, h, w), roughness.dtype)
    for k, at in enumerate(np.s_[y:y + h, x:x + w] for y in range(3) for x in range(3)):
        near[k] = np.where(known[at], around[at], roughness)
    apart = roughness - np.partition(near, 4, axis=0)[4]
    return live_readback.confidence(np.maximum(sigma, np.abs(apart)), observations)
