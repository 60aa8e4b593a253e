"""The whole flow: scene -> gbuffer -> observe -> solve -> maps.

Each function is a generator of Progress and must run on the GL thread: ``gpu.thread.run`` or ``Job``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import moderngl
import numpy as np

from .core.advice import grouped, mended, warnings
from .core.checks import Checks, TexelFit, measure, worse
from .core.data import F32, I32, Bool, Bounced, Maps, RadianceImage, SceneData, Solution, View
from .core.errors import BadInput, Cancelled
from .core.image import read_reference
from .core.job import Progress
from .core.live import Live, ViewPicture
from .core.params import SolveSettings
from .core.registration import corrected
from .core.residuals import is_indirect
from .gpu import look, thread
from .gpu.albedo import ITERATIONS, AlbedoSolver
from .gpu.atlas import CameraSource
from .gpu.check import check_views, pictured
from .gpu.fill import fill
from .gpu.ladder import Found, Ladder
from .gpu.observe import Observations, most_pixels, observe
from .gpu.part import Part, last_of, part_of
from .gpu.surface import MeshBuffer, SurfaceMaps, draw_texel_grid, overlap_counts

Result = TypeVar("Result")
ReadImage = Callable[[View], RadianceImage]
Bounce = Callable[[SceneData, Solution], Generator[Progress, None, Mapping[int, Bounced]]]
ALIGN_ROUNDS = 4  # of finding where cameras look
ROUND_SIZE = 512  # texels: of maps that only the next round needs
NO_CONFIDENCE = "method paper: says nothing of how sure it is; confidence is 0, the standard errors are 0.5 everywhere"
STAGES = {"gbuffer": (0.0, 0.05), "observe": (0.05, 0.35), "solve": (0.35, 0.85), "maps": (0.85, 1.0),
          "indirect": (0.0, 1.0)}


@dataclass(frozen=True)
class GBuffer:
    """The texel grid as arrays, row 0 at the bottom; zero where not covered."""

    position: F32  # (n, n, 3) world, metres
    normal: F32  # (n, n, 3) world, unit, normal map included
    coverage: Bool  # (n, n)
    overlap: Bool  # (n, n) more than one triangle claims the texel


@dataclass
class _Clock:
    """Seconds per stage, and what every look at the job tells beside its maps."""

    seconds: dict[str, float] = field(default_factory=dict)
    coverage: Bool | None = None

    def stage(self, name: str, steps: Generator[Progress, None, Result]) -> Generator[Progress, None, Result]:
        start = time.perf_counter()
        low, high = STAGES[name]
        stop_now: Cancelled | None = None
        reached = 0.0
        try:
            while True:
                step = steps.throw(stop_now) if stop_now else next(steps)
                stop_now = None
                reached = max(reached, step.fraction)  # a model tried on the way starts from 0 again
                try:
                    yield Progress(low + (high - low) * reached, name, step.message, step.look and partial(
                        self._covered, step.look))
                except Cancelled as stop:  # the stage may have something to keep
                    stop_now = stop
        except StopIteration as stop:
            result: Result = stop.value
            return result
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def _covered(self, look: Callable[[], Live]) -> Live:
        return replace(look(), coverage=self.coverage)


def bake_gbuffer(scene: SceneData, size: int) -> Generator[Progress, None, GBuffer]:
    """Position, normal and coverage of every texel.

    Raises BadInput when no texel of the UV square is covered.
    """
    device = thread.device()
    mesh = MeshBuffer(device, scene.mesh)
    try:
        grid = draw_texel_grid(device, mesh, size)
        yield Progress(0.5, "gbuffer")
        position, normal = device.read(grid.position), device.read(grid.normal)
        grid.release()
        coverage = position[..., 3] > 0.5
        if not coverage.any():
            raise BadInput(f"{scene.mesh.name}: no face covers a texel of the 0-1 UV square at {size} x {size}; "
                           "unwrap the mesh (UV > Smart UV Project)")
        overlap = overlap_counts(device, mesh, size) > 1.5
        yield Progress(1.0, "gbuffer")
        return GBuffer(position[..., :3], normal[..., :3], coverage, overlap & coverage)
    finally:
        mesh.release()


def solve(
    scene: SceneData, settings: SolveSettings, read_image: ReadImage | None = None, bounce: Bounce | None = None,
) -> Generator[Progress, None, Solution]:
    """From a scene's data to its maps.

    ``read_image`` gives a view's reference; None reads its file, reduced where all views together would not fit into
    the memory that the device's settings allow.  ``bounce`` renders indirect light from the maps so far; None: none.
    Cancelled after the first solved tile, it returns the partial maps (``Solution.cancelled``), or those of the round
    before; before that it raises Cancelled.  Raises BadInput for what cannot be used.
    """
    if read_image is None:
        read_image = partial(read_reference, max_pixels=most_pixels(scene.views, thread.settings().memory))
    clock = _Clock()
    first = yield from _round(scene, settings, read_image, clock)
    if first.cancelled:
        return first
    solution = first
    small = replace(settings, size=min(settings.size, ROUND_SIZE))  # of rounds that only the next one needs
    try:
        aligned, rough = yield from _align(scene, first, settings, partial(_round, settings=small,
                                                                           read_image=read_image, clock=clock))
        if bounce is not None and _bounced(settings, rough):
            rough = yield from _round(aligned, small, read_image, clock, (
                yield from clock.stage("indirect", bounce(scene, rough))))
            solution = yield from _round(aligned, settings, read_image, clock, (
                yield from clock.stage("indirect", bounce(scene, rough))))
        elif aligned is not scene:
            solution = rough if small == settings else (yield from _round(aligned, settings, read_image, clock))
        if aligned is not scene and first.checks is not None:
            told = mended(first.checks, settings.registration == "auto", settings.exposures == "solve")
            solution = replace(solution, warnings=(*told, *solution.warnings))
    except Cancelled:  # the maps so far are whole
        solution = replace(solution, cancelled=True)
    except BadInput as error:  # nothing of the first round is lost
        solution = replace(solution, warnings=(*solution.warnings, str(error)))
    return replace(solution, seconds=clock.seconds)


def _align(
    scene: SceneData, solution: Solution, settings: SolveSettings,
    again: Callable[[SceneData], Generator[Progress, None, Solution]],
) -> Generator[Progress, None, tuple[SceneData, Solution]]:
    """The scene with cameras and exposures put right as far as the settings let, and its solution."""
    for _ in range(ALIGN_ROUNDS):
        assert solution.checks is not None
        better = corrected(scene, solution.checks.registration, shifts=settings.registration == "auto",
                           gains=settings.exposures == "solve")
        if better is scene:
            break
        after = yield from again(better)
        assert after.checks is not None
        if worse(after.checks, solution.checks):
            break
        scene, solution = better, after
    return scene, solution


def _bounced(settings: SolveSettings, solution: Solution) -> bool:
    """Whether indirect light is to be rendered."""
    assert solution.checks is not None
    return settings.indirect == "on" or (settings.indirect == "auto" and is_indirect(solution.checks.unlit_share))


def _round(
    scene: SceneData, settings: SolveSettings, read_image: ReadImage, clock: _Clock,
    bounced: Mapping[int, Bounced] | None = None,
) -> Generator[Progress, None, Solution]:
    """One solve of the scene as it is given; ``bounced``: indirect light, by the view's place in the scene."""
    device = thread.device()
    mesh = MeshBuffer(device, scene.mesh)
    gbuffer = yield from clock.stage("gbuffer", bake_gbuffer(scene, settings.size))
    clock.coverage = gbuffer.coverage
    grid = draw_texel_grid(device, mesh, settings.size)
    slots = np.where(gbuffer.coverage, device.read(grid.normal)[..., 3].round().astype(np.int32), -1)
    part = part_of(device, scene, settings.size, gbuffer.position, slots)
    last = last_of(part, scene, settings, slots)
    grid = part.grid(device, grid)
    observations: Observations = yield from clock.stage("observe", observe(
        device, scene, mesh, read_image, bounced, part))
    if not observations.cameras:
        raise BadInput("; ".join(f"{name}: {why}" for name, why in observations.skipped))
    ladder = Ladder(device, CameraSource(device, grid, observations), settings, np.where(part.solved, slots, -1),
                    scene.mesh.slot_names, last)
    found: Found = yield from clock.stage("solve", ladder.solve())
    solution: Solution = yield from clock.stage(
        "maps", _maps(scene, settings, gbuffer, grid, observations, found, slots, part))
    for thing in (ladder, observations, grid, mesh):
        thing.release()
    return replace(solution, seconds=clock.seconds, device=device.describe())


