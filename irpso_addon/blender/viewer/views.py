"""What the Image Editor shows of a solve: which editors, of which object, what; drawn by `view_draw`.

An editor takes part when it shows our image, an empty one that only gives the drawing its place: so panning and zooming
are Blender's own, and choosing another image ends it.  The image is runtime data: it is in no saved file, has no
unsaved pixels, and goes when a file is loaded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import bpy
from bpy.app.handlers import persistent

from ...core.data import F16, F32, Maps, ViewPicture
from ...core.evaluation.chart_data import Chart
from ...core.evaluation.display import Difference, apart, white
from ...core.live_maps import difference
from ..jobs import session
from ..material.tags import TAG

NAME = "IRPSO Views"
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
    pictures: tuple[session.Running, tuple[ViewPicture, ...]] | None = None  # a running job's latest
    charts: dict[int, Chart] = field(default_factory=dict)  # by object
    apart: tuple[Maps, Maps, Difference] | None = None  # the last pair of results and its figures
    whites: list[tuple[F16, float]] = field(default_factory=list)
    error: tuple[ViewPicture, float] | None = None  # the last picture's
    undoing: list[int] = field(default_factory=list)  # areas that showed ours before Undo


_memory = _Memory()


# ---- editors


def editors() -> Iterator[tuple[bpy.types.Window, bpy.types.Area]]:
    """The Image Editors that show ours."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR" and is_ours(area.spaces.active.image):
                yield window, area


def is_ours(image: bpy.types.Image | None) -> bool:
    """Whether it is the image that marks our editors."""
    return image is not None and image.is_runtime_data and TAG in image


def show(context: bpy.types.Context) -> None:
    """Shows ours in an open Image Editor, first in one that does already or is empty; in a new window where none is."""
    areas = [area for window in [context.window, *context.window_manager.windows] for area in window.screen.areas
             if area.ui_type == "IMAGE_EDITOR"]
    if not areas:
        bpy.ops.wm.window_new()
        areas = [context.window_manager.windows[-1].screen.areas[0]]
        areas[0].ui_type = "IMAGE_EDITOR"
    show_in(min(areas, key=_suits))


def _suits(area: bpy.types.Area) -> int:
    """0: shows ours, 1: nothing, 2: something else."""
    image = area.spaces.active.image
    return 0 if is_ours(image) else 1 if image is None else 2


def show_in(area: bpy.types.Area) -> None:
    """Shows ours in an Image Editor, with its sidebar."""
    space = area.spaces.active
    space.image = _image()
    space.mode = "VIEW"
    space.show_region_ui = True
    refresh()
    bpy.app.timers.register(_Fit(area).step, first_interval=0.05)


class _Fit:
    """Once the sidebar is there: our tab, and the whole image in the window."""

    def __init__(self, area: bpy.types.Area) -> None:
        self.pointer, self.tries = area.as_pointer(), 20

    def step(self) -> float | None:
        """A timer's function."""
        self.tries -= 1
        found = next(((window, area) for window, area in editors() if area.as_pointer() == self.pointer), None)
        if found is None or not self.tries:
            return None
        window, area = found
        sidebar = next(region for region in area.regions if region.type == "UI")
        if sidebar.width <= 1:
            return 0.05
        try:
            sidebar.active_panel_category = "IRPSO"
        except (TypeError, AttributeError):  # its panels have not been drawn yet
            return 0.05
        with bpy.context.temp_override(window=window, area=area, region=_canvas(area)):
            _fit(area, sidebar.width if sidebar.x < area.x + area.width - 1 else 0)
        return None


def _fit(area: bpy.types.Area, covered: int) -> None:
    """The whole image into the part of the editor that the sidebar, ``covered`` pixels wide, leaves free."""
    canvas, space = _canvas(area), area.spaces.active
    width, height = space.image.size
    bpy.ops.image.view_all()  # centred
    free = canvas.width - covered
    ratio = 0.94 * min(free / width, canvas.height / height)
    bpy.ops.image.view_zoom_ratio(ratio=ratio)
    bpy.ops.image.view_pan(offset=(covered / 2 / ratio, 0.0))


