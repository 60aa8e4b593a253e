"""Mix-in of operators to which the user shows something in a view's picture, by the mouse, in an Image Editor."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar

import bpy

from ...irpso_addon.blender.shoot.picture_draw import marks, picture_point, redraw
from ...irpso_addon.blender.shoot.picture_image import picture_image, shown_picture
from ...irpso_addon.blender.shoot.view_pictures import ListedView
from ...irpso_addon.blender.viewer import editors
from ...irpso_addon.core.data import F64
from ...irpso_addon.core.errors import BadInput
from ...irpso_addon.core.shoot.picture_marks import Point

REACH = 5  # pixels of the screen: a shorter drag is a click


class ClickInPicture:
    """Give `pictures`, `lines`, `keep` and ``execute``, which does the work by the operator's own properties.

    One drag is shown by its two ends.  With ``two_clicks`` the ends may also be clicked one after the other.
    The zoom and the pan of the Image Editor go on working.
    """

    prompt = ""  # what to do, in the header
    two_clicks = False
    _begun: ClassVar[list[int]] = [0]  # how many the user has begun: an earlier one ends

    _number = 0  # of them
    _area = 0  # by its pointer
    _size: tuple[int, int] = (1, 1)  # of the picture
    _start: Point | None = None
    _clicked = False  # the start, and not dragged
    _pressed: tuple[int, int] | None = None  # where the button went down, in the window

    def pictures(self, context: bpy.types.Context) -> tuple[ListedView, Sequence[ListedView]]:
        """The view whose picture is shown, and others that are blended into it.  Raises BadInput."""
        raise NotImplementedError

    def lines(self, start: Point, end: Point, size: tuple[int, int]) -> list[F64]:
        """What is drawn as the mouse goes from ``start`` to ``end``: (n, 2) each, pixels from the upper left corner."""
        raise NotImplementedError

    def keep(self, start: Point, end: Point, size: tuple[int, int]) -> None:
        """Into the operator's properties."""
        raise NotImplementedError

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Shows the picture, and waits for the mouse."""
        if bpy.app.background:
            return self.execute(context)
        try:
            image = picture_image(*self.pictures(context))
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._size = shown_picture(image)[1]
        window, area = editors.show_picture(image, context)
        bpy.ops.ed.undo_push(message="Show Picture")  # so that an undo of what follows leaves the picture
        self._area = area.as_pointer()
        self._begun[0] += 1
        self._number = self._begun[0]
        area.header_text_set(f"{self.prompt}   Esc: cancel")
        if context.workspace is not None:
            context.workspace.status_text_set(f"{self.bl_label}: {self.prompt}   Esc: cancel")
        with context.temp_override(window=window, area=area, region=editors.canvas(area)):
            context.window.cursor_modal_set("CROSSHAIR")
            context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """One event."""
        area = self._shown()
        if area is None or self._number != self._begun[0]:
            self._leave()
            return {"CANCELLED"}
        if event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS":
            self._leave()
            return {"CANCELLED"}
        here = picture_point(editors.canvas(area), *_place(event, editors.canvas(area)), self._size)
        if event.type == "MOUSEMOVE" and self._start is not None:
            self._draw(here)
            return {"RUNNING_MODAL"} if self._pressed is not None else {"PASS_THROUGH"}
        if event.type != "LEFTMOUSE" or (self._pressed is None and not _over(event, area)):
            return {"PASS_THROUGH"}
        if event.value == "PRESS":
            self._pressed = event.mouse_x, event.mouse_y
            self._start = self._start or here
            self._draw(here)
        elif event.value == "RELEASE" and self._pressed is not None:
            x, y = self._pressed
            self._pressed = None
            short = max(abs(event.mouse_x - x), abs(event.mouse_y - y)) <= REACH
            if not self.two_clicks or self._clicked or not short:
                return self._done(context, here)
            self._clicked = True  # the other end comes by a click of its own
        return {"RUNNING_MODAL"}

    def cancel(self, _context: bpy.types.Context) -> None:
        """Blender takes the operator away: a file is loaded or the window closed, which bears no calls just now."""
        if self._number == self._begun[0]:
            bpy.app.timers.register(partial(_take_back, self._area), persistent=True)

    def _done(self, context: bpy.types.Context, end: Point) -> set[str]:
        start = self._start
        assert start is not None
        self._leave()
        self.keep(start, end, self._size)
        return self.execute(context)

    def _draw(self, end: Point) -> None:
        assert self._start is not None
        marks.lines = self.lines(self._start, end, self._size)
        redraw()

    def _shown(self) -> bpy.types.Area | None:
        """The editor, as long as it shows the picture."""
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.as_pointer() == self._area and area.type == "IMAGE_EDITOR":
                    return area if shown_picture(area.spaces.active.image) is not None else None
        return None

    def _leave(self) -> None:
        """Unless a later one runs."""
        if self._number == self._begun[0]:
            _take_back(self._area)


def _take_back(editor: int) -> None:
    """What shows that an operator runs, in the editor of that pointer and elsewhere."""
    marks.lines = []
    for window in bpy.context.window_manager.windows:
        window.cursor_modal_restore()
        for area in window.screen.areas:
            if area.as_pointer() == editor:
                area.header_text_set(None)
        with bpy.context.temp_override(window=window):
            window.workspace.status_text_set(None)
    redraw()


def _place(event: Any, region: bpy.types.Region) -> tuple[int, int]:
    """The mouse in the region."""
    return event.mouse_x - region.x, event.mouse_y - region.y


def _over(event: Any, area: bpy.types.Area) -> bool:
    """Whether the mouse is over the editor's picture, and not over its header or sidebar, which may cover it."""
    def inside(region: bpy.types.Region) -> bool:
        x, y = _place(event, region)
        return region.width > 1 and 0 <= x < region.width and 0 <= y < region.height

    return inside(editors.canvas(area)) and not any(
        inside(region) for region in area.regions if region.type not in ("WINDOW", "HUD", "XR"))
