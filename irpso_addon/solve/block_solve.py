"""One block of a tiled solve, which depends on the plan and the pictures alone."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Generator, Hashable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from ..core.data import F32, F64, I32, Bool, Camera, Maps, RadianceImage, View
from ..core.images.response import file_scale, straightened
from ..core.job import Progress
from ..core.maps.export import layers
from ..core.normals.tangent_map import FLAT, encoded, tangent_part
from ..core.reporting.estimates import bytes_per_pixel
from ..core.tiled import uv_blocks
from ..core.tiled.reference_cache import CachedReference
from ..core.tiled.tiled_plan import Plan
from ..core.tiled.uv_blocks import Crop, UvBlock
from ..core.tiled.work_folder import WorkFolder
from ..core.vignetting import brightened
from ..gpu.device import thread
from ..gpu.device.context import Device
from ..gpu.gbuffer.gbuffer import MeshBuffer
from ..gpu.gbuffer.texel_grid import draw_texels
from ..gpu.maps.finish_maps import CoarseSurroundings, filled
from ..gpu.maps.partial_solve import PartialSolve
from ..gpu.observe.picture_memory import channels_needed
from ..gpu.solve.ladder_records import EarlierResult
from .gpu_path import Given, solve_grid
from .kept_images import reference_key
from .plan_preparation import picture_path
from .stages import Clock

Pictures = dict[Hashable, Callable[[], RadianceImage]]  # by `_picture_key`
STATS = "stats"  # of a block: (1, 7) texels covered, observed, solved, filled; sum and count of squared residuals,
# and whether its pictures are reduced


def solve_block(
    plan: Plan, work: WorkFolder, window: UvBlock, clock: Clock | None = None,
) -> Generator[Progress, None, None]:
    """Solve a block and write it to the work folder, whole or not at all.  Raises Cancelled when stopped."""
    thread.configure(replace(thread.settings(), kernels=plan.kernels))
    thread.device().collect()  # a large solve is one long job
    maps, stats = yield from _solved(plan, work, window, clock or Clock())
    work.write_block(window.key, {**_core(layers(_complete(plan, maps)), window), STATS: stats.astype(np.float32)})
    yield Progress(1.0, "maps")


def layers_of(plan: Plan) -> list[str]:
    """Names of the maps that a block holds."""
    return list(layers(plan.solution.maps))


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
    buffer, tilts, around = MeshBuffer(device, mesh), plan.tilts(window), _around(plan, window)
    if tilts is not None:
        buffer.refine(tilts)
    grid = draw_texels(device, buffer, side)
    if not grid.coverage.any():
        return _unseen(plan, side, around), np.zeros((1, 7))
    settings = replace(plan.settings, size=side, loss="robust" if plan.robust else "squares",
                       seed=(plan.settings.seed + zlib.crc32(window.key.encode())) % 2**31)
    views, pictures, reduced = _views(plan, work, grid.position, grid.normal, grid.coverage)
    part = PartialSolve(grid.coverage.astype(np.float32), False, np.zeros_like(grid.coverage))
    solved = yield from solve_grid(device, grid, Given(
        replace(plan.scene, mesh=mesh, views=views, warnings=(), skipped=()), settings,
        lambda view: pictures[_picture_key(view)](), part, _last(plan, window, grid.slots), plan.bounced,
        level=plan.level, before=plan.before(window), around=around, model=plan.solution.model, stride=plan.stride,
        keeps_partial=False), clock)
    made, core = solved.made, window.core
    inside, own = made.solved[core], np.zeros_like(made.solved)
    own[core] = inside
    counts = (grid.coverage[core], inside | made.shown[core], made.good[core],
              grid.coverage[core] & made.maps.filled[core])
    stats = [*(float(flags.sum()) for flags in counts), float(made.squared_residuals(own).sum()), float(inside.sum()),
             float(reduced)]
    normal = None if tilts is None else encoded(tangent_part(mesh), grid.normal, grid.coverage)
    return replace(made.maps, normal=normal), np.array([stats])


def _last(plan: Plan, window: UvBlock, slots: I32) -> EarlierResult:
    """Models and levels as the plan has them."""
    solution = plan.solution
    chosen = solution.model if plan.settings.model == "auto" else {}
    return EarlierResult(chosen, solution.levels, frozenset(solution.model), plan.level_map(window, slots),
                         priors=solution.priors, metallic=solution.metallic, coats=solution.coats,
                         diffuse_roughness=solution.diffuse_roughness, predictions=solution.predictions,
                         painted=frozenset(solution.paint), paint=plan.paint(window))


def _views(
    plan: Plan, work: WorkFolder, position: F32, normal: F32, covered: Bool,
) -> tuple[tuple[View, ...], Pictures, bool]:
    """The views as far as they show the block, what reads their pictures, and if it reduces them."""
    whole = plan.scene.views
    files = [CachedReference(picture_path(work, n)) for n in range(len(whole))]
    keys = [(view.camera.name, file.width, file.height) for view, file in zip(whole, files, strict=True)]
    cameras = {key: view.camera for key, view in zip(keys, whole, strict=True)}
    crops = {key: uv_blocks.crop_of(camera, *key[1:], position, normal, covered) for key, camera in cameras.items()}
    shrink = _shrink(plan, keys, crops)
    crops = {key: uv_blocks.shrunk(crop, shrink, *key[1:]) for key, crop in crops.items()}
    parts: dict[tuple[str, int, int], Camera] = {
        key: uv_blocks.cropped(camera, *key[1:], crops[key]) for key, camera in cameras.items()}
    views = tuple(replace(view, camera=parts[key]) for view, key in zip(whole, keys, strict=True))
    read: Pictures = {_picture_key(view): partial(_window, file, crops[key], scale / file_scale(view), view)
            for view, file, key, scale in zip(views, files, keys, plan.scales, strict=True)}
    return views, read, shrink > 1


def _picture_key(view: View) -> Hashable:
    """Of a view of a block, whose camera shows a part of the picture."""
    return reference_key(view), view.camera.name


def _shrink(plan: Plan, keys: list[tuple[str, int, int]], crops: Mapping[tuple[str, int, int], Crop]) -> int:
    """How many pixels must become one, so that a block's pictures fit into the memory."""
    views, channels = plan.scene.views, channels_needed(plan.scene.views)
    lights = {key: [len(view.lights) for view, other in zip(views, keys, strict=True) if other == key] for key in crops}
    lit = {key: len({view.environment.key for view, other in zip(views, keys, strict=True)
                     if other == key and view.environment is not None}) for key in crops}
    needed = sum(bytes_per_pixel(len(lights[key]), channels * sum(lights[key]), 1, lit[key]) * crop.pixels
                 for key, crop in crops.items())
    return max(1, int(np.ceil(np.sqrt(needed / (uv_blocks.PICTURES * plan.memory * 1e9)))))


def _window(picture: CachedReference, crop: Crop, scale: F64, view: View) -> RadianceImage:
    image = picture.window(crop.x, crop.y, crop.width, crop.height, crop.shrink)
    rgb = image.rgb if np.all(scale == 1) else image.rgb * scale.astype(np.float32)
    rgb = brightened(straightened(rgb, view), view.camera, view.vignetting)  # which developed pictures still have
    return replace(image, rgb=rgb)


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
    device, holes = thread.device(), np.zeros((side, side, 4), np.float32)
    base, lobes, level = (device.read(filled(device, holes, cells))[..., :3].copy()
                          for cells in (around.base, around.lobes, around.level))
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
    metallic = np.zeros_like(rough) if maps.metallic is None else maps.metallic
    normal = np.tile(np.array(FLAT, np.float32), (*rough.shape, 1)) if maps.normal is None else maps.normal
    return replace(maps, lobes=None if known.lobes is None else lobes,
                   specular=None if known.specular is None else specular,
                   metallic=None if known.metallic is None else metallic,
                   normal=None if known.normal is None else normal)


def _core(maps: Mapping[str, F32], window: UvBlock) -> dict[str, F32]:
    return {name: np.ascontiguousarray(array[window.core]) for name, array in maps.items()}