def _canvas(area: bpy.types.Area) -> bpy.types.Region:
    return next(region for region in area.regions if region.type == "WINDOW")


def _image() -> bpy.types.Image:
    """Ours; made where there is none."""
    found = next(filter(is_ours, bpy.data.images), None)
    if found is not None:
        return found
    image = bpy.data.images.new(NAME, 512, 512)
    image.is_runtime_data = True
    image[TAG] = "views"
    return image


def refresh() -> None:
    """Draws anew what our editors show: what is known or chosen has changed.  Main thread; cheap."""
    _remember()
    shown = list(editors())
    if not shown:
        return
    image, shape = shown[0][1].spaces.active.image, _shape(bpy.context)
    if (image.generated_width, image.generated_height) != shape:
        image.generated_width, image.generated_height = shape
    for _, area in shown:
        area.tag_redraw()


def _shape(context: bpy.types.Context) -> tuple[int, int]:
    """Width and height of what is shown; no smaller than a window, so that zooming feels alike."""
    drawn = plate(context)
    height, width = (512, 512) if drawn is None else drawn.first.shape[:2]
    grow = 512 / max(width, height)
    return max(round(width * grow), 1), max(round(height * grow), 1)


def _remember() -> None:
    running = session.running
    if running is None or not running.object_uid:
        return
    if running.curve:
        _memory.curves[running.object_uid] = running.curve
    if running.live is not None and running.live.pictures:
        _memory.pictures = running, running.live.pictures


@persistent
def _forget(*_: object) -> None:
    """load_pre handler."""
    global _memory
    _memory = _Memory()


@persistent
def _undoing(*_: object) -> None:
    """undo_pre and redo_pre handler."""
    _memory.undoing = [area.as_pointer() for _, area in editors()]


@persistent
def _undone(*_: object) -> None:
    """undo_post and redo_post handler: the image has its old shape, or is gone where the step is older than it."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.as_pointer() in _memory.undoing and area.spaces.active.image is None:
                area.spaces.active.image = _image()
                bpy.app.timers.register(_Fit(area).step, first_interval=0.05)
    refresh()


# ---- what is known


def subject(context: bpy.types.Context) -> bpy.types.Object | None:
    """The object that is looked at: the one being solved, else the active one."""
    if session.running is not None and session.running.object_uid:
        return session.object_by_uid(session.running.object_uid)
    return getattr(context, "active_object", None) or context.view_layer.objects.active


def look(context: bpy.types.Context) -> ObjectState | None:
    """What is known of the subject: of its running solve, else of its last one."""
    obj = subject(context)
    if obj is None:
        return None
    solution, running = session.solution_of(obj), session.running
    if running is not None and running.live is not None and running.object_uid == obj.session_uid:
        pictures = running.live.pictures
        if not pictures and _memory.pictures is not None and _memory.pictures[0] is running:
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


def pair(context: bpy.types.Context) -> tuple[session.Result, session.Result] | None:
    """The two results that are compared; the oldest where a choice is beyond."""
    results = session.results_of(subject(context))[::-1]
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


def _pair_plate(first: session.Result, second: session.Result, chosen: bpy.types.PropertyGroup) -> Plate:
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


HANDLERS = (("load_pre", _forget), ("undo_pre", _undoing), ("redo_pre", _undoing), ("undo_post", _undone),
            ("redo_post", _undone))


def register() -> None:
    """Adds the handlers."""
    for name, function in HANDLERS:
        getattr(bpy.app.handlers, name).append(function)


def unregister() -> None:
    """Takes handlers and image back."""
    for name, function in HANDLERS:
        getattr(bpy.app.handlers, name).remove(function)
    for image in list(filter(is_ours, bpy.data.images)):
        bpy.data.images.remove(image)
