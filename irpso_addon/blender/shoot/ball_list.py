"""The Shoot panel's list of chrome balls, to records and back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import bpy

from ...core.errors import BadInput
from ...core.shoot.chrome_ball import LEAST_RADIUS, Circle
from .ball_pictures import ChromeBall, FoundBall
from .view_pictures import listed_views, named_view


def read_balls(entries: Iterable[Any]) -> list[ChromeBall]:
    """Raises BadInput for a ball without a camera."""
    return [_read(number, entry) for number, entry in enumerate(entries, 1)]


def _read(number: int, entry: Any) -> ChromeBall:
    if entry.camera is None or entry.camera.type != "CAMERA":
        raise BadInput(f"ball {number}: has no camera; choose the camera whose pictures show it")
    circle = (entry.x, entry.y, entry.circle) if entry.circle > 0 else None
    return ChromeBall(entry.camera, circle, entry.radius / 1000, entry.drawn)


def keep_circles(entries: Iterable[Any], found: Sequence[FoundBall]) -> None:
    """What was found of each, for the panel."""
    for entry, ball in zip(entries, found, strict=True):
        if not ball.as_drawn:
            entry.x, entry.y, entry.circle = ball.circle
        entry.support, entry.residual = (0.0, 0.0) if ball.as_drawn else (ball.ball.support, ball.ball.residual)


def draw_circle(context: bpy.types.Context, index: int, picture: str, circle: Circle) -> None:
    """The circle that the user has drawn in a view's ``picture`` around the ball; its camera is the view's.

    Raises BadInput, and changes nothing then.
    """
    entries = context.scene.irpso.shoot.balls
    shown = named_view(listed_views(context), picture)
    if index >= len(entries):
        raise BadInput(f"ball {index + 1}: is not in the list; add it")
    if not circle[2] >= LEAST_RADIUS:
        raise BadInput(f"ball {index + 1}: the circle's radius is {circle[2]:.0f} pixels, too small for a "
                       f"direction; draw a circle of at least {LEAST_RADIUS:.0f} pixels around a ball")
    entry = entries[index]
    entry.camera, entry.drawn = shown.entry.camera, True
    entry.x, entry.y, entry.circle = circle
    entry.support = entry.residual = 0.0
