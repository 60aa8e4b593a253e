"""A solve of an object, from the open scene to its materials: what the command and the panel's button have in common.

    check_objects(...)                     of several, before the first one
    order = read(...)                      what is solved; refused where its maps could go nowhere
    check(order), check_room(order, ...)   what else is refused before the work
    run(order, ...) or task(order)         here and now, or as a job for a worker process
    remember(...), place(...), learn(...)  what the session keeps of it; the maps on the materials
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import bpy

from ...core.data import SceneData, Solution
from ...core.errors import BadInput, Cancelled, StoppedWithWork
from ...core.images import decoder_pool
from ...core.images.image_file import open_image
from ...core.images.read_ahead import ReadAhead
from ...core.images.reference_image import with_raw_size
from ...core.job import Progress, Steps
from ...core.maps.map_set import MapFiles
from ...core.params import SolveSettings, choice_name
from ...core.reporting import estimates
from ...core.reporting.estimates import Estimate, ViewSize
from ...core.tiled import uv_blocks
from ...core.tiled.work_folder import WorkFolder
from ...gpu.device import thread
from ...solve import pipeline, plan_preparation, tiled_solve
from ...solve.plan_preparation import TiledRequest
from ..files import object_named, require_own_files
from ..material import material, material_preflight, material_sharing
from ..material.slot_names import names_of
from ..scene import look_through
from ..scene.scene import read_scene
from ..scene.scene_mesh import face_slots
from . import solve_region, solve_speed, stored_result
from .indirect import IndirectRenderer
from .jobs import Task
from .session import Result, object_by_uid, session

Part = tuple[str, Any]  # kind and choice, as solve_region.with_part has them
ALL: Part = ("ALL", None)


@dataclass(frozen=True)
class Order:
    """One solve of one object."""

    data: SceneData
    settings: SolveSettings
    udims: tuple[int, ...]  # that are solved
    folder: Path | None = None  # where files go; None: the maps are kept in the .blend alone
    kind: str = "exr"  # of the files
    names: Mapping[int, str] = field(default_factory=dict)  # session_uids of its materials -> their names in ``data``
    share: bool = False  # materials that other objects show too show the maps there as well

    @property
    def name(self) -> str:
        """The object's, when it was read: that of its files."""
        return self.data.mesh.name

    @property
    def large(self) -> bool:
        """Whether it is solved in blocks; its maps are files in ``folder``, and not in the .blend."""
        return uv_blocks.is_large(self.settings.size, self.udims)

    @property
    def work(self) -> Path | None:
        """Where what is finished of a large one waits."""
        return tiled_solve.work_folder(self.folder, self.name) if self.large and self.folder is not None else None

    @property
    def shown_size(self) -> int:
        """Texels across the maps that are seen while it runs: of a large one its plan's."""
        return uv_blocks.layout(self.settings.size, self.udims).size if self.large else self.settings.size

    def label(self, solution: Solution) -> str:
        """What its result is called: when it was found, what it is, and how it was asked for."""
        settings, models = self.settings, [*dict.fromkeys(solution.model.values())]
        found = choice_name(models[0]) if len(models) == 1 else f"{len(models)} models"
        model = f"Auto: {found}" if settings.model == "auto" else found
        part = ", part" if self.data.region else ""
        stopped = ", stopped early" if solution.cancelled else ""
        return f"{time.strftime('%H:%M')}  {model}, {choice_name(settings.method)}, {settings.size}{part}{stopped}"


def check_objects(context: bpy.types.Context, objects: Sequence[bpy.types.Object]) -> None:
    """Raises BadInput where the maps of one could not go onto its materials: before the first of several is solved."""
    depsgraph = context.evaluated_depsgraph_get()
    for obj in objects:
        material_preflight.check(obj, face_slots(obj, depsgraph))


def read(
    context: bpy.types.Context | None, subject: bpy.types.Object | str | None, captures: Path | None,
    settings: SolveSettings, part: Part = ALL, writes: bool = True,
) -> Order:
    """Scene, part and last result.  ``subject``: the object or its name; None: the one that can be meant.

    ``writes``: the maps are to go onto its materials.  Look Through View ends.  Raises BadInput, also where they could
    not.
    """
    scene = (context or bpy.context).scene
    if look_through.is_looking(scene):
        look_through.look_back(scene)
    given = isinstance(subject, bpy.types.Object)
    data = with_raw_size(read_scene(context, subject.name if given else subject, captures), settings)
    obj = subject if given else object_named(data.mesh.name)
    if writes:
        material_preflight.check(obj, data.mesh.slots)
    data = solve_region.with_part(context, obj, data, settings.start, *part)
    names = names_of(obj, dict.fromkeys(data.mesh.slot_names, ""))
    return Order(data, settings, uv_blocks.solved_udims(settings.udim, data.mesh.uvs), names=names,
                 share=material_sharing.shares(scene))


