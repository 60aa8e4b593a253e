"""The path over the GPU, assembled once: G-buffer, observations, solve, maps.

Whole solves, blocks of tiled solves, the preview and the comparison of methods all take it.  Each function must run on
the GL thread, inside a scope of the device (`Device.scope`), which frees what is made here.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from ..core.data import F32, I32, Bool, Bounced, MeshArrays, RadianceImage, SceneData, View
from ..core.errors import BadInput, Cancelled
from ..core.job import Progress, mapped
from ..core.live_maps import Live
from ..core.params import SolveSettings
from ..core.tiled.tiled_plan import PriorKnowledge
from ..gpu.device.context import Device
from ..gpu.gbuffer.gbuffer import GBufferMaps, MeshBuffer, draw_texel_grid
from ..gpu.maps.finish_maps import CoarseSurroundings, FinishedMaps, SolvedTexelGrid, make_maps
from ..gpu.maps.partial_solve import PartialSolve
from ..gpu.observe.observation_atlas import CameraSource
from ..gpu.observe.observations import Observations, ObserveOptions, observe
from ..gpu.solve.ladder_records import EarlierResult, LadderResult, Materials
from ..gpu.solve.model_ladder import Ladder

Result = TypeVar("Result")
ReadImage = Callable[[View], RadianceImage]
STAGES = {"pictures": (0.0, 1.0), "gbuffer": (0.0, 0.05), "observe": (0.05, 0.35), "solve": (0.35, 0.85),
          "maps": (0.85, 1.0), "indirect": (0.0, 1.0), "indirect_test": (0.0, 1.0)}  # share of a round's progress


def reference_key(view: View) -> Hashable:
    """All that the radiance of a view's reference image follows from: what differs in nothing of it is read once."""
    return view.image, view.mask, view.colorspace, view.exposure, view.gain


@dataclass
class Clock:
    """Seconds per stage, and the coverage that every look at the job shows beside its maps."""

    seconds: dict[str, float] = field(default_factory=dict)
    coverage: Bool | None = None

    def stage(self, name: str, steps: Generator[Progress, None, Result]) -> Generator[Progress, None, Result]:
        """Steps whose seconds are this stage's."""
        start = time.perf_counter()
        low, high = STAGES[name]
        reached = 0.0

        def placed(step: Progress) -> Progress:
            nonlocal reached
            reached = max(reached, step.fraction)  # a model tried on the way starts from 0 again
            return Progress(low + (high - low) * reached, name, step.message, step.look and partial(
                self._covered, step.look))

        try:
            return (yield from mapped(steps, placed))
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def _covered(self, look: Callable[[], Live]) -> Live:
        return replace(look(), coverage=self.coverage)


@dataclass(frozen=True)
class TexelGrid:
    """A mesh on the device and its G-buffer over the texel grid, drawn once and read once."""

    mesh: MeshBuffer
    maps: GBufferMaps
    position: F32  # (n, n, 3) world, metres; zero where not covered
    normal: F32  # (n, n, 3) world, unit, normal map included
    coverage: Bool  # (n, n)
    slots: I32  # (n, n) material slot; -1 where not covered


def draw_texels(device: Device, mesh: MeshArrays | MeshBuffer, size: int) -> TexelGrid:
    """The G-buffer of a mesh, ``size`` texels on a side."""
    buffer = mesh if isinstance(mesh, MeshBuffer) else MeshBuffer(device, mesh)
    maps = draw_texel_grid(device, buffer, size)
    position, normal = device.read(maps.position), device.read(maps.normal)
    coverage = position[..., 3] > 0.5
    slots = np.where(coverage, normal[..., 3].round().astype(np.int32), -1)
    return TexelGrid(buffer, maps, position[..., :3], normal[..., :3], coverage, slots)


@dataclass(frozen=True)
class Given:
    """What a solve of a grid goes by."""

    scene: SceneData
    settings: SolveSettings
    read_image: ReadImage
    part: PartialSolve
    last: EarlierResult | None = None  # what is taken over from an earlier result
    bounced: Mapping[int, Bounced] | None = None  # indirect light by the view's place in the scene
    # Of a block, from the plan of the whole:
    level: float | None = None  # typical radiance of the views
    before: PriorKnowledge | None = None
    around: CoarseSurroundings | None = None
    model: Mapping[str, str] | None = None  # by material, whatever the block would choose
    keeps_partial: bool = True  # a stopped solve gives maps of what it has found; else it raises Cancelled


@dataclass(frozen=True)
class Solved:
    """What a grid's solve has given."""

    observations: Observations
    ladder: LadderResult  # before it was joined to what a partial solve leaves as it was
    made: FinishedMaps


def solve_grid(
    device: Device, grid: TexelGrid, given: Given, clock: Clock,
) -> Generator[Progress, None, Solved]:
    """Observe, solve and make maps.  Raises BadInput where no view is usable, Cancelled as ``given`` says."""
    scene, part = given.scene, given.part
    observations: Observations = yield from clock.stage("observe", observe(
        device, scene, grid.mesh, given.read_image, ObserveOptions(given.bounced, part, level=given.level)))
    if not observations.cameras:
        raise BadInput("; ".join(f"{name}: {why}" for name, why in observations.skipped))
    maps = part.grid(device, grid.maps)
    materials = Materials(np.where(part.solved, grid.slots, -1), scene.mesh.slot_names)
    source = CameraSource(device, maps, observations, scene.mesh.extent)
    ladder: LadderResult = yield from clock.stage("solve", Ladder(
        device, source, given.settings, materials, given.last, given.before).solve())
    if ladder.cancelled and not given.keeps_partial:
        raise Cancelled
    if given.model is not None:
        ladder.model = dict(given.model)
    texels = SolvedTexelGrid(maps, grid.slots, observations, ladder, given.settings.ndf)
    made: FinishedMaps = yield from clock.stage("maps", make_maps(device, scene, texels, part, given.around))
    if made.albedo.cancelled and not given.keeps_partial:
        raise Cancelled
    return Solved(observations, ladder, made)
