"""The sample scene: made by a second Blender the first time, kept in the user's folder, opened, laid out."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import gpu
from bpy.app.handlers import persistent
from mathutils import Euler, Vector

from ...core.errors import BadInput
from ...core.job import Progress
from ...core.phrases import percent
from ...core.versions import versions
from ..jobs.session import session
from ..panel_common import letters, redraw_sidebars, wrapped
from ..preferences import EXTENSION
from ..second_blender import Child, command
from ..viewer import editors
from .sample_child import SCENE

POLL, REDRAW = 0.3, 0.05  # seconds
PATIENCE = 40  # redraws until the sidebar must be there
LOOK = Euler((math.radians(78), 0.0, math.radians(20))).to_quaternion()  # past the cameras, a little from above
DISTANCE = 4.2  # metres
SENSOR = 72.0  # mm: width of the viewport's own camera
LEFT = 0.55  # share of the viewport that stays one, the Image Editor gets the rest

class Making:
    """The scene being made."""

    def __init__(self, target: Path) -> None:
        self.target = target
        self.folder = tempfile.TemporaryDirectory(prefix="irpso-sample-")
        folder = Path(self.folder.name)
        (folder / "target").write_text(str(target), encoding="utf-8")
        self.child = Child(command(), "blender.sample.sample_child", folder)

    def poll(self) -> Progress:
        """How far it is."""
        return self.child.progress() or Progress(0.0, "starting")

    def done(self) -> bool:
        """Whether the scene is there.  Raises BadInput when it cannot be made."""
        if self.child.status is None:
            return False
        if not (self.target / SCENE).exists():
            raise BadInput(f"sample scene: cannot be made ({self.child.last_line()})")
        return True

    def end(self) -> None:
        """Ends it, leaves nothing behind."""
        self.child.end()
        self.folder.cleanup()


@dataclass
class State:
    """What is known of it now; there is one, `state`."""

    making: Making | None = None
    error: str = ""  # why it could not be made


state = State()


def path() -> Path:
    """Where the scene of this IRPSO and this Blender is kept."""
    if EXTENSION.startswith("bl_ext."):
        folder = Path(bpy.utils.extension_path_user(EXTENSION, create=True))
    else:
        folder = Path(bpy.utils.user_resource("DATAFILES", path="irpso", create=True))
    return folder / f"sample-{versions()['irpso']}-blender-{bpy.app.version[0]}.{bpy.app.version[1]}" / SCENE


def start() -> None:
    """Opens the scene; if it is not there yet, makes it first while the window lives on."""
    state.error = ""
    if path().exists():
        _open()
        return
    state.making = Making(path().parent)
    if bpy.app.background:
        while _watch() is not None:
            time.sleep(POLL)
        return
    bpy.app.timers.register(_watch, first_interval=POLL, persistent=True)


def stop() -> None:
    """Ends the making."""
    for timer in (_watch, _lay_out):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    if state.making is not None:
        state.making.end()
    state.making = None


def register() -> None:
    """The handler and the entry in File > New."""
    bpy.app.handlers.load_post.append(on_load)
    bpy.types.TOPBAR_MT_file_new.append(draw_menu)


def unregister() -> None:
    """Takes both back and ends the making."""
    stop()
    bpy.types.TOPBAR_MT_file_new.remove(draw_menu)
    bpy.app.handlers.load_post.remove(on_load)


def draw(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The button, or how far the making is."""
    if state.making is not None:
        progress, row = state.making.poll(), layout.row(align=True)
        row.progress(factor=progress.fraction, text=f"Making the Sample Scene: {percent(progress.fraction)}")
        row.operator("irpso.stop_sample", text="", icon="X")
    else:
        layout.operator("irpso.sample_scene", icon="SCENE_DATA")
    if state.error:
        wrapped(layout, state.error, letters(context))


def draw_menu(self: Any, _context: bpy.types.Context) -> None:
    """The entry of the menu File > New."""
    self.layout.separator()
    self.layout.operator("irpso.sample_scene", text="IRPSO Sample", icon="SCENE_DATA")


