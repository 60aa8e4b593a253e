"""Time and memory of the next solve, shown before it starts; what solves on this machine have taken."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.capture.file_preview import same_file
from ...core.data import F32, SceneData, Solution
from ...core.errors import BadInput
from ...core.images.raw_reader import is_raw
from ...core.params import SolveSettings
from ...core.phrases import percent
from ...core.reporting import estimates
from ...core.reporting.estimates import Estimate, ViewSize, gigabytes
from ...core.tiled.uv_blocks import FIRST_UDIM, udims_of
from .. import preferences, properties
from ..scene import readiness
from .indirect import renders_direct_only
from .session import session

FILE = "irpso_speed.json"  # in the user's configuration folder

TOLD = 1_000_000_000  # bytes of disk from which on a panel names them
AGAIN = 3.0  # seconds until an object's UVs are looked at again



@dataclass
class _Known:
    """What was found out, and need not be again."""

    factors: dict[str, float] | None = None  # as in the file; None: not read yet
    looked: float = 0.0  # when an object's UVs were, last; ...
    looked_at: int = 0  # ... of which object; 0: none
    udims: tuple[int, ...] = (FIRST_UDIM,)  # ... and what they fill


_known = _Known()


def draw(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """A line each for time and memory; nothing before the pictures' sizes are known."""
    found = of(context)
    if found is None:
        return
    column, count = layout.column(align=True), len(readiness.solve_objects(context))
    unsure = "" if found.learnt else " (first guess)"
    seconds = estimates.in_words(found.seconds * max(count, 1)).capitalize()
    column.label(text=f"{seconds}{unsure}", icon="TIME")
    _draw_bounced(column, found.bounced * max(count, 1))
    memory = f"{gigabytes(found.gpu_bytes)} GPU memory, {gigabytes(found.host_bytes)} memory"
    column.label(text=memory[:1].upper() + memory[1:], icon="MEMORY")
    if found.disk_bytes > TOLD:
        column.label(text=f"{gigabytes(found.disk_bytes)} of disk", icon="DISK_DRIVE")
    if found.reduced < estimates.REDUCED:
        column.label(text=f"Pictures reduced to {percent(found.reduced ** 0.5)} to fit", icon="INFO")


def _draw_bounced(layout: bpy.types.UILayout, seconds: float) -> None:
    """What it takes if light bounces, where a solve finds that out on the way."""
    if seconds:
        layout.label(text=f"{estimates.in_words(seconds).capitalize()} if light bounces", icon="BLANK1")


def of(context: bpy.types.Context) -> Estimate | None:
    """The next solve of the active object; None: not known (pictures whose sizes are not, or numpy solves)."""
    settings, obj = properties.settings(context.scene.irpso), context.active_object
    full = settings.raw_size == "full"
    taken = [_sized(v.file.width, v.file.height, v.camera, v.lights, v.environment, full and is_raw(Path(v.image)))
             for v in readiness.recent(context).views if v.used and v.file is not None and v.file.width]
    if not taken or by_numpy():
        return None
    return estimates.estimate(taken, settings, factors(), preferences.device_settings().memory,
                             rounds=rounds(obj, settings, taken), udims=_udims(obj, settings),
                             triangles=_triangles(obj))


def by_numpy() -> bool:
    """Whether solves in the window are numpy's, which take other times."""
    return preferences.device_settings().device == "numpy"


def _udims(obj: bpy.types.Object | None, settings: SolveSettings) -> tuple[int, ...]:
    """Those that a solve of ``obj`` fills, as far as its mesh without modifiers tells; renewed now and then."""
    if settings.udim == "first" or obj is None or obj.type != "MESH" or obj.mode == "EDIT":
        return (FIRST_UDIM,)
    now, uid = time.monotonic(), obj.session_uid
    if _known.looked_at != uid or now - _known.looked > AGAIN:
        _known.looked, _known.looked_at, _known.udims = now, uid, (FIRST_UDIM,)
        with contextlib.suppress(BadInput):  # too many: the solve will say it
            _known.udims = udims_of(_middles(obj.data)) or (FIRST_UDIM,)
    return _known.udims


