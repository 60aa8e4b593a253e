"""Wraps the product's functions from outside, so that a ledger hears of them; nothing in the product knows of it.

PARTS names the functions.  A name that is no longer there is an error: the page would then name a part that nobody
measures.
"""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from functools import wraps
from types import MappingProxyType
from typing import Any

import moderngl

from irpso_addon.gpu.device import thread
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.device.draw_budget import DrawBudget
from irpso_addon.gpu.device.memory import DeviceMemory
from irpso_addon.gpu.device.programs import Programs
from irpso_addon.gpu.solve.tile_passes import TilePasses

from .ledger import COMPILE, GPU, READ_BACK, UPLOAD, Ledger

BYTES = {"f1": 1, "f2": 2, "f4": 4, "u4": 4}  # of a texture's number
START, SCENE, PICTURES, FILES, DEVICE = (
    "start, imports, end", "opening the scene", "reading pictures", "writing files", "making the device")
# Kernels that run over tiles, by what they are part of; others are "rest of the solve".
KERNELS = {"solve/search.kernel": "search", "solve/table.kernel": "tables", "solve/polish.kernel": "polish",
           "solve/polish_two.kernel": "polish", "solve/finish.kernel": "polish"}
REST = "rest of the solve"
PARTS = {  # part: functions, methods and generators of it, below irpso_addon
    DEVICE: ["gpu.device.context:Device.__init__", "gpu.device.context:Device._measure_compute"],
    "G-buffer": ["gpu.gbuffer.texel_grid:draw_texels", "gpu.gbuffer.gbuffer:draw_pixel_grid",
                 "solve.one_round:_checked"],
    "visibility": ["gpu.observe.visibility:LightVisibility.lit_maps",
                   "gpu.observe.environment_light:LitByEnvironment.light"],
    "observations": ["gpu.observe.observations:observe"],
    "gathering to texels": ["gpu.observe.observation_atlas:CameraSource.gather",
                            "gpu.observe.observation_atlas:ObservationAtlas.work"],
    REST: ["gpu.solve.model_ladder:Ladder.solve"],
    "neighbours": ["gpu.solve.neighbours:noise_map", "gpu.solve.neighbours:pyramid",
                   "gpu.solve.neighbours:clean_noise", "gpu.solve.neighbours:scatter"],
    "trials of models": ["gpu.solve.model_ladder:Ladder._try_larger", "gpu.solve.material_solves:MaterialSolves.level",
                         "gpu.solve.model_prediction:ModelPrediction.decide",
                         "gpu.solve.model_prediction:ModelPrediction.metal"],
    "calibration": ["solve.gpu_path:_calibrated", "solve.outlined_scene:through_right_cameras"],
    "normals": ["solve.refined_scene:_judged", "gpu.solve.normal_texels:refined_normals",
                "gpu.solve.followed_mesh:followed"],
    "base colour of pixels": ["gpu.maps.albedo:AlbedoSolver.solve"],
    "back-projection": ["gpu.maps.albedo:AlbedoSolver._back_project"],
    "fill": ["gpu.maps.fill:fill", "gpu.maps.fill:Filler.fill"],
    "standard errors": ["gpu.maps.finish_maps:_certainty"],
    "rest of the maps": ["gpu.maps.finish_maps:make_maps", "solve.one_round:_solution"],
    "checks": ["solve.one_round:_checks", "core.checks.mended_cameras:corrected"],
    "indirect light": ["solve.pipeline:_take_out_indirect"],
}
EXPECTS = "blender.jobs.solve_object:expected"
OF_COMMANDS = {  # what the commands do besides; where there is no Blender some cannot be imported
    START: ["blender.oiio:ensure_openimageio", "blender.logs:begin"],
    SCENE: ["blender.files:open_blend", "blender.jobs.solve_object:read", "blender.jobs.solve_object:check",
            EXPECTS, "cli.solve:print_estimate", "solve.farm:_planned"],
    PICTURES: ["solve.block_solve:_views"],
    FILES: ["blender.jobs.solve_object:place_now", "core.maps.export:write_maps", "blender.files:save_copy",
            "core.reporting.report:build_report", "core.reporting.report:write_report",
            "core.storage.output_transaction:OutputTransaction.__enter__",
            "core.storage.output_transaction:OutputTransaction.publish",
            "core.storage.output_transaction:OutputTransaction.__exit__",
            "core.tiled.work_folder:WorkFolder.write_block"],
}


