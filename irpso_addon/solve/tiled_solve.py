"""Maps of any size in little memory: a plan on a small map, blocks that depend on it alone, and their merge to files.

Generators of Progress for the GL thread, as in pipeline.py.  docs/decisions/0010 tells why blocks and not a whole.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Generator, Hashable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..core import log
from ..core.data import F32, F64, I32, Bool, Camera, Maps, MeshArrays, RadianceImage, SceneData, Solution, View
from ..core.errors import BadInput, Cancelled, StoppedWithWork
from ..core.images.reference_image import read_reference
from ..core.job import Progress, Steps, retold
from ..core.maps import block_merge
from ..core.maps.export import layers, safe_stem
from ..core.params import SolveSettings
from ..core.reporting.estimates import bytes_per_pixel
from ..core.storage.output_transaction import OutputTransaction
from ..core.tiled import npz_archive, uv_blocks
from ..core.tiled.reference_cache import CachedReference, cache_reference
from ..core.tiled.tiled_plan import Plan
from ..core.tiled.uv_blocks import BLOCK, HALO, Crop, UvBlock
from ..core.tiled.work_folder import WorkFolder
from ..gpu.device import thread
from ..gpu.device.context import Device
from ..gpu.maps.finish_maps import CoarseSurroundings, filled
from ..gpu.maps.partial_solve import PartialSolve
from ..gpu.observe.observations import channels_needed, most_pixels
from ..gpu.solve.model_ladder import EarlierResult
from .gpu_path import Clock, Given, draw_texels, reference_key, solve_grid
from .pipeline import Bounce, Outcome, outcome

PLANNED, SOLVED = 0.25, 0.95  # of the whole: once the plan is made, once all blocks are solved
WORK = "irpso_work_"  # begins the name of a folder beside the maps, until they are done
NO_INDIRECT = "several UDIMs: indirect light is not rendered and taken out; darken the surroundings"
Pictures = dict[Hashable, Callable[[], RadianceImage]]  # by `_picture_key`
STATS = "stats"  # of a block: (1, 7) texels covered, observed, solved, filled; sum and count of squared residuals,
# and whether its pictures are reduced


def run(
    scene: SceneData, settings: SolveSettings, folder: Path, work: Path, kind: str, bounce: Bounce | None = None,
    block: int = BLOCK, halo: int = HALO,
) -> Generator[Progress, None, Solution]:
    """Files of the maps in ``folder``; what is finished lies in ``work``, where a run that was stopped goes on.

    Once the files are in their place the caller removes ``work`` (`WorkFolder.remove`).  ``kind``: of the files, as
    export.py.  Returns the plan's solution, of small maps, with the figures of the whole.  Raises BadInput for what
    cannot be used, and Cancelled: StoppedWithWork once there is a plan.
    """
    steps = _run(scene, settings, folder, work, kind, bounce, block, halo)
    return (yield from log.watched(scene, settings, thread.settings(), steps))


def _run(
    scene: SceneData, settings: SolveSettings, folder: Path, work: Path, kind: str, bounce: Bounce | None, block: int,
    halo: int,
) -> Generator[Progress, None, Solution]:
    clock = Clock()
    with WorkFolder(work) as place:
        plan = yield from prepare(scene, settings, place, bounce, block, halo, clock)
        blocks = plan.blocks
        left = [window for window in blocks if not place.has_block(window.key)]
        there = len(blocks) - len(left)
        stopped = False
        try:
            for n, window in enumerate(left):
                yield from _one_of_many(solve_block(plan, place, window, clock), there + n, len(blocks))
            began = time.perf_counter()
            for share in block_merge.steps(place.read_block, blocks, scene.mesh.name, folder, kind, layers_of(plan),
                                     tiled=plan.udims != (uv_blocks.FIRST_UDIM,)):
                yield Progress(SOLVED + (1 - SOLVED) * share, "merge", "writing files")
        except Cancelled:
            stopped = True
        if stopped:  # raised out here it does not carry the other one along, whose frames hold the block's textures
            raise StoppedWithWork(work, WorkFolder.count_blocks(work))
        clock.seconds["merge"] = time.perf_counter() - began
        solution = total(plan, place)
    told = (f"resumed: {there} of {len(blocks)} blocks were there",) if there else ()
    return replace(solution, seconds=clock.seconds, warnings=(*told, *solution.warnings), resumed_blocks=there)


def work_folder(out: Path, name: str) -> Path:
    """Where what is finished of an object's maps waits until all of it is in ``out``."""
    return out / f"{WORK}{safe_stem(name)}"


