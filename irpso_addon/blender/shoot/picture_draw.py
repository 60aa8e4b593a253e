"""Draws over a view's picture in the Image Editor: the chrome balls' circles, and what the user drags just now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...core.data import F64
from ...core.shoot.picture_marks import circle_line
from ..viewer import plot
from ..viewer.plot import Color, Theme
from .picture_image import shown_picture

DARK: Color = (0.0, 0.0, 0.0, 0.6)  # around lines: they show on any picture
DRAWN: Color = (1.0, 0.85, 0.2, 1.0)
KEPT: Color = (0.35, 0.75, 1.0, 0.9)


@dataclass
class Marks:
    """What an operator that runs draws: lines (n, 2), pixels of the picture from its upper left corner."""

    lines: Sequence[F64] = field(default_factory=list)


marks = Marks()
_handler: object = None


def picture_point(region: bpy.types.Region, x: float, y: float, size: tuple[int, int]) -> tuple[float, float]:
    """Pixel of a picture of ``size`` (width, height), from its upper left corner, below a pixel of the region."""
    across, up = region.view2d.region_to_view(x, y)
    return across * size[0], (1 - up) * size[1]


def redraw() -> None:
    """The Image Editors."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR":
                area.tag_redraw()


def draw() -> None:
    """The draw handler."""
    context = bpy.context
    shown = shown_picture(context.space_data.image)
    if shown is None:
        return
    file, size = shown
    theme, region = Theme.of(context), context.region
    for circle in _circles(context.scene, file):
        _line(region, circle_line(circle), size, KEPT, theme)
    for line in marks.lines:
        _line(region, line, size, DRAWN, theme)


def _circles(scene: bpy.types.Scene, file: str) -> list[tuple[float, float, float]]:
    """Of the balls that the picture's camera shows."""
    settings = scene.irpso
    cameras = {view.camera for view in settings.views if view.camera and bpy.path.abspath(view.image) == file}
    balls = [ball for ball in settings.shoot.balls if ball.circle > 0 and ball.camera in cameras]
    return [(ball.x, ball.y, ball.circle) for ball in balls]


def _line(region: bpy.types.Region, line: F64, size: tuple[int, int], color: Color, theme: Theme) -> None:
    left, bottom = region.view2d.view_to_region(0.0, 0.0, clip=False)
    right, top = region.view2d.view_to_region(1.0, 1.0, clip=False)
    share = line / size
    points = np.stack([left + share[:, 0] * (right - left), top - share[:, 1] * (top - bottom)], -1).tolist()
    plot.line(points, DARK, 3.5 * theme.scale)
    plot.line(points, color, 1.5 * theme.scale)


def register() -> None:
    """Adds the handler."""
    global _handler
    _handler = bpy.types.SpaceImageEditor.draw_handler_add(draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    """Takes it back."""
    bpy.types.SpaceImageEditor.draw_handler_remove(_handler, "WINDOW")