@contextmanager
def instrumented(ledger: Ledger, more: Mapping[str, Sequence[str]] = MappingProxyType({})) -> Iterator[None]:
    """Within, the ledger hears of all that this process does.  ``more``: parts besides PARTS, as of `of_command`."""
    with ExitStack() as undo:
        _measure_threads(ledger, undo)
        _measure_device(ledger, undo)
        _measure_draws(ledger, undo)
        _measure_kernels(ledger, undo)
        for part, names in (*PARTS.items(), *more.items()):
            for name in names:
                _wrap(name, lambda original, part=part: _as_part(ledger, part, original), undo)
        if EXPECTS in more.get(SCENE, ()):
            _wrap(EXPECTS, lambda original: _kept(ledger, original), undo)
        yield


def of_command(blender: bool) -> dict[str, list[str]]:
    """Parts of the command line's own work, with what needs Blender or without."""
    return {part: [name for name in names if blender or not name.startswith(("blender.", "cli."))]
            for part, names in OF_COMMANDS.items()}


def _wrap(name: str, make: Callable[[Callable[..., Any]], Callable[..., Any]], undo: ExitStack) -> None:
    """Put ``make(function)`` in the function's place, wherever it was imported to; and back again."""
    module_name, path = name.split(":")
    owner: Any = importlib.import_module(f"irpso_addon.{module_name}")
    *outer, last = path.split(".")
    for each in outer:
        owner = getattr(owner, each)
    original = vars(owner)[last]
    made = make(original)
    places = [owner]
    if not outer:
        places = [module for key, module in list(sys.modules.items())
                  if key.startswith("irpso_addon") and vars(module).get(last) is original]
    for place in places:
        _replace(place, last, made, undo)


def _replace(owner: Any, name: str, value: Any, undo: ExitStack) -> None:
    before = vars(owner)[name]
    setattr(owner, name, value)
    undo.callback(setattr, owner, name, before)


def _as_part(ledger: Ledger, part: str, original: Callable[..., Any]) -> Callable[..., Any]:
    if inspect.isgeneratorfunction(original):
        @wraps(original)
        def steps(*given: Any, **named: Any) -> Any:
            return (yield from ledger.steps(part, original(*given, **named)))
        return steps

    @wraps(original)
    def function(*given: Any, **named: Any) -> Any:
        with ledger.within(part):
            return original(*given, **named)
    return function