def _maps(
    scene: SceneData, settings: SolveSettings, gbuffer: GBuffer, grid: SurfaceMaps, observations: Observations,
    found: Found, slots: I32, part: Part,
) -> Generator[Progress, None, Solution]:
    """Solve base colour, fill holes and pad seams, and say what was done."""
    device = thread.device()
    solved = found.roughness[..., 3] > 0.5
    observed, residual = found.detail[..., 0], found.detail[..., 1]
    relative = look.relative_error(residual, observed)
    found = part.join_found(found, scene.start)
    lobes, level = _filled_lobes(scene, found, slots)
    beckmann = settings.ndf == "beckmann" and "two-lobe" in found.model.values()
    albedo = AlbedoSolver(device, grid, observations, lobes, level, beckmann)
    if found.base is None:
        base = yield from albedo.solve(iterations=0 if found.cancelled else ITERATIONS)
    else:  # the method has searched it itself
        base = device.texture(grid.position.width, grid.position.height,
                              data=np.concatenate([found.base, solved[..., None]], -1).astype(np.float32))
    own_base = device.read(base)
    shown = own_base[..., 3] > 0.25
    filled_base = _fill(part.join_base(own_base))
    good = solved & shown
    rough, sigma = found.roughness[..., 0], found.roughness[..., 1]
    pairs = device.read(lobes)[..., :3].copy()
    maps = Maps(
        base_color=device.read(filled_base)[..., :3].copy(),
        roughness=pairs[..., 0].copy(),
        confidence=np.where(good, confidence(rough, sigma, observed, good), np.float32(0)),
        error=np.where(good, relative, 0.0).astype(np.float32),
        filled=~(good | part.known),
        coverage=gbuffer.coverage,
        roughness_sigma=np.where(good, sigma, 0.0).astype(np.float32),
        base_sigma=np.where(good, found.detail[..., 3], 0.0).astype(np.float32),
        lobes=pairs if found.lobes is not None else None,
        specular=device.read(level)[..., 0].copy() if level is not None and found.level is not None else None,
    )
    maps = part.join_maps(maps, part.share(good))
    checks, pictures = yield from _checks(scene, settings, albedo, filled_base, found, slots, good, maps)
    for texture in (base, filled_base, lobes, level):
        if texture is not None:
            texture.release()
    told = relative[solved].astype(np.float64)
    return Solution(
        maps=maps, model=found.model, why=found.why, seconds={}, device={}, levels=found.levels,
        residual=float(np.sqrt(np.mean(told**2))) if solved.any() else 0.0,
        cancelled=found.cancelled or albedo.cancelled, ndf=settings.ndf,
        texels={"covered": int(gbuffer.coverage.sum()), "observed": int((solved | shown).sum()),
                "solved": int(good.sum()), "filled": int((gbuffer.coverage & maps.filled).sum()),
                "kept": int((part.known & ~good).sum())},
        views_used=tuple(v.view.image.name for c in observations.cameras for v in c.views),
        views_skipped=scene.skipped + observations.skipped, checks=checks, pictures=pictures,
        warnings=(*scene.warnings, *grouped(observations.warnings), *_warnings(scene, gbuffer, maps),
                  *warnings(checks), *([NO_CONFIDENCE] if settings.method == "paper" else [])),
    )