def _watch() -> float | None:
    """While it is made: shows how far; then opens it."""
    assert state.making is not None
    redraw_sidebars()
    try:
        if not state.making.done():
            return POLL
    except BadInput as error:
        state.error = str(error)
    stop()
    if not state.error and session.running is None:  # else it is opened by the next press
        _open()
    return None


def _open() -> None:
    """As File > Open does, which asks about unsaved changes; the window's areas stay."""
    if bpy.app.background:
        bpy.ops.wm.open_mainfile(filepath=str(path()), load_ui=False)
        return
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        bpy.ops.wm.open_mainfile("INVOKE_DEFAULT", filepath=str(path()), load_ui=False, display_file_selector=False)


@persistent
def on_load(*_: object) -> None:
    """load_post handler: lays the window out for the sample scene; another file ends the making of it."""
    stop()
    if not bpy.app.background and bpy.data.filepath and Path(bpy.data.filepath) == path():
        _todo[:] = [_split, _add_image_editor, _frame, *[_open_tab] * PATIENCE]
        bpy.app.timers.register(_lay_out, first_interval=0.0)


_todo: list[Callable[[bpy.types.Window, bpy.types.Area], bool]] = []  # a redraw after another; True: that was the last


def _lay_out() -> float | None:
    """The vase in a viewport with our tab open, an Image Editor beside it."""
    window = bpy.context.window_manager.windows[0]
    area = max((a for a in window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width * a.height, default=None)
    if area is None or _todo.pop(0)(window, area) or not _todo:
        return None
    area.tag_redraw()
    return REDRAW


def _split(window: bpy.types.Window, area: bpy.types.Area) -> bool:
    """Makes room to the right of the viewport, unless there is an Image Editor."""
    if any(a.type == "IMAGE_EDITOR" for a in window.screen.areas):
        del _todo[0]
    else:
        with bpy.context.temp_override(window=window, area=area):
            bpy.ops.screen.area_split(direction="VERTICAL", factor=LEFT)
    return False


def _add_image_editor(window: bpy.types.Window, _area: bpy.types.Area) -> bool:
    """The right one of the two viewports; only now do they know where they are."""
    right = max((a for a in window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.x)
    right.type = "IMAGE_EDITOR"
    editors.show_in(right)
    return False


def _frame(_window: bpy.types.Window, area: bpy.types.Area) -> bool:
    """The vase beside the sidebar, with its maps on as soon as it has some."""
    space: Any = area.spaces.active
    space.show_region_ui = True
    software = gpu.platform.device_type_get() == "SOFTWARE"  # there Material Preview takes seconds to start
    space.shading.type, space.shading.color_type = "SOLID" if software else "MATERIAL", "TEXTURE"
    view = space.region_3d
    view.view_perspective, view.view_rotation = "PERSP", LOOK
    view.view_location, view.view_distance = (0.0, 0.0, 0.0), DISTANCE
    return False


def _open_tab(_window: bpy.types.Window, area: bpy.types.Area) -> bool:
    """Once the sidebar has been drawn."""
    sidebar = _region(area, "UI")
    if sidebar.width <= 1 or sidebar.active_panel_category == "UNSUPPORTED":
        return False
    sidebar.active_panel_category = "IRPSO"
    if bpy.context.preferences.system.use_region_overlap:
        _move_clear(area, sidebar.width - _region(area, "TOOLS").width)
    return True


def _move_clear(area: bpy.types.Area, pixels: int) -> None:
    """The vase is in the middle of what the sidebar, so much wider than the toolbar, leaves of the viewport."""
    space: Any = area.spaces.active
    region = _region(area, "WINDOW")
    metres = DISTANCE * SENSOR / space.lens / max(region.width, region.height)  # in a pixel
    space.region_3d.view_location = LOOK @ Vector((pixels / 2 * metres, 0.0, 0.0))


def _region(area: bpy.types.Area, kind: str) -> bpy.types.Region:
    return next(region for region in area.regions if region.type == kind)
