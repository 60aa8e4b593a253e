"""The path over the GPU, assembled once: G-buffer, observations, solve, maps.

Whole solves, blocks of tiled solves, the preview and the comparison of methods all take it.  Each function must run on
the GL thread, inside a scope of the device (`Device.scope`), which frees what is made here.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import moderngl
import numpy as np

from ..core.calibration.calibrate import calibrate, found_again
from ..core.calibration.finish import Judged
from ..core.calibration.free_numbers import NOTHING
from ..core.calibration.put_right import put_right, told, told_of_worlds, under_worlds
from ..core.calibration.rig import Rig
from ..core.calibration.rig_sample import RigSample
from ..core.calibration.worlds import are_few, judge_worlds
from ..core.change_records import Calibration
from ..core.checks.warnings import grouped
from ..core.data import I32, Bool, Bounced, SceneData
from ..core.errors import BadInput, Cancelled
from ..core.job import Progress
from ..core.maps.stride import SparseTexels, pixels_per_texel, stride_of
from ..core.normals.judge import NormalsJudged
from ..core.params import SolveSettings
from ..core.tiled.tiled_plan import PriorKnowledge
from ..gpu.device.context import Device
from ..gpu.gbuffer.gbuffer import GBufferMaps
from ..gpu.gbuffer.texel_grid import TexelGrid
from ..gpu.maps.finish_maps import CoarseSurroundings, FinishedMaps, SolvedTexelGrid, make_maps
from ..gpu.maps.partial_solve import PartialSolve
from ..gpu.observe.ambient_light import AmbientShadows
from ..gpu.observe.observation_atlas import CameraSource, TexelSurface
from ..gpu.observe.observations import LitMaps, Observations, ObserveOptions, observe
from ..gpu.solve.calibration_sample import calibration_sample, most_texels, sampled
from ..gpu.solve.ladder_records import EarlierResult, LadderResult, Materials
from ..gpu.solve.model_ladder import Ladder
from ..gpu.solve.openness import openness
from ..gpu.solve.sparse_ladder import SparseLadder, looked, picked, surface_of
from ..gpu.solve.world_light import world_sample
from .kept_images import ReadImage
from .outlined_scene import Observed, through_right_cameras
from .refined_scene import Surface, refined
from .stages import Clock

Result = TypeVar("Result")
REFINED = 0.005  # relative: what refined normals are still off by makes of an observation; residuals do not show it


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
    stride: int = 0  # every how many-th texel is solved; 0: as the pictures tell them apart
    settled: Judged | None = None  # what a round before, whose cameras were others, has put right
    aligns: bool = False  # cameras may be put right by outlines
    calibrates: bool = False  # lamps and exposures may be put right, and normals refined, as the settings let
    keeps_partial: bool = True  # a stopped solve gives maps of what it has found; else it raises Cancelled


@dataclass(frozen=True)
class Solved:
    """What a grid's solve has given."""

    scene: SceneData  # cameras, lamps and exposures put right
    given: SceneData  # the same, lamps and exposures as they were given
    calibration: Calibration | None  # what was put right of these
    in_doubt: Calibration | None  # a change of worlds that was found and not made
    judged: Judged | None  # the same of lamps and exposures, as it was found
    normals: NormalsJudged | str  # what was refined; or why normals are as given; "": they are to be
    grid: TexelGrid  # normals refined
    observations: Observations
    stride: int  # every how many-th texel was searched
    ladder: LadderResult  # before it was joined to what a partial solve leaves as it was
    made: FinishedMaps


def solve_grid(
    device: Device, grid: TexelGrid, given: Given, clock: Clock,
) -> Generator[Progress, None, Solved]:
    """Observe, solve and make maps.  Raises BadInput where no view is usable, Cancelled as ``given`` says."""
    part = given.part
    views = yield from _observed(device, grid, given, clock)
    right, grid = views.right, views.grid
    maps = part.grid(device, grid.maps)
    sparse = _sparse(views, given)
    ladder: LadderResult = yield from clock.stage("solve", _ladder(device, maps, views, given, sparse))
    if ladder.cancelled and not given.keeps_partial:
        raise Cancelled
    if given.model is not None:
        ladder.model = dict(given.model)
    found = None if sparse is None else SparseLadder(sparse, ladder)
    texels = SolvedTexelGrid(
        maps, grid.slots, right.observations, found.everywhere() if found else ladder, given.settings.ndf, found)
    made: FinishedMaps = yield from clock.stage("maps", make_maps(device, right.scene, texels, part, given.around))
    if made.albedo.cancelled and not given.keeps_partial:
        raise Cancelled
    return Solved(right.scene, right.given, right.calibration, right.in_doubt, right.judged, views.normals, grid,
                  right.observations, sparse.stride if sparse else 1, texels.ladder, made)