def solve_to(
    scene: SceneData, settings: SolveSettings, out: Path, kind: str, bounce: Bounce | None = None,
) -> Generator[Progress, None, Solution]:
    """As `run`: all files appear in ``out`` together; until then what is finished waits in `work_folder`."""
    work = work_folder(out, scene.mesh.name)
    with OutputTransaction(out) as staging:
        solution = yield from run(scene, settings, staging.folder, work, kind, bounce)
        staging.publish()
    with WorkFolder(work) as place:
        place.remove()
    return solution


def prepare(
    scene: SceneData, settings: SolveSettings, work: WorkFolder, bounce: Bounce | None = None, block: int = BLOCK,
    halo: int = HALO, clock: Clock | None = None,
) -> Generator[Progress, None, Plan]:
    """The plan in the work folder, which the caller has entered: the one that is there if it is of the same solve."""
    check(scene, settings)
    memory = thread.settings().memory
    sources = [path for view in scene.views for path in (view.image, view.mask) if path is not None]
    mark = npz_archive.fingerprint(scene, settings, (memory, block, halo), files=dict.fromkeys(sources))
    work.begin(mark)
    plan: Plan | None = work.read_plan()
    if plan is not None and plan.bounced is not None and plan.blend != _blend(bounce):
        work.begin("another")  # what the light bounces off may have changed: nothing of it is kept
        work.begin(mark)
        plan = None
    if plan is None:
        plan = yield from make_plan(scene, settings, work, bounce, block, halo, clock or Clock())
        work.write_plan(plan)
    return plan


def _blend(bounce: Bounce | None) -> str:
    """A name for the .blend whose indirect light is rendered."""
    blend = getattr(bounce, "blend", None)
    return npz_archive.fingerprint(files=[blend]) if isinstance(blend, Path) else ""


def check(scene: SceneData, settings: SolveSettings) -> None:
    """Raises BadInput for what is only done in one piece."""
    if scene.region is not None or settings.start != "anew":
        raise BadInput(f"{scene.mesh.name}: maps of more than {uv_blocks.ONE_PIECE} texels, or of several UDIMs, are "
                       "solved whole and anew; solve all of it, or choose a smaller size")
    if thread.settings().device == "numpy":
        raise BadInput(f"{scene.mesh.name}: maps of more than {uv_blocks.ONE_PIECE} texels, or of several UDIMs, need "
                       "OpenGL; with device numpy choose a smaller size")


def make_plan(
    scene: SceneData, settings: SolveSettings, work: WorkFolder, bounce: Bounce | None, block: int, halo: int,
    clock: Clock,
) -> Generator[Progress, None, Plan]:
    """Solve a small map, and develop the pictures."""
    udims = uv_blocks.solved_udims(settings.udim, scene.mesh.uvs)
    if not udims:
        raise BadInput(f"{scene.mesh.name}: none of its faces lies in a UDIM square; unwrap the mesh")
    if len(udims) > 1 and settings.indirect != "off" and bounce is not None:
        bounce = None  # it puts the small map on the object as it is, and that one holds the squares side by side
        scene = replace(scene, warnings=(*scene.warnings, NO_INDIRECT))
    small = uv_blocks.layout(settings.size, udims)
    mesh = replace(scene.mesh, grid=small.grid(scene.mesh.uvs), extent=float(small.columns))
    read = partial(read_reference, max_pixels=most_pixels(scene.views, uv_blocks.PICTURES * thread.settings().memory))
    began = time.perf_counter()
    made: Outcome = yield from retold(
        outcome(replace(scene, mesh=mesh), replace(settings, size=small.size), read, bounce), _of_plan)
    clock.seconds["plan"] = time.perf_counter() - began
    if made.solution.cancelled:
        raise Cancelled
    solution = _with_every_material(made.solution, scene.mesh, udims, settings)
    yield from clock.stage("pictures", _developed(scene.views, work))
    kernels = "compute" if thread.device().prefers_compute else "fragment"
    return Plan(replace(made.scene, mesh=scene.mesh), settings, udims, block, halo, thread.settings().memory, kernels,
                tuple(_scale(view) for view in scene.views), solution, made.level, made.noise, made.robust,
                made.bounced, _blend(bounce) if made.bounced is not None else "")


def _with_every_material(
    solution: Solution, mesh: MeshArrays, udims: tuple[int, ...], settings: SolveSettings,
) -> Solution:
    """Materials that the plan's small map shows nowhere have a model too: blocks must not choose for themselves."""
    squares = [uv_blocks.udims_of(mesh.uvs[mesh.slots == slot]) for slot in range(len(mesh.slot_names))]
    missing = {name for name, square in zip(mesh.slot_names, squares, strict=True)
               if set(square) & set(udims)} - solution.model.keys()
    model = "one-lobe" if settings.model == "auto" else settings.model
    told = tuple(f"material '{name}': shows too little for a model to be chosen; it is solved as {model}"
                 for name in sorted(missing))
    return replace(solution, model={**solution.model, **dict.fromkeys(missing, model)},
                   why={**solution.why, **dict.fromkeys(missing, "too small for the plan")},
                   warnings=(*solution.warnings, *(told if settings.model == "auto" else ())))


