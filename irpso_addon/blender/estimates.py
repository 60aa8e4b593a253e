"""Time and memory of the next solve, shown before it starts; what solves on this machine have taken."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Sequence
from pathlib import Path

import bpy

from ..core import estimate
from ..core.data import SceneData, Solution
from ..core.errors import BadInput
from ..core.estimate import Estimate, Taken
from ..core.glance import same_file
from ..core.params import SolveSettings
from . import preferences, properties, readiness, session

FILE = "irpso_speed.json"  # in the user's configuration folder

_factors: dict[str, float] | None = None  # as in the file; None: not read yet


def draw(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """A line each for time and memory; nothing before the pictures' sizes are known."""
    found = of(context)
    if found is None:
        return
    column, count = layout.column(align=True), len(readiness.solve_objects(context))
    unsure = "" if found.learnt else " (first guess)"
    seconds = estimate.in_words(found.seconds * max(count, 1)).capitalize()
    column.label(text=f"{seconds}{unsure}", icon="TIME")
    column.label(text=f"{_gigabytes(found.gpu_bytes)} GPU memory, {_gigabytes(found.host_bytes)} memory", icon="MEMORY")
    if found.reduced < 0.99:
        column.label(text=f"Pictures reduced to {found.reduced ** 0.5:.0%} to fit", icon="INFO")


def of(context: bpy.types.Context) -> Estimate | None:
    """The next solve of the active object; None: the pictures' sizes are not known, or there are none."""
    taken = [Taken(v.file.width, v.file.height, v.camera, v.lights) for v in readiness.recent(context).views
             if v.used and v.file is not None and v.file.width]
    if not taken:
        return None
    settings = properties.settings(context.scene.irpso)
    return estimate.estimate(taken, settings, factors(), preferences.device_settings().memory,
                             rounds=_rounds(context.active_object, settings))


def _rounds(obj: bpy.types.Object | None, settings: SolveSettings) -> bool:
    """Whether indirect light is likely to be rendered: asked for, or found in the object's last solve."""
    last = session.solution_of(obj)
    return settings.indirect == "on" or (
        settings.indirect == "auto" and last is not None and "indirect" in last.seconds)


def learn(data: SceneData, settings: SolveSettings, solution: Solution, wall: float) -> None:
    """Remembers what a solve took, ``wall`` seconds in all; one that was stopped, or was of a part, says nothing."""
    global _factors
    if solution.cancelled or data.region is not None or data.start is not None:
        return
    taken = _sizes(data)
    if len(taken) < len(data.views):  # the list has been changed meanwhile
        return
    _factors = estimate.learnt(factors(), taken, settings, solution.seconds, wall)
    saved = path(), dict(_factors)
    threading.Thread(target=_save, args=saved, name="irpso-speed", daemon=True).start()  # disks may be slow


def _sizes(data: SceneData) -> Sequence[Taken]:
    """The views as they were solved; sizes as the panels know them."""
    states = readiness.recent(bpy.context).views
    known = {same_file(state.image): state.file for state in states if state.file is not None}
    return [Taken(file.width, file.height, view.camera.name, len(view.lights)) for view in data.views
            if (file := known.get(same_file(str(view.image)))) is not None]


def factors() -> dict[str, float]:
    """What was learnt, read once."""
    global _factors
    if _factors is None:
        _factors = estimate.read_factors(path())
    return _factors


def path() -> Path:
    """Where it is kept."""
    return Path(bpy.utils.user_resource("CONFIG")) / FILE


def _save(target: Path, content: dict[str, float]) -> None:
    with contextlib.suppress(BadInput, OSError):  # a guess is not worth a message
        target.parent.mkdir(parents=True, exist_ok=True)
        estimate.write_factors(target, content)


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 50_000_000 else "Below 0.1 GB"


def forget() -> None:
    """As if nothing had been read: for tests."""
    global _factors
    _factors = None