def _sparse(views: _Views, given: Given) -> SparseTexels | None:
    """The texels that are solved; None: all.  The published method solves each."""
    stride, size = given.stride, len(views.grid.slots)
    if given.settings.method == "paper":
        return None
    if not stride:
        cameras = [(camera.camera, camera.maps.position.size) for camera in views.right.observations.cameras]
        stride = stride_of(pixels_per_texel(views.right.scene.mesh, cameras, size), size)
    return None if stride == 1 else SparseTexels.of(views.grid.position, _slots(views, given), stride)


def keeps_normals(scene: SceneData) -> bool:
    """Whether a part is solved, under the refined normals that the last result has."""
    return scene.region is not None and scene.start is not None and scene.start.maps.normal is not None


def _slots(views: _Views, given: Given) -> I32:
    """(n, n) material slot of each texel to solve, -1 elsewhere."""
    return np.where(given.part.solved, views.grid.slots, -1)


def _ladder(
    device: Device, maps: GBufferMaps, views: _Views, given: Given, sparse: SparseTexels | None,
) -> Generator[Progress, None, LadderResult]:
    """The solve stage, of the ``sparse`` texels alone where there are such."""
    scene, slots, last = views.right.scene, _slots(views, given), given.last
    surface: TexelSurface = maps
    if sparse is not None:
        surface, slots = surface_of(device, maps, sparse), sparse.picked(slots)
        last = None if last is None else picked(last, sparse)
    misfit = REFINED if views.grid.mesh.offsets is not None or keeps_normals(scene) else 0.0
    source = CameraSource(device, surface, views.right.observations, scene.mesh.extent, misfit,
                          1 if sparse is None else sparse.stride)
    steps = Ladder(device, source, given.settings,
                   Materials(slots, scene.mesh.slot_names), last, given.before, scale_known=scene.scale_known).solve()
    return (yield from (steps if sparse is None else looked(steps, sparse)))


@dataclass(frozen=True)
class _Views:
    """What the views show, once all that may be is put right."""

    right: PutRight  # with the scene and observations of the refined normals
    normals: NormalsJudged | str
    grid: TexelGrid


@dataclass(frozen=True)
class PutRight:
    """What was put right of cameras and of what lights the views, before normals are looked at."""

    scene: SceneData
    given: SceneData  # cameras put right alone
    calibration: Calibration | None
    in_doubt: Calibration | None
    judged: Judged | None
    observations: Observations  # of ``given``; in `_Views` of ``scene``
    observe: Callable[..., Generator[Progress, None, Observations]]  # another scene; ``limits``: other than those
    limits: ObserveOptions


