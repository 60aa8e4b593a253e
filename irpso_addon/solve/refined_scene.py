"""Normals refined, and a mesh that follows them, before anything is solved.

A camera that looks at a slant sees a texel of a wrong mesh beside its place, where the normal is another one.  So
normals of a mesh that follows are refined once more, on what it then shows.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

from ..core.data import Bool, SceneData
from ..core.job import Progress
from ..core.normals.judge import FEW, NormalsJudged, too_few
from ..core.normals.relief import judge_normals_and_relief
from ..core.normals.tilt_sample import TiltSample
from ..gpu.device.context import Device
from ..gpu.gbuffer.gbuffer import MeshBuffer
from ..gpu.gbuffer.texel_grid import TexelGrid, draw_texels
from ..gpu.maps.partial_solve import PartialSolve
from ..gpu.observe.observation_atlas import CameraSource
from ..gpu.observe.observations import LitMaps, Observations
from ..gpu.solve.calibration_sample import sampled
from ..gpu.solve.followed_mesh import followed, may_follow
from ..gpu.solve.normal_texels import MOST, SAMPLE, SAMPLE_UNDER_WORLDS, refined_normals, seen_by
from ..gpu.solve.world_light import TiltedLight, too_many_to_tilt
from .stages import Clock

FOLLOWED = 40_000  # texels whose tilts say where the vertices are
AGAIN = (0.33, 0.35)  # share of the progress

Observe = Callable[..., Generator[Progress, None, Observations]]


@dataclass(frozen=True)
class Surface:
    """A scene, its mesh over the texel grid, and what its views show of it."""

    scene: SceneData
    grid: TexelGrid
    observations: Observations


def refined(
    device: Device, given: Surface, part: PartialSolve, seed: int, observe: Observe, lit: LitMaps, clock: Clock,
) -> Generator[Progress, None, tuple[Surface, NormalsJudged | str]]:
    """What is seen under refined normals, where they predict left-out views better; else as given, and why.

    ``observe``: a ``scene`` and its ``mesh``, with ``lit``, the shadows that are drawn.  What is replaced is released.
    """
    texels = part.solved & given.grid.coverage

    def source() -> CameraSource:
        return CameraSource(device, part.grid(device, given.grid.maps), given.observations, given.scene.mesh.extent)

    def drawn(scene: SceneData, mesh: MeshBuffer) -> Generator[Progress, None, Surface]:
        given.grid.maps.release()
        grid = draw_texels(device, mesh, len(texels))
        given.observations.release()
        return Surface(scene, grid, (yield from clock.stage("observe", observe(scene=scene, mesh=mesh), AGAIN)))

    follows = may_follow(given.scene)
    twice = follows and not source().layers.environment  # under worlds, each refinement draws the light of all of them
    normals = yield from clock.stage("normals", _judged(source(), given, texels, seed, FOLLOWED if twice else MOST))
    if not isinstance(normals, NormalsJudged):
        return given, normals
    scene, mesh = given.scene, given.grid.mesh
    positions = followed(device, given.observations, mesh, given.grid.maps, texels, seed) if follows else None
    offsets = mesh.offsets
    if positions is not None:
        lit.release()
        scene = replace(scene, mesh=replace(scene.mesh, positions=positions))
        mesh = MeshBuffer(device, scene.mesh)
        if twice:
            given = yield from drawn(scene, mesh)
        elif offsets is not None:
            mesh.refine(offsets)
    if twice:
        mesh.refine((yield from clock.stage("normals", refined_normals(
            source(), texels, normals, scene.scale_known, given.grid.maps.facet, near=offsets))))
    return (yield from drawn(scene, mesh)), normals


def _judged(
    source: CameraSource, given: Surface, texels: Bool, seed: int, most: int,
) -> Generator[Progress, None, NormalsJudged | str]:
    """The mesh gets refined normals, of ``most`` texels, where they predict left-out views better; else why not."""
    scene, maps, around = given.scene, given.grid.maps, source.layers.environment
    sample, surface = sampled(
        source, texels, seed, scene.scale_known, SAMPLE_UNDER_WORLDS if around else SAMPLE, maps.facet)
    if why := FEW if too_few(sample.texels) else too_many_to_tilt(scene.views):
        return why
    with source.device.scope():
        light = TiltedLight(source, given.grid.mesh, scene) if around else None
        worlds = None if light is None else (
            yield from light(surface, seen_by(sample.texels.quality, source.layers)))
        judged = yield from judge_normals_and_relief(TiltSample.of(sample, worlds))
        if not isinstance(judged, NormalsJudged):
            return judged
        offsets = yield from refined_normals(source, texels, judged, scene.scale_known, maps.facet, light, most)
    given.grid.mesh.refine(offsets)
    return judged
