"""The whole flow: scene -> gbuffer -> observe -> solve -> maps.

Each function is a generator of Progress and must run on the GL thread: ``gpu.thread.run`` or ``Job``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from .core.data import F32, I32, Bool, Maps, RadianceImage, SceneData, Solution, View
from .core.errors import BadInput, Cancelled
from .core.image import read_reference
from .core.job import Progress
from .core.models import choose
from .core.params import SolveSettings
from .gpu import thread
from .gpu.albedo import ITERATIONS, AlbedoSolver
from .gpu.atlas import CameraSource
from .gpu.fill import fill
from .gpu.observe import Observations, bytes_per_pixel, observe
from .gpu.solve import RoughnessMaps, Solver
from .gpu.surface import MeshBuffer, SurfaceMaps, draw_texel_grid, overlap_counts

Result = TypeVar("Result")
OBSERVATION_BYTES = 2_000_000_000  # what references, observations and pixel maps may take together
STAGES = {"gbuffer": (0.0, 0.05), "observe": (0.05, 0.35), "solve": (0.35, 0.85), "maps": (0.85, 1.0)}


@dataclass(frozen=True)
class GBuffer:
    """The texel grid as arrays, row 0 at the bottom; zero where not covered."""

    position: F32  # (n, n, 3) world, metres
    normal: F32  # (n, n, 3) world, unit, normal map included
    coverage: Bool  # (n, n)
    overlap: Bool  # (n, n) more than one triangle claims the texel


@dataclass
class _Clock:
    """Seconds per stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    def stage(self, name: str, steps: Generator[Progress, None, Result]) -> Generator[Progress, None, Result]:
        start = time.perf_counter()
        low, high = STAGES[name]
        stop_now: Cancelled | None = None
        try:
            while True:
                step = steps.throw(stop_now) if stop_now else next(steps)
                stop_now = None
                try:
                    yield Progress(low + (high - low) * step.fraction, name, step.message)
                except Cancelled as stop:  # the stage may have something to keep
                    stop_now = stop
        except StopIteration as stop:
            result: Result = stop.value
            return result
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


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
    scene: SceneData, settings: SolveSettings, read_image: Callable[[View], RadianceImage] | None = None
) -> Generator[Progress, None, Solution]:
    """From a scene's data to its maps.

    ``read_image`` gives a view's reference; None reads its file, reduced where all views together
    would not fit OBSERVATION_BYTES.  Cancelled after the first solved tile, it returns the partial
    maps (``Solution.cancelled``); before that it raises Cancelled.  Raises BadInput for what cannot
    be used.
    """
    device = thread.device()
    if read_image is None:
        read_image = partial(read_reference, max_pixels=int(OBSERVATION_BYTES / bytes_per_pixel(scene.views)))
    clock = _Clock()
    mesh = MeshBuffer(device, scene.mesh)
    gbuffer = yield from clock.stage("gbuffer", bake_gbuffer(scene, settings.size))
    grid = draw_texel_grid(device, mesh, settings.size)
    observations: Observations = yield from clock.stage("observe", observe(device, scene, mesh, read_image))
    if not observations.cameras:
        raise BadInput("; ".join(f"{name}: {why}" for name, why in observations.skipped))
    solver = Solver(device, CameraSource(device, grid, observations), settings)
    found: RoughnessMaps = yield from clock.stage("solve", solver.solve())
    solution: Solution = yield from clock.stage(
        "maps", _maps(scene, settings, gbuffer, grid, observations, solver, found))
    for thing in (solver, observations, grid, mesh):
        thing.release()
    return replace(solution, seconds=clock.seconds, device=device.describe())