def put_views_right(
    device: Device, grid: TexelGrid, given: Given, clock: Clock,
) -> Generator[Progress, None, PutRight]:
    """Observe; cameras, lamps, exposures and worlds put right, where that is allowed and pays."""
    scene, part, settings = given.scene, given.part, given.settings
    dark = all(view.environment is None for view in scene.views)
    allowed = given.calibrates and dark
    turns = given.calibrates and not dark and not _glows(scene) and settings.lamps == "auto"
    calibrates = allowed and "auto" in (settings.lamps, settings.exposures)
    shadows = AmbientShadows(device, grid.mesh, scene.casters)
    limits = ObserveOptions(given.bounced, part, level=given.level, ambient=shadows)
    observed = partial(observe, device, mesh=grid.mesh, read_image=given.read_image, limits=limits)
    observations: Observations = yield from clock.stage("observe", observed(scene=scene))
    if not observations.cameras:
        raise BadInput("; ".join(grouped([f"{name}: {why}" for name, why in observations.skipped])))

    def source(shown: Observations) -> CameraSource:
        return CameraSource(device, part.grid(device, grid.maps), shown, scene.mesh.extent)

    texels = part.solved & grid.coverage
    if given.aligns and dark:  # what judges it knows lamps
        seen = yield from clock.stage("cameras", through_right_cameras(
            device, grid.mesh, Observed(scene, observations), lambda other: observed(scene=other),
            lambda shown: calibration_sample(source(shown), texels, settings.seed, scene.scale_known)))
        given = replace(given, scene=seen.scene)
        scene, observations = seen.scene, seen.observations
    calibration: Calibration | None = None
    in_doubt: Calibration | None = None
    judged: Judged | None = None
    if calibrates:
        rig, judged = yield from clock.stage("calibrate", _calibrated(
            source(observations), given, texels, grid.maps.facet, shadows))
        if judged is not None:
            scene, calibration = put_right(scene, rig, judged), told(rig, judged)
    if turns:
        calibration, in_doubt = yield from clock.stage(
            "calibrate", _turned(device, source(observations), given, texels, grid))
        if calibration is not None:
            scene = under_worlds(scene, calibration.worlds)
    return PutRight(scene, given.scene, calibration, in_doubt, judged, observations, observed, limits)


def _glows(scene: SceneData) -> bool:
    return any(view.environment is not None and view.environment.emitters for view in scene.views)


def _observed(device: Device, grid: TexelGrid, given: Given, clock: Clock) -> Generator[Progress, None, _Views]:
    """Views put right, and normals refined, where that is allowed and pays; observed again after either."""
    part, settings = given.part, given.settings
    found = yield from put_views_right(device, grid, given, clock)
    scene, observations, given = found.scene, found.observations, replace(given, scene=found.given)
    lit = LitMaps()
    if found.calibration is not None:
        observations.release_views()
        observations = yield from clock.stage("observe", found.observe(
            scene=scene, limits=replace(found.limits, drawn=observations.cameras, lit=lit)), (0.33, 0.35))
    normals: NormalsJudged | str = ""
    surface = Surface(scene, grid, observations)
    if given.calibrates and not _glows(scene) and settings.normals == "auto":
        observe = partial(found.observe, limits=replace(found.limits, lit=lit))
        surface, normals = yield from refined(device, surface, part, settings.seed, observe, lit, clock)
    lit.release()
    return _Views(replace(found, scene=surface.scene, observations=surface.observations), normals, surface.grid)


def _turned(
    device: Device, source: CameraSource, given: Given, texels: Bool, grid: TexelGrid,
) -> Generator[Progress, None, tuple[Calibration | None, Calibration | None]]:
    """What is put right of worlds, and what is only to be said of them; None: nothing."""
    if not are_few(given.scene.views):
        return None, None
    with device.scope():
        sample, light = yield from world_sample(
            source, grid.maps, texels, given.settings.seed, given.scene, grid.mesh)
        judged = yield from judge_worlds(sample, light)
    told_of = None if judged is None else told_of_worlds(judged)
    return (told_of, None) if judged is not None and judged.explained else (None, told_of)


def _in_shade(sample: RigSample, given: Given) -> RigSample:
    """Without what shade shows, where it shows light that has bounced and that is known."""
    return replace(sample, shade=None) if given.bounced else sample


def _calibrated(
    source: CameraSource, given: Given, texels: Bool, facet: moderngl.Texture, shadows: AmbientShadows,
) -> Generator[Progress, None, tuple[Rig, Judged | None]]:
    """What is to be put right of lamps and exposures; None: nothing.  ``facet``: as of GBufferMaps."""
    settings = given.settings
    known = given.scene.scale_known
    sample = _in_shade(calibration_sample(source, texels, settings.seed, known), given)

    def more(ambient: bool) -> RigSample:
        large, surface = sampled(
            source, texels, settings.seed, known, most_texels(len(sample.view)), facet)
        large = _in_shade(large, given)
        if not ambient:
            return large
        return replace(large, openness=openness(source.device, source, shadows, large, surface))

    if given.settled is not None and given.settled.free != NOTHING:  # cameras that are off may have hidden all else
        return sample.rig, (yield from found_again(given.settled, sample, more))
    return sample.rig, (yield from calibrate(
        sample, settings.lamps == "auto", settings.exposures == "auto", more,
        normals=settings.normals == "auto"))
