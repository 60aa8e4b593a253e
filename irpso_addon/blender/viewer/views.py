"""What the Image Editor shows of a solve: of which object, what; in the `editors`, drawn by `view_draw`."""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field

import bpy
from bpy.app.handlers import persistent

from ...core.data import F16, F32, Maps, ViewPicture
from ...core.evaluation.chart_data import Chart
from ...core.evaluation.display import Difference, apart, white
from ...core.live_maps import difference
from ..jobs.session import Result, Running, object_by_uid, session

Curve = list[tuple[float, float]]  # seconds, error


@dataclass(frozen=True)
class ObjectState:
    """What is known of one object now."""

    name: str
    maps: Mapping[str, F32]  # as core.live.Live.maps
    pictures: tuple[ViewPicture, ...]
    running: bool


@dataclass(frozen=True)
class Plate:
    """What is drawn in the image's place: one array, or two that are wiped or compared.  Row 0 at the bottom.

    kind: "color" (linear), "data" (shown as it is), "heat" (by the scale of errors), "relative" (heat of ``second``
    against ``first``), "difference" (heat of how far they are apart).
    """

    kind: str
    first: F32 | F16
    second: F32 | F16 | None = None
    wipe: bool = False
    gain: float = 1.0  # of colour, before the display's exposure
    captions: tuple[str, str] = ("", "")  # left and right of the line


@dataclass
class _Memory:
    """What outlives a running job until a file is loaded."""

    curves: dict[int, Curve] = field(default_factory=dict)  # by object
    # A running job's latest; the job is not kept alive, for its maps.
    pictures: tuple[weakref.ref[Running], tuple[ViewPicture, ...]] | None = None
    charts: dict[int, Chart] = field(default_factory=dict)  # by object
    apart: tuple[Maps, Maps, Difference] | None = None  # the last pair of results and its figures
    whites: list[tuple[F16, float]] = field(default_factory=list)
    error: tuple[ViewPicture, float] | None = None  # the last picture's


_memory = _Memory()


def remember() -> None:
    """Keeps what the running job has shown, for when it is over."""
    running = session.running
    if running is None or not running.object_uid:
        return
    if running.curve:
        _memory.curves[running.object_uid] = running.curve
    if running.live is not None and running.live.pictures:
        _memory.pictures = weakref.ref(running), running.live.pictures


@persistent
def _forget(*_: object) -> None:
    """load_pre handler."""
    global _memory
    _memory = _Memory()


def subject(context: bpy.types.Context) -> bpy.types.Object | None:
    """The object that is looked at: the one being solved, else the active one."""
    if session.running is not None and session.running.object_uid:
        return object_by_uid(session.running.object_uid)
    return session.subject(context)


def look(context: bpy.types.Context) -> ObjectState | None:
    """What is known of the subject: of its running solve, else of its last one."""
    obj = subject(context)
    if obj is None:
        return None
    solution, running = session.solution_of(obj), session.running
    if running is not None and running.live is not None and running.object_uid == obj.session_uid:
        pictures = running.live.pictures
        if not pictures and _memory.pictures is not None and _memory.pictures[0]() is running:
            pictures = _memory.pictures[1]
        return ObjectState(obj.name, running.live.maps, pictures, True)
    if solution is None:
        return None
    maps = solution.maps
    roles = {"base_color": maps.base_color, "roughness": maps.roughness, "confidence": maps.confidence,
             "error": maps.error}
    return ObjectState(obj.name, roles, solution.pictures, False)


def curve(context: bpy.types.Context) -> Curve:
    """Seconds and errors of the subject's running or last solve."""
    obj, running = subject(context), session.running
    if running is not None and running.preview is not None:
        return running.curve
    return [] if obj is None else _memory.curves.get(obj.session_uid, [])


def chart(context: bpy.types.Context) -> Chart | None:
    """The last comparison of methods on the subject."""
    obj = subject(context)
    return None if obj is None else _memory.charts.get(obj.session_uid)


def keep_chart(obj: bpy.types.Object, made: Chart) -> None:
    """Remembers the comparison of methods on ``obj``, and shows it."""
    _memory.charts[obj.session_uid] = made
    bpy.context.window_manager.irpso_views.show = "CHART"


def picture(context: bpy.types.Context) -> ViewPicture | None:
    """The view that is chosen; the last one where the choice is beyond."""
    known = look(context)
    if known is None or not known.pictures:
        return None
    return known.pictures[min(context.window_manager.irpso_views.view, len(known.pictures) - 1)]


def error(shown: ViewPicture) -> float:
    """Relative difference of a view and its prediction; remembered, because panels ask at each redraw."""
    if _memory.error is None or _memory.error[0] is not shown:
        _memory.error = (shown, difference((shown,)))
    return _memory.error[1]


def pair(context: bpy.types.Context) -> tuple[Result, Result] | None:
    """The two results that are compared; the oldest where a choice is beyond."""
    obj = subject(context)
    if obj is None or len(session.results_of(obj)) < 2:
        return None
    session.secure(obj)  # their maps are shown
    results = session.results_of(obj)[::-1]
    if len(results) < 2:
        return None
    chosen = context.window_manager.irpso_views
    return results[min(chosen.first, len(results) - 1)], results[min(chosen.second, len(results) - 1)]


def figures(first: Maps, second: Maps) -> Difference:
    """How far two results are apart; remembered, because panels ask at each redraw."""
    known = _memory.apart
    if known is None or known[0] is not first or known[1] is not second:
        known = _memory.apart = (first, second, apart(first, second))
    return known[2]


def plate(context: bpy.types.Context) -> Plate | None:
    """What is drawn in the image's place now."""
    chosen = context.window_manager.irpso_views
    if chosen.show == "VIEWS":
        shown = picture(context)
        return None if shown is None else _view_plate(shown, chosen.picture)
    if chosen.show == "RESULTS":
        both = pair(context)
        return None if both is None else _pair_plate(*both, chosen)
    known = look(context) if chosen.show == "MAPS" else None
    if known is None or chosen.map not in known.maps:
        return None
    kind = {"base_color": "color", "error": "heat"}.get(chosen.map, "data")
    return Plate(kind, known.maps[chosen.map])


def _view_plate(shown: ViewPicture, what: str) -> Plate:
    gain = 1 / _white(shown.reference)
    if what == "WIPE":
        return Plate("color", shown.reference, shown.predicted, True, gain, ("Reference", "Prediction"))
    if what == "ERROR":
        return Plate("relative", shown.reference, shown.predicted, gain=gain)
    return Plate("color", shown.predicted if what == "PREDICTED" else shown.reference, gain=gain)


def _pair_plate(first: Result, second: Result, chosen: bpy.types.PropertyGroup) -> Plate:
    a, b = (getattr(result.solution.maps, chosen.compared) for result in (first, second))
    if chosen.contrast == "DIFFERENCE":
        return Plate("difference", a, b)
    kind = "color" if chosen.compared == "base_color" else "data"
    return Plate(kind, a, b, True, captions=(f"A: {first.label}", f"B: {second.label}"))


def _white(reference: F16) -> float:
    """As `white`; remembered."""
    for known, value in _memory.whites:
        if known is reference:
            return value
    _memory.whites = [*_memory.whites[-31:], (reference, white(reference))]
    return _memory.whites[-1][1]


def register() -> None:
    """Adds the handler."""
    bpy.app.handlers.load_pre.append(_forget)


def unregister() -> None:
    """Takes it back."""
    bpy.app.handlers.load_pre.remove(_forget)