def _as_kind(ledger: Ledger, kind: str, original: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(original)
    def function(*given: Any, **named: Any) -> Any:
        with ledger.within(kind=kind):
            return original(*given, **named)
    return function


def _measure_threads(ledger: Ledger, undo: ExitStack) -> None:
    """The GL thread has a lane while it has a job; whoever waits for a job does nothing else."""
    run_job, run, result = thread.Job._run, thread.run, Future.result

    def job(self: thread.Job) -> None:
        with ledger.lane():
            run_job(self)

    def waiting(*given: Any, **named: Any) -> Any:
        with ledger.elsewhere():
            return run(*given, **named)

    def picture(self: Future[Any], timeout: float | None = None) -> Any:
        with ledger.within(PICTURES):
            return result(self, timeout)

    _replace(thread.Job, "_run", job, undo)
    _replace(thread, "run", waiting, undo)
    _replace(Future, "result", picture, undo)


def _measure_device(ledger: Ledger, undo: ExitStack) -> None:
    """What is made on the device, goes there and comes back."""
    make, make_depth, make_buffer, read = (
        DeviceMemory.texture, DeviceMemory.depth_map, DeviceMemory.buffer, DeviceMemory.read)
    write, frees = moderngl.Texture.write, (moderngl.Texture.release, moderngl.Buffer.release)

    def texture(self: DeviceMemory, width: int, height: int, channels: int = 4, data: Any = None,
                dtype: str = "f4") -> moderngl.Texture:
        with ledger.within(kind=UPLOAD):
            made = make(self, width, height, channels, data, dtype)
        size = width * height * channels * BYTES[dtype]
        ledger.made(id(made), size)
        ledger.bytes["uploaded"] += 0 if data is None else size
        return made

    def depth_map(self: DeviceMemory, width: int, height: int) -> moderngl.Texture:
        with ledger.within(kind=UPLOAD):
            made = make_depth(self, width, height)
        ledger.made(id(made), 4 * width * height)
        return made

    def buffer(self: DeviceMemory, data: Any) -> moderngl.Buffer:
        with ledger.within(kind=UPLOAD):
            made = make_buffer(self, data)
        ledger.made(id(made), data.nbytes)
        ledger.bytes["uploaded"] += data.nbytes
        return made

    def read_back(self: DeviceMemory, *given: Any) -> Any:
        with ledger.within(kind=GPU):
            self.ctx.finish()  # what is waited for here is drawing
        with ledger.within(kind=READ_BACK):
            values = read(self, *given)
        ledger.bytes["read back"] += values.nbytes
        return values

    def written(self: moderngl.Texture, data: Any, *given: Any, **named: Any) -> None:
        with ledger.within(kind=UPLOAD):
            write(self, data, *given, **named)
        ledger.bytes["uploaded"] += len(data)

    for owner, name, value in (
        (DeviceMemory, "texture", texture), (DeviceMemory, "depth_map", depth_map), (DeviceMemory, "buffer", buffer),
        (DeviceMemory, "read", read_back), (moderngl.Texture, "write", written),
        (DeviceMemory, "framebuffer", _as_kind(ledger, UPLOAD, DeviceMemory.framebuffer)),
    ):
        _replace(owner, name, value, undo)
    for owner, release in zip((moderngl.Texture, moderngl.Buffer), frees, strict=True):
        def freed(self: Any, release: Callable[[Any], None] = release) -> None:
            ledger.freed(id(self))
            with ledger.within(kind=UPLOAD):
                release(self)
        _replace(owner, "release", freed, undo)


def _measure_draws(ledger: Ledger, undo: ExitStack) -> None:
    """Each piece of a draw is waited for by itself.  A program's first piece holds the driver's compilation."""
    piece, blending = DrawBudget.piece, Device._blending
    known: set[Any] = set()
    blended: list[int] = []  # drivers compile again for another way to write

    @contextmanager
    def measured(self: DrawBudget, key: Any, units: float) -> Iterator[None]:
        kind = (key, *blended)  # the target's size too: llvmpipe compiles again for textures of other sizes
        compiles = kind not in known
        known.add(kind)
        with ledger.piece(str(key[0]), units, compiles):
            with piece(self, key, units):
                yield
            self.finish()

    @contextmanager
    def blends(self: Device, equation: int) -> Iterator[None]:
        blended.append(equation)
        try:
            with blending(self, equation):
                yield
        finally:
            blended.pop()

    _replace(DrawBudget, "piece", measured, undo)
    _replace(Device, "_blending", blends, undo)
    for name in ("get", "compute"):
        _replace(Programs, name, _as_kind(ledger, COMPILE, vars(Programs)[name]), undo)
    _replace(DeviceMemory, "_finish", _as_kind(ledger, GPU, DeviceMemory._finish), undo)


def _measure_kernels(ledger: Ledger, undo: ExitStack) -> None:
    """Kernels over tiles by their names, and how much they are asked for."""
    run_tile = TilePasses._run_tile

    def counted(self: Any, work: Any, target: Any, tile: Any, defines: Any) -> Iterator[None]:
        yield from ledger.steps(KERNELS.get(work.kernel, REST), run_tile(self, work, target, tile, defines))
        (width, height), (x, y) = self.atlas.tile, tile
        rows = self._work[tile]
        count = ledger.work[f"{work.kernel} {work.lobes}" + (" of trials" if not self.shown else "")]
        count["texels"] += float(self.covered[y:y + height, x:x + width].sum())
        count["observations"] += float(rows.sum()) - width * len(rows)
        count["layers"], count["lights"] = len(self.source.layers.groups), self.source.layers.lights
        count["groups"] = len(set(self.source.layers.groups))
        for name in ("u_particles", "u_moves", "u_race_steps", "u_final_steps", "u_steps"):
            if name in work.uniforms:
                count[name] = float(work.uniforms[name])
        count["outputs"] = len(work.outputs)
        count["passes"] += 1

    _replace(TilePasses, "_run_tile", counted, undo)


def _kept(ledger: Ledger, original: Callable[..., Any]) -> Callable[..., Any]:
    """The device's memory as the add-on expects it."""
    @wraps(original)
    def expected(*given: Any) -> Generator[Any, None, Any]:
        needs = yield from original(*given)
        ledger.facts["estimated"] = needs.gpu_bytes
        return needs
    return expected