def _of_plan(step: Progress) -> Progress:
    """A step of the plan's small map as one of the whole."""
    return Progress(0.7 * PLANNED * step.fraction, step.stage, f"plan: {step.message}", step.look)


def _one_of_many(steps: Steps[None], before: int, blocks: int) -> Steps[None]:
    """A block's steps as part of the whole, without looks: they would show no map."""
    def placed(step: Progress) -> Progress:
        return Progress(PLANNED + (SOLVED - PLANNED) * (before + step.fraction) / blocks, step.stage,
                        f"block {before + 1} of {blocks}: {step.message}", block=(before + 1, blocks))

    return retold(steps, placed)


def _developed(views: tuple[View, ...], work: WorkFolder) -> Generator[Progress, None, None]:
    for n, view in enumerate(views):
        cache_reference(view, _picture(work, n))
        share = 0.7 + 0.3 * (n + 1) / len(views)
        yield Progress(PLANNED * share, "pictures", f"developing {view.image.name}")


def _picture(work: WorkFolder, n: int) -> Path:
    return work.pictures / f"{n:04}.irp"


def _scale(view: View) -> float:
    """Of the file's values to radiance."""
    return float(2.0**view.exposure * view.gain)


# ---- a block


def solve_block(
    plan: Plan, work: WorkFolder, window: UvBlock, clock: Clock | None = None,
) -> Generator[Progress, None, None]:
    """Solve a block and keep it in the work folder, whole or not at all.  Raises Cancelled when stopped."""
    thread.configure(replace(thread.settings(), kernels=plan.kernels))
    thread.device().collect()  # a large solve is one long job
    maps, stats = yield from _solved(plan, work, window, clock or Clock())
    work.write_block(window.key, {**_core(layers(_complete(plan, maps)), window), STATS: stats.astype(np.float32)})
    yield Progress(1.0, "maps")


def layers_of(plan: Plan) -> list[str]:
    """Names of the maps that a block holds."""
    return list(layers(plan.solution.maps))


def total(plan: Plan, work: WorkFolder) -> Solution:
    """The plan's solution with the figures of all blocks."""
    every = np.concatenate([work.read_block(window.key)[STATS] for window in plan.blocks])
    stats = every.sum(axis=0, dtype=np.float64)
    texels = dict(zip(("covered", "observed", "solved", "filled"), (int(n) for n in stats[:4]), strict=True))
    told = (f"{int(stats[6])} of {len(every)} blocks see their pictures reduced, to fit into {plan.memory:g} GB; "
            "more Memory shows more of them",) if stats[6] else ()
    return replace(plan.solution, texels={**texels, "kept": 0}, warnings=(*plan.solution.warnings, *told),
                   device=thread.device().describe(), residual=float(np.sqrt(stats[4] / max(stats[5], 1.0))))


def _solved(
    plan: Plan, work: WorkFolder, window: UvBlock, clock: Clock,
) -> Generator[Progress, None, tuple[Maps, F64]]:
    """The maps of a block with its halo, and figures of it."""
    device = thread.device()
    with device.scope():
        return (yield from _block(device, plan, work, window, clock))


def _block(
    device: Device, plan: Plan, work: WorkFolder, window: UvBlock, clock: Clock,
) -> Generator[Progress, None, tuple[Maps, F64]]:
    side = window.side
    mesh = replace(plan.scene.mesh, grid=window.grid(plan.scene.mesh.uvs), extent=side / window.size)
    grid, around = draw_texels(device, mesh, side), _around(plan, window)
    if not grid.coverage.any():
        return _unseen(plan, side, around), np.zeros((1, 7))
    settings = replace(plan.settings, size=side, loss="robust" if plan.robust else "squares",
                       seed=(plan.settings.seed + zlib.crc32(window.key.encode())) % 2**31)
    views, pictures, reduced = _views(plan, work, grid.position, grid.normal, grid.coverage)
    part = PartialSolve(grid.coverage.astype(np.float32), False, np.zeros_like(grid.coverage))
    solved = yield from solve_grid(device, grid, Given(
        replace(plan.scene, mesh=mesh, views=views, warnings=(), skipped=()), settings,
        lambda view: pictures[_picture_key(view)](), part, _last(plan, window, grid.slots), plan.bounced,
        level=plan.level, before=plan.before(window), around=around, model=plan.solution.model, keeps_partial=False), clock)
    made, core = solved.made, window.core
    inside, relative = made.solved[core], made.relative[core].astype(np.float64)
    counts = (grid.coverage[core], inside | made.shown[core], made.good[core],
              grid.coverage[core] & made.maps.filled[core])
    return made.maps, np.array([[*(float(flags.sum()) for flags in counts), float((relative[inside] ** 2).sum()),
                                 float(inside.sum()), float(reduced)]])