def _filled_lobes(scene: SceneData, found: Found, slots: I32) -> tuple[moderngl.Texture, moderngl.Texture | None]:
    """(roughness1, roughness2, weight) and, where some material's is not 0.5, Specular IOR Level; holes filled."""
    r, known = found.roughness[..., 0], found.roughness[..., 3]
    lambert = np.isin(slots, [s for s, name in enumerate(scene.mesh.slot_names) if found.model.get(name) == "lambert"])
    lobes = np.stack([r, r, np.ones_like(r)], -1) if found.lobes is None else found.lobes
    lobes = np.where(lambert[..., None], np.float32(1.0), lobes)  # any roughness renders alike; 1 reads as "no gloss"
    filled = [_fill(np.concatenate([lobes, known[..., None]], -1)), None]
    if found.level is not None or lambert.any():
        level = np.full_like(r, 0.5) if found.level is None else found.level
        level = np.where(lambert, np.float32(0.0), level)
        filled[1] = _fill(np.stack([level, level, level, known], -1))
    assert filled[0] is not None
    return filled[0], filled[1]


def _fill(values: F32) -> moderngl.Texture:
    """The texture of (h, w, 4) values with holes (alpha 0) filled."""
    device = thread.device()
    known = device.texture(values.shape[1], values.shape[0], data=values.astype(np.float32))
    result = fill(device, known)
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
    return look.confidence(np.maximum(sigma, np.abs(apart)), observations)


def _checks(
    scene: SceneData, settings: SolveSettings, albedo: AlbedoSolver, base: moderngl.Texture, found: Found, slots: I32,
    good: Bool, maps: Maps,
) -> Generator[Progress, None, tuple[Checks, tuple[ViewPicture, ...]]]:
    """What the views say of the maps, and how they look beside what those predict."""
    pictures: list[ViewPicture] = []
    views = pictured(check_views(albedo, base), pictures)
    texels = TexelFit(scene.mesh.name, found.model, slots, scene.mesh.slot_names, good, found.detail[..., 0],
                      maps.roughness, maps.roughness_sigma, sure=settings.method != "paper",
                      chosen=settings.model == "auto")
    yield Progress(1.0, "maps", "checks")
    return measure(views, texels), tuple(pictures)


def _warnings(scene: SceneData, gbuffer: GBuffer, maps: Maps) -> list[str]:
    """What a user must know of the mesh before trusting the maps."""
    covered = max(int(gbuffer.coverage.sum()), 1)
    name = scene.mesh.name
    found = []
    overlap = gbuffer.overlap.sum() / covered
    if overlap > 0.001:
        found.append(f"{name}: {100 * overlap:.1f} % of its texels are claimed by more than one face "
                     "(overlapping UVs); they hold one face's result")
    outside = np.mean(np.any((scene.mesh.uvs < -1e-4) | (scene.mesh.uvs > 1 + 1e-4), axis=(1, 2)))
    if outside > 0:
        found.append(f"{name}: {100 * outside:.1f} % of its faces lie outside the 0-1 UV square and are not solved")
    unseen = (gbuffer.coverage & maps.filled).sum() / covered
    if unseen > 0.05:
        found.append(f"{name}: {100 * unseen:.0f} % of its texels are seen lit by no view and were filled "
                     "from their neighbours")
    return found