def check(order: Order) -> None:
    """Raises BadInput for files that could be another object's, and for what blocks cannot solve but would have to."""
    if order.folder is not None:
        require_own_files(object_named(order.name))
    if order.large:
        plan_preparation.check(order.data, order.settings)


def check_room(order: Order, expected: Estimate | None) -> None:
    """Raises BadInput where the disk has no room for the files, as far as is known."""
    if expected is not None and order.folder is not None:
        there = 0 if order.work is None else estimates.size_of(order.work)
        estimates.check_disk(order.folder, expected.disk_bytes, there)


def expected(order: Order) -> Steps[Estimate]:
    """Time and memory.  Opens all pictures: not for a window, whose panel knows (`solve_speed.of`)."""
    views, taken = order.data.views, []
    with ReadAhead(lambda view: open_image(view.image, view.full_raw), views, decoder_pool.MOST) as headers:
        for n, view in enumerate(views):
            with suppress(BadInput):  # the solve says it
                header = yield from headers.next(Progress(0.0, "headers", f"{n} of {len(views)}"))
                taken.append(ViewSize(header.width, header.height, view.camera.name, len(view.lights),
                                      str(view.environment.key) if view.environment else ""))
    return estimates.estimate(taken, order.settings, solve_speed.factors(), thread.settings().memory,
                              rounds=solve_speed.rounds(None, order.settings, taken), udims=order.udims,
                              triangles=len(order.data.mesh.positions))


# ---- the work


def run(order: Order, blend: Path, folder: Path, on_progress: Callable[[Progress], None]) -> Solution:
    """Solve it now, of ``blend`` as it was opened; files of large maps go into ``folder``.

    Stopped, it returns what there is of maps in one piece; of others it raises StoppedWithWork once there is something
    to go on from.  Raises Cancelled where there is nothing, and BadInput.
    """
    bounce = None if order.settings.indirect == "off" else IndirectRenderer.of_open_file(blend)
    work = order.work
    try:
        solution: Solution = thread.run(lambda: _steps(order, folder, bounce), on_progress)
        return solution
    except BaseException as error:
        if isinstance(error, Cancelled) and error.partial is not None:
            stopped: Solution = error.partial
            return stopped
        if work is None:
            raise
        if not WorkFolder.has_plan(work):
            _remove(work)
        elif isinstance(error, KeyboardInterrupt) or type(error) is Cancelled:  # before the solve looked there
            raise StoppedWithWork(work, WorkFolder.count_blocks(work)) from None
        raise


def _steps(order: Order, folder: Path, bounce: IndirectRenderer | None) -> Steps[Solution]:
    if order.work is None:
        return pipeline.solve(order.data, order.settings, bounce=bounce)
    return tiled_solve.run(TiledRequest(order.data, order.settings, bounce), folder, order.work, order.kind)


def task(order: Order) -> Task:
    """It as a job for a worker process, of what is open: as it was saved, or of a copy where it was changed since.

    All files of large maps appear in the order's folder together.
    """
    bounce: IndirectRenderer | None = None
    afterwards: Callable[[], None] = lambda: None  # noqa: E731
    if order.settings.indirect != "off":
        dirty = bpy.data.is_dirty
        bounce = IndirectRenderer.of_copy() if dirty else IndirectRenderer.of_open_file(Path(bpy.data.filepath))
        if bounce.copy is not None:
            afterwards, bounce = bounce.copy.cleanup, replace(bounce, copy=None)
    if order.work is None:
        return Task("solve.pipeline:solve", (order.data, order.settings, None, bounce), afterwards)
    return Task("solve.tiled_solve:solve_to", (order.data, order.settings, order.folder, order.kind, bounce),
                afterwards)


def forget_work(order: Order) -> None:
    """The files are in their place: what they were made from goes."""
    if order.work is not None:
        _remove(order.work)