def _last(plan: Plan, window: UvBlock, slots: I32) -> EarlierResult:
    """Models and levels as the plan has them."""
    solution = plan.solution
    chosen = solution.model if plan.settings.model == "auto" else {}
    return EarlierResult(chosen, solution.levels, frozenset(solution.model), plan.level_map(window, slots))


def _views(
    plan: Plan, work: WorkFolder, position: F32, normal: F32, covered: Bool,
) -> tuple[tuple[View, ...], Pictures, bool]:
    """The views as far as they show the block, what reads their pictures, and if it reduces them."""
    whole = plan.scene.views
    files = [CachedReference(_picture(work, n)) for n in range(len(whole))]
    keys = [(view.camera.name, file.width, file.height) for view, file in zip(whole, files, strict=True)]
    cameras = {key: view.camera for key, view in zip(keys, whole, strict=True)}
    crops = {key: uv_blocks.crop_of(camera, *key[1:], position, normal, covered) for key, camera in cameras.items()}
    shrink = _shrink(plan, keys, crops)
    crops = {key: uv_blocks.shrunk(crop, shrink, *key[1:]) for key, crop in crops.items()}
    parts: dict[tuple[str, int, int], Camera] = {
        key: uv_blocks.cropped(camera, *key[1:], crops[key]) for key, camera in cameras.items()}
    views = tuple(replace(view, camera=parts[key]) for view, key in zip(whole, keys, strict=True))
    read: Pictures = {_picture_key(view): partial(_window, file, crops[key], scale / _scale(view))
            for view, file, key, scale in zip(views, files, keys, plan.scales, strict=True)}
    return views, read, shrink > 1


def _picture_key(view: View) -> Hashable:
    """Of a view of a block, whose camera shows a part of the picture."""
    return reference_key(view), view.camera.name


def _shrink(plan: Plan, keys: list[tuple[str, int, int]], crops: Mapping[tuple[str, int, int], Crop]) -> int:
    """How many pixels must become one, so that a block's pictures fit into the memory."""
    views, channels = plan.scene.views, channels_needed(plan.scene.views)
    lights = {key: [len(view.lights) for view, other in zip(views, keys, strict=True) if other == key] for key in crops}
    needed = sum(bytes_per_pixel(len(lights[key]), channels * sum(lights[key]), 1) * crop.pixels
                 for key, crop in crops.items())
    return max(1, int(np.ceil(np.sqrt(needed / (uv_blocks.PICTURES * plan.memory * 1e9)))))


def _window(picture: CachedReference, crop: Crop, scale: float) -> RadianceImage:
    image = picture.window(crop.x, crop.y, crop.width, crop.height, crop.shrink)
    return image if scale == 1.0 else replace(image, rgb=image.rgb * np.float32(scale))


def _around(plan: Plan, window: UvBlock) -> CoarseSurroundings:
    maps = plan.around(window)
    lobes = maps.lobes
    if lobes is None:
        lobes = np.stack([maps.roughness, maps.roughness, np.ones_like(maps.roughness)], -1)
    level = maps.specular
    if level is None:
        matte = set(plan.solution.model.values()) <= {"lambert"}
        level = np.full_like(maps.roughness, 0.0 if matte else 0.5)
    return CoarseSurroundings(maps.base_color, lobes, np.repeat(level[..., None], 3, axis=2))


def _unseen(plan: Plan, side: int, around: CoarseSurroundings) -> Maps:
    """A block without texels: what lies around it, as far as the plan knows."""
    device = thread.device()
    textures = [filled(device, np.zeros((side, side, 4), np.float32), cells)
                for cells in (around.base, around.lobes, around.level)]
    base, lobes, level = (device.read(texture)[..., :3].copy() for texture in textures)
    for texture in textures:
        texture.release()
    zero, no = np.zeros((side, side), np.float32), np.zeros((side, side), np.bool_)
    return Maps(base, lobes[..., 0], zero, zero, ~no, no, zero, zero, lobes, level[..., 0])


def _complete(plan: Plan, maps: Maps) -> Maps:
    """With the optional maps that the whole has, and no other."""
    lobes, specular, rough = maps.lobes, maps.specular, maps.roughness
    if lobes is None:
        lobes = np.stack([rough, rough, np.ones_like(rough)], -1)
    if specular is None:
        specular = np.full_like(rough, 0.5)
    known = plan.solution.maps
    return replace(maps, lobes=None if known.lobes is None else lobes,
                   specular=None if known.specular is None else specular)


def _core(found: Mapping[str, F32], window: UvBlock) -> dict[str, F32]:
    return {name: np.ascontiguousarray(array[window.core]) for name, array in found.items()}