def _triangles(obj: bpy.types.Object | None) -> int:
    """Of the mesh without modifiers."""
    return 0 if obj is None or obj.type != "MESH" else len(obj.data.loops) - 2 * len(obj.data.polygons)


def _middles(mesh: bpy.types.Mesh) -> F32:
    """(F, 1, 2) UVs of the middles of a mesh's faces."""
    layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
    if layer is None or not mesh.polygons:
        return np.zeros((0, 1, 2), np.float32)
    uvs, starts = np.empty(len(layer.uv) * 2, np.float32), np.empty(len(mesh.polygons), np.int32)
    layer.uv.foreach_get("vector", uvs)
    mesh.polygons.foreach_get("loop_start", starts)
    sums = np.add.reduceat(uvs.reshape(-1, 2), starts, axis=0)
    return np.asarray(sums / np.diff(starts, append=len(layer.uv))[:, None], np.float32)[:, None]


def rounds(obj: bpy.types.Object | None, settings: SolveSettings, views: Sequence[ViewSize]) -> bool | None:
    """Whether indirect light is likely to be rendered: asked for, or found in the object's last solve.

    None: a solve looks on the way, because a world shines and the file renders light that bounces.
    """
    if settings.indirect != "auto":
        return settings.indirect == "on"
    last = session.facts_of(obj)
    if last is not None:
        return "indirect" in last.seconds
    return None if any(view.environment for view in views) and not renders_direct_only() else False


def learn(
    data: SceneData, settings: SolveSettings, solution: Solution, wall: float,
    udims: tuple[int, ...] = (FIRST_UDIM,),
) -> None:
    """Remembers what a solve took, ``wall`` seconds in all; stopped ones, parts and numpy's say nothing."""
    if solution.cancelled or data.region is not None or data.start is not None or by_numpy():
        return
    taken = _sizes(data)
    if len(taken) < len(data.views):  # the list has been changed meanwhile
        return
    reduced = estimates.reduced_share(taken, settings, preferences.device_settings().memory, udims)
    _known.factors = estimates.learnt(factors(), taken, settings, solution.seconds, wall, udims, reduced,
                                      len(data.mesh.positions))
    saved = path(), dict(_known.factors)
    threading.Thread(target=_save, args=saved, name="irpso-speed", daemon=True).start()  # disks may be slow


def _sized(width: int, height: int, camera: str, lights: int, environment: str, full_raw: bool) -> ViewSize:
    """Of a file whose size is known binned, 2 x 2 as most are."""
    times = 2 if full_raw else 1
    return ViewSize(times * width, times * height, camera, lights, environment)


def _sizes(data: SceneData) -> Sequence[ViewSize]:
    """The views as they were solved; sizes as the panels know them."""
    states = readiness.recent(bpy.context).views
    known = {same_file(state.image): state.file for state in states if state.file is not None}
    return [_sized(file.width, file.height, view.camera.name, len(view.lights),
                   str(view.environment.key) if view.environment else "", view.full_raw) for view in data.views
            if (file := known.get(same_file(str(view.image)))) is not None]


def factors() -> dict[str, float]:
    """What was learnt, read once."""
    if _known.factors is None:
        _known.factors = estimates.read_factors(path())
    return _known.factors


def path() -> Path:
    """Where it is kept."""
    return Path(bpy.utils.user_resource("CONFIG")) / FILE


def _save(target: Path, content: dict[str, float]) -> None:
    with contextlib.suppress(BadInput, OSError):  # a guess is not worth a message
        target.parent.mkdir(parents=True, exist_ok=True)
        estimates.write_factors(target, content)


def forget() -> None:
    """As if nothing had been read: for tests."""
    _known.factors = None


