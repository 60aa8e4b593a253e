"""What the panels of the IRPSO tab share."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

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


def redraw_sidebars() -> None:
    """Shows the new state in every sidebar that has our tab."""
    for region in _sidebars():
        region.tag_redraw()


def _sidebars() -> Iterator[bpy.types.Region]:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "IMAGE_EDITOR"):
                yield from (region for region in area.regions if region.type == "UI")
