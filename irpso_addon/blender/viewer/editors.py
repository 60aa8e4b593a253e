"""The Image Editors that show a solve: found, opened, drawn anew.  What they show: `views`.

An editor takes part when it shows our image, an empty one that only gives the drawing its place: so panning and zooming
are Blender's own, and choosing another image ends it.  The image is runtime data: it is in no saved file, has no
unsaved pixels, and goes when a file is loaded.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
from bpy.app.handlers import persistent

from ..material.tags import TAG
from ..panel_common import is_closing
from . import views

NAME = "IRPSO Views"

_before_undo: set[int] = set()  # areas that showed ours


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
    areas = _areas(context) or [_new_area(context)]
    show_in(min(areas, key=_suits))


def show_still(image: bpy.types.Image, context: bpy.types.Context | None = None) -> None:
    """Shows a picture in an Image Editor that has it or is empty; with ``context`` in any, or in a new window."""
    if context is not None:
        show_picture(image, context)
        return
    areas = [area for area in _areas(bpy.context) if area.spaces.active.image in (None, image)]
    if areas:
        _put(image, areas)


def show_picture(image: bpy.types.Image, context: bpy.types.Context) -> tuple[bpy.types.Window, bpy.types.Area]:
    """Shows a picture in an Image Editor, first in one that has it or is empty; in a new window where none is."""
    area = _put(image, _areas(context) or [_new_area(context)])
    return next(window for window in context.window_manager.windows if area in list(window.screen.areas)), area


def _put(image: bpy.types.Image, areas: list[bpy.types.Area]) -> bpy.types.Area:
    """The picture into that of the areas which suits best."""
    area = min(areas, key=lambda area: {image: 0, None: 1}.get(area.spaces.active.image, 2))
    space = area.spaces.active
    if space.image != image:
        space.image = image
        bpy.app.timers.register(_FitAll(area).step, first_interval=0.05)
    area.tag_redraw()
    return area


class _FitAll:
    """Once the editor has its size: the whole picture in it."""

    def __init__(self, area: bpy.types.Area) -> None:
        self.pointer, self.tries = area.as_pointer(), 20

    def step(self) -> float | None:
        """A timer's function."""
        self.tries -= 1
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.as_pointer() != self.pointer or area.type != "IMAGE_EDITOR" or not self.tries:
                    continue
                if canvas(area).width <= 1:
                    return 0.05
                with bpy.context.temp_override(window=window, area=area, region=canvas(area)):
                    bpy.ops.image.view_all(fit_view=True)
        return None


def _areas(context: bpy.types.Context) -> list[bpy.types.Area]:
    """The Image Editors, those of the present window first."""
    windows = [context.window] if context.window is not None else []
    return [area for window in [*windows, *context.window_manager.windows] for area in window.screen.areas
            if area.type == "IMAGE_EDITOR"]


def _new_area(context: bpy.types.Context) -> bpy.types.Area:
    """An Image Editor in a window of its own."""
    bpy.ops.wm.window_new()
    area = context.window_manager.windows[-1].screen.areas[0]
    area.ui_type = "IMAGE_EDITOR"
    return area


def _suits(area: bpy.types.Area) -> int:
    """0: shows ours, 1: nothing, 2: something else, 3: UVs."""
    image = area.spaces.active.image
    if is_ours(image):
        return 0
    return 3 if area.ui_type != "IMAGE_EDITOR" else 1 if image is None else 2


def show_in(area: bpy.types.Area) -> None:
    """Shows ours in an Image Editor, with its sidebar."""
    if area.ui_type != "IMAGE_EDITOR":  # a UV Editor, which draws the UVs over it
        area.ui_type = "IMAGE_EDITOR"
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
        with bpy.context.temp_override(window=window, area=area, region=canvas(area)):
            _fit(area, sidebar.width if sidebar.x < area.x + area.width - 1 else 0)
        return None


def _fit(area: bpy.types.Area, covered: int) -> None:
    """The whole image into the part of the editor that the sidebar, ``covered`` pixels wide, leaves free."""
    space = area.spaces.active
    width, height = space.image.size
    bpy.ops.image.view_all()  # centred
    free = canvas(area).width - covered
    ratio = 0.94 * min(free / width, canvas(area).height / height)
    bpy.ops.image.view_zoom_ratio(ratio=ratio)
    bpy.ops.image.view_pan(offset=(covered / 2 / ratio, 0.0))


def canvas(area: bpy.types.Area) -> bpy.types.Region:
    """Where the editor shows its image."""
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
    views.remember()
    if is_closing():
        return
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
    drawn = views.plate(context)
    height, width = (512, 512) if drawn is None else drawn.first.shape[:2]
    grow = 512 / max(width, height)
    return max(round(width * grow), 1), max(round(height * grow), 1)


@persistent
def _undoing(*_: object) -> None:
    """undo_pre and redo_pre handler."""
    _before_undo.clear()
    _before_undo.update(area.as_pointer() for _, area in editors())


@persistent
def _undone(*_: object) -> None:
    """undo_post and redo_post handler: the image has its old shape, or is gone where the step is older than it."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.as_pointer() in _before_undo and area.spaces.active.image is None:
                area.spaces.active.image = _image()
                bpy.app.timers.register(_Fit(area).step, first_interval=0.05)
    refresh()


HANDLERS = (("undo_pre", _undoing), ("redo_pre", _undoing), ("undo_post", _undone), ("redo_post", _undone))


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