def _remove(work: Path) -> None:
    with suppress(BadInput), WorkFolder(work) as place:
        place.remove()


# ---- the result


def place(
    obj: bpy.types.Object, order: Order, result: Result,
    shown: Callable[[], Mapping[str, bpy.types.Image]] = dict,
) -> Generator[None, None, tuple[str, ...]]:
    """The maps on its materials, an image a step, in the last one all that is linked; what the user should know.

    Large ones are linked to their files, which need not be there yet.  ``shown``: images that were made for it before,
    by role.  Between two steps the user may undo and delete.  Raises BadInput before anything is changed.
    """
    result.settle(obj)
    solution = result.solution
    files = files_of(order, solution)
    if files is not None:
        return put(obj, result, share=order.share)
    material.check(obj, solution)
    uid, layers = obj.session_uid, material.layers_of(solution.maps)
    uids: dict[str, int] = {}
    for role, array in layers.items():
        now = object_by_uid(uid)
        if now is None:
            return ()
        image = shown().get(role)
        if image is None or image.size[0] != array.shape[0]:
            image = material.loose_image(now, role, array.shape[0])
        uids[role] = image.session_uid
        material.set_pixels(image, array)
        yield
        image = _image(uids[role])
        if image is not None:
            image.pack()
            yield
    now = object_by_uid(uid)
    if now is None:
        return ()
    record = stored_result.packed(now, result)
    yield
    now = object_by_uid(uid)
    if now is None:
        return ()
    images = {role: _image(image_uid) for role, image_uid in uids.items()}
    for role, image in images.items():
        if image is None:  # Undo has taken it meanwhile
            images[role] = material.put_image(now, role, layers[role], order.share)
    material.adopt(now, images, order.share)
    result.settle(now)
    messages = material.wire_maps(now, result.solution, images, order.share)
    _note(now, result, record)
    return messages


def put(
    obj: bpy.types.Object, result: Result, packed: bool = True, directory: Path | None = None,
    share: bool | None = None,
) -> tuple[str, ...]:
    """A remembered result's maps on the materials of ``obj``, as `material.write_maps` does it.  Raises BadInput.

    ``share``: of maps that are files, as in `material.wire_maps`.
    """
    if directory is not None:
        require_own_files(obj)
    session.secure(obj)  # what is there now stays remembered
    result.settle(obj)
    solution = result.solution
    if result.files is not None:
        messages = material.link_files(obj, solution, result.files, share)
    else:
        messages = material.write_maps(obj, solution, packed=packed, directory=directory)
    _note(obj, result, stored_result.packed(obj, result))
    return messages


def is_placed(obj: bpy.types.Object) -> bool:
    """Whether the materials of ``obj`` show its last result."""
    results = session.results_of(obj)
    return bool(results) and results[-1].number == max(stored_result.number_of(obj), 1) and material.are_shown(obj)


def _note(obj: bpy.types.Object, result: Result, record: bytes) -> None:
    """The maps of ``result`` are on ``obj``: the file says so, and follows materials that were made for it."""
    result.settle(obj)
    stored_result.attach(obj, result, record)


def place_now(obj: bpy.types.Object, order: Order, solution: Solution) -> tuple[str, ...]:
    """`remember` and `place` in one go."""
    steps = place(obj, order, remember(obj, order, solution))
    while True:
        try:
            next(steps)
        except StopIteration as end:
            messages: tuple[str, ...] = end.value
            return messages


def _image(uid: int) -> bpy.types.Image | None:
    return next((image for image in bpy.data.images if image.session_uid == uid), None)


def files_of(order: Order, solution: Solution) -> MapFiles | None:
    """The files of large maps; None: the maps are in one piece."""
    if not order.large or order.folder is None:
        return None
    return material.files_of(order.name, solution.maps, order.folder, order.kind, order.udims)


def remember(obj: bpy.types.Object, order: Order, solution: Solution) -> Result:
    """The session's last result of the object."""
    return session.keep(obj, solution, order.label(solution), files_of(order, solution), order.names)


def learn(order: Order, solution: Solution, seconds: float) -> None:
    """What it took, ``seconds`` in all: for the next estimate.  One that went on from another's work says nothing."""
    if not solution.resumed_blocks:
        solve_speed.learn(order.data, order.settings, solution, seconds, order.udims)
