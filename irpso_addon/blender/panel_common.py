"""What the panels of the IRPSO tab share."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager

import bpy

LETTER_WIDTH = 6.2  # pixels of the panel's font, on average


class Tab:
    """Mix-in: a panel of the IRPSO tab in the 3D viewport's sidebar."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "IRPSO"


def split(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """The layout as Blender's own panels are: names left, values right, no dots for keyframes."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


def letters(context: bpy.types.Context) -> int:
    """How many letters fit into a line of the region beside an icon."""
    return max(16, int(context.region.width / context.preferences.system.ui_scale / LETTER_WIDTH) - 9)


def wrapped(layout: bpy.types.UILayout, text: str, width: int, icon: str = "ERROR") -> None:
    """A label does not wrap: one for each line."""
    for row, line in enumerate(textwrap.wrap(text, width)):
        layout.label(text=line, icon="BLANK1" if row else icon)


_closing: list[bool] = []  # while Blender closes windows, nothing of them may be touched


@contextmanager
def closing() -> Iterator[None]:
    """Nothing is drawn anew inside: Blender takes an operator away, perhaps with its window."""
    _closing.append(True)
    try:
        yield
    finally:
        _closing.pop()


def is_closing() -> bool:
    """Whether the windows must be left alone."""
    return bool(_closing)


def clear_status() -> None:
    """The status bar is Blender's own again, in every workspace: the user may have changed to another meanwhile."""
    windows = bpy.context.window_manager.windows
    if not windows:
        return
    window = bpy.context.window or windows[0]  # without one Blender crashes
    for workspace in bpy.data.workspaces:
        with bpy.context.temp_override(window=window, workspace=workspace):
            workspace.status_text_set(None)


def clear_status_soon() -> None:
    """`clear_status` and `redraw_sidebars`, once Blender has closed what it is closing."""
    def call() -> None:
        clear_status()
        redraw_sidebars()

    bpy.app.timers.register(call, first_interval=0.0, persistent=True)


def redraw_sidebars() -> None:
    """Shows the new state in every sidebar that has our tab."""
    if is_closing():
        return
    for region in _sidebars():
        region.tag_redraw()


def _sidebars() -> Iterator[bpy.types.Region]:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "IMAGE_EDITOR"):
                yield from (region for region in area.regions if region.type == "UI")
