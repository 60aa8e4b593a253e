"""The plan of a tiled solve: a small map of the whole, and the pictures, developed (docs/decisions/0010)."""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ..core.data import MeshArrays, SceneData, Solution, View
from ..core.errors import BadInput, Cancelled
from ..core.images.read_ahead import ReadAhead
from ..core.images.reference_image import read_reference
from ..core.images.response import file_scale
from ..core.job import Progress, retold
from ..core.maps.stride import pixels_per_texel, stride_of
from ..core.params import SolveSettings
from ..core.tiled import npz_archive, uv_blocks
from ..core.tiled.reference_cache import CachedReference, cache_reference
from ..core.tiled.tiled_plan import Plan
from ..core.tiled.uv_blocks import BLOCK, HALO
from ..core.tiled.work_folder import WorkFolder
from ..gpu.device import thread
from ..gpu.observe.picture_memory import most_pixels
from .one_round import Outcome
from .pipeline import Bounce, outcome
from .stages import Clock

PLANNED = 0.25  # of the whole, once the plan is made


@dataclass(frozen=True)
class TiledRequest:
    """A tiled solve as it is asked for: all that its plan follows from."""

    scene: SceneData
    settings: SolveSettings
    bounce: Bounce | None = None  # renders indirect light from maps
    block: int = BLOCK  # texels, see core/tiled/uv_blocks.py
    halo: int = HALO


def check(scene: SceneData, settings: SolveSettings) -> None:
    """Raises BadInput for what is only done in one piece."""
    changes = []  # that make one piece of it
    if uv_blocks.solved_udims(settings.udim, scene.mesh.uvs) != (uv_blocks.FIRST_UDIM,):
        changes.append("set UDIM to First")
    if settings.size > uv_blocks.ONE_PIECE:
        changes.append(f"lower Size to {uv_blocks.ONE_PIECE}")
    smaller = ", or " + " and ".join(changes) if changes else ""
    if scene.region is not None or settings.start != "anew":
        raise BadInput(f"{scene.mesh.name}: maps of more than {uv_blocks.ONE_PIECE} texels, of several UDIMs, or of a "
                       f"farm are solved whole and from scratch; solve the whole object from scratch{smaller}")
    if thread.settings().device == "numpy":
        raise BadInput(f"{scene.mesh.name}: maps of more than {uv_blocks.ONE_PIECE} texels, or of several UDIMs, need "
                       f"OpenGL; choose device opengl{smaller}")


def prepare(request: TiledRequest, work: WorkFolder, clock: Clock | None = None) -> Generator[Progress, None, Plan]:
    """The plan in the work folder, which the caller has entered: the one that is there if it is of the same solve."""
    scene, settings = request.scene, request.settings
    check(scene, settings)
    memory = thread.settings().memory
    sources = [path for view in scene.views for path in view.files]
    mark = npz_archive.fingerprint(
        _by_full_paths(scene), settings, (memory, request.block, request.halo), files=dict.fromkeys(sources))
    work.begin(mark)
    plan: Plan | None = work.read_plan()
    if plan is not None and plan.bounced is not None and plan.blend != _blend(request.bounce):
        work.begin("another")  # what the light bounces off may have changed: nothing of it stays
        work.begin(mark)
        plan = None
    if plan is None:
        plan = yield from make_plan(request, work, clock or Clock())
        work.write_plan(plan)
    return plan


def _by_full_paths(scene: SceneData) -> SceneData:
    """The scene with the full paths of its files: from another folder, the same file has another relative path."""
    def full(path: Path | None) -> Path | None:
        return None if path is None else path.resolve()

    return replace(scene, views=tuple(
        replace(view, image=view.image.resolve(), mask=full(view.mask), ambient=full(view.ambient),
                flat=full(view.flat)) for view in scene.views))


def make_plan(request: TiledRequest, work: WorkFolder, clock: Clock) -> Generator[Progress, None, Plan]:
    """Solve a small map, and develop the pictures."""
    scene, settings, bounce = request.scene, request.settings, request.bounce
    udims = uv_blocks.solved_udims(settings.udim, scene.mesh.uvs)
    if not udims:
        raise BadInput(f"{scene.mesh.name}: none of its faces lies in a UDIM square; unwrap the mesh")
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
    scales = np.stack([file_scale(view) for view in scene.views])
    mesh = replace(scene.mesh, positions=made.scene.mesh.positions)  # they may have followed refined normals
    return Plan(replace(made.scene, mesh=mesh), settings, udims, request.block, request.halo,
                thread.settings().memory, kernels, scales, solution, made.level,
                made.noise, made.robust, made.bounced, _stride(made.scene.views, mesh, udims, settings, work),
                _blend(bounce) if made.bounced is not None else "", made.tilt)


def _stride(
    views: tuple[View, ...], mesh: MeshArrays, udims: tuple[int, ...], settings: SolveSettings, work: WorkFolder,
) -> int:
    """Every how many-th texel the blocks solve: of all the same, so that no border shows between them."""
    if settings.method == "paper":
        return 1
    cameras = []
    for n, view in enumerate(views):
        file = CachedReference(picture_path(work, n))
        cameras.append((view.camera, (file.width, file.height)))
    solved = np.isin(uv_blocks.udim_of_each(mesh.uvs), udims)
    return stride_of(pixels_per_texel(mesh, cameras, settings.size, solved), settings.size)


def _blend(bounce: Bounce | None) -> str:
    """A name for the .blend whose indirect light is rendered."""
    blend = getattr(bounce, "blend", None)
    return npz_archive.fingerprint(files=[blend]) if isinstance(blend, Path) else ""


def _with_every_material(
    solution: Solution, mesh: MeshArrays, udims: tuple[int, ...], settings: SolveSettings,
) -> Solution:
    """Materials that the plan's small map shows nowhere have a model too: blocks must not choose for themselves."""
    squares = [uv_blocks.udims_of(mesh.uvs[mesh.slots == slot]) for slot in range(len(mesh.slot_names))]
    missing = {name for name, square in zip(mesh.slot_names, squares, strict=True)
               if set(square) & set(udims)} - solution.model.keys()
    model = "one-lobe" if settings.model == "auto" else settings.model
    warnings = tuple(f"material '{name}': has too few data to choose a model; it is solved as {model}"
                     for name in sorted(missing))
    return replace(solution, model={**solution.model, **dict.fromkeys(missing, model)},
                   why={**solution.why, **dict.fromkeys(missing, "too small for the plan")},
                   warnings=(*solution.warnings, *(warnings if settings.model == "auto" else ())))


def _of_plan(step: Progress) -> Progress:
    """A step of the plan's small map as one of the whole."""
    return Progress(0.7 * PLANNED * step.fraction, step.stage, f"plan: {step.message}".removesuffix(": "), step.look)


def _developed(views: tuple[View, ...], work: WorkFolder) -> Generator[Progress, None, None]:
    def developed(n: int) -> None:
        cache_reference(views[n], picture_path(work, n))

    with ReadAhead(developed, range(len(views))) as pictures:
        for n, view in enumerate(views):
            share = 0.7 + 0.3 * n / len(views)
            step = Progress(PLANNED * share, "pictures", f"developing {view.image.name}")
            yield step
            yield from pictures.next(step)


def picture_path(work: WorkFolder, n: int) -> Path:
    """Of the developed picture of view ``n``."""
    return work.pictures / f"{n:04}.irp"