def _maps(
    scene: SceneData, settings: SolveSettings, gbuffer: GBuffer, grid: SurfaceMaps, observations: Observations,
    solver: Solver, found: RoughnessMaps,
) -> Generator[Progress, None, Solution]:
    """Choose models, solve base colour, fill holes and pad seams, and say what was done."""
    device = thread.device()
    rough, detail = device.read(found.roughness).copy(), device.read(found.detail)
    slots = np.where(gbuffer.coverage, device.read(grid.normal)[..., 3].round().astype(int), -1)
    solved = rough[..., 3] > 0.5
    relative = np.sqrt(detail[..., 1] / np.maximum(detail[..., 0], 0.25))  # residual
    model, why = _models(scene, settings, slots, solved, detail)
    lambert = [s for s, name in enumerate(scene.mesh.slot_names) if model.get(name) == "lambert"]
    is_lambert = np.isin(slots, lambert)
    rough[is_lambert, 0] = 1.0  # without a lobe any roughness renders alike; 1 reads as "no gloss"
    known = device.texture(found.roughness.width, found.roughness.height, data=np.stack(
        [rough[..., 0], is_lambert, np.zeros_like(rough[..., 0]), rough[..., 3]], axis=-1).astype(np.float32))
    filled_roughness = fill(device, known)
    for texture in (known, found.roughness, found.detail):
        texture.release()
    albedo = AlbedoSolver(device, grid, observations)
    base = yield from albedo.solve(filled_roughness, iterations=0 if solver.cancelled else ITERATIONS)
    filled_base = fill(device, base)
    shown = device.read(base)[..., 3] > 0.25
    maps = Maps(
        base_color=device.read(filled_base)[..., :3].copy(),
        roughness=device.read(filled_roughness)[..., 0].copy(),
        confidence=np.where(solved & shown, confidence(rough[..., 1], detail[..., 0]), 0.0).astype(np.float32),
        error=np.where(solved & shown, relative, 0.0).astype(np.float32),
        filled=~(solved & shown),
        coverage=gbuffer.coverage,
        roughness_sigma=np.where(solved & shown, rough[..., 1], 0.0).astype(np.float32),
        base_sigma=np.where(solved & shown, detail[..., 3], 0.0).astype(np.float32),
    )
    for texture in (base, filled_base, filled_roughness):
        texture.release()
    residual = float(np.sqrt(np.mean(relative[solved].astype(np.float64) ** 2))) if solved.any() else 0.0
    observed = solved | shown
    return Solution(
        maps=maps, model=model, why=why, residual=residual, seconds={}, device={},
        cancelled=solver.cancelled or albedo.cancelled,
        texels={"covered": int(gbuffer.coverage.sum()), "observed": int(observed.sum()),
                "solved": int((solved & shown).sum()), "filled": int((gbuffer.coverage & maps.filled).sum())},
        views_used=tuple(v.view.image.name for c in observations.cameras for v in c.views),
        views_skipped=scene.skipped + observations.skipped,
        warnings=(*scene.warnings, *observations.warnings, *_warnings(scene, gbuffer, maps, detail, solved)),
    )


def _models(
    scene: SceneData, settings: SolveSettings, slots: I32, solved: Bool, detail: F32
) -> tuple[dict[str, str], dict[str, str]]:
    """Model and reason for each material that has texels."""
    model, why = {}, {}
    names = scene.mesh.slot_names
    for name in dict.fromkeys(names):  # slots of one material decide together
        texels = solved & np.isin(slots, [slot for slot, other in enumerate(names) if other == name])
        if settings.model != "auto":
            model[name], why[name] = settings.model, "asked for"
        elif texels.any():
            model[name], why[name] = choose(detail[texels, 0], detail[texels, 1], detail[texels, 2])
    return model, why


def confidence(sigma: F32, observations: F32) -> F32:
    """0 to 1: half where the standard error of roughness is 0.05; nothing from edges of shadow alone."""
    told = np.clip(0.5 * (observations - 1.0), 0.0, 1.0)
    return np.asarray(told / (1.0 + (sigma / 0.05) ** 2), np.float32)


def _warnings(scene: SceneData, gbuffer: GBuffer, maps: Maps, detail: F32, solved: Bool) -> list[str]:
    """What a user must know before trusting the maps."""
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
    few = np.mean(detail[solved, 0] < 3.0) if solved.any() else 0.0
    if few > 0.1:
        found.append(f"{name}: {100 * few:.0f} % of its solved texels have fewer than 3 good observations; "
                     "their roughness leans on their neighbours")
    unsure = np.mean(maps.confidence[solved] < 0.2) if solved.any() else 0.0
    if unsure > 0.25:
        found.append(f"{name}: no highlight came near {100 * unsure:.0f} % of its solved texels; "
                     "their roughness is a guess (see the confidence map)")
    return found
