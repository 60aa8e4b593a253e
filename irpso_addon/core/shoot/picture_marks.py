"""Squares and circles that a user drags in a picture: pixels from its upper left corner."""

from __future__ import annotations

import numpy as np

from ..data import F64
from .chrome_ball import Circle
from .grey_patch import chart_squares

Point = tuple[float, float]
Square = tuple[float, float, float]  # x, y of the middle, side

CLICKED = 1 / 50  # of the picture's longer side: a square where the user has clicked and not dragged
LEAST_CLICKED = 8.0  # pixels
CORNERS = 64  # of a circle as it is drawn


def dragged_square(start: Point, end: Point, size: tuple[int, int]) -> Square:
    """From corner to corner, as wide as the longer way, within a picture of ``size`` (width, height).

    A drag of under 2 pixels is a click: the square is around it.
    """
    across = np.subtract(end, start)
    side = float(np.abs(across).max())
    middle = start + np.where(across < 0, -0.5, 0.5) * side
    if side < 2.0:
        side = max(CLICKED * max(size), LEAST_CLICKED)
        middle = np.array(start, np.float64)
    side = min(side, *map(float, size))
    x, y = np.clip(middle, side / 2, np.array(size) - side / 2)
    return float(x), float(y), side


def dragged_circle(start: Point, end: Point) -> Circle:
    """From the middle to the rim."""
    return start[0], start[1], float(np.hypot(end[0] - start[0], end[1] - start[1]))


def square_line(square: Square) -> F64:
    """Corners (5, 2); the first is the last."""
    x, y, side = square
    return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * (side / 2) + (x, y)


def circle_line(circle: Circle) -> F64:
    """Points (CORNERS + 1, 2); the first is the last."""
    turns = np.linspace(0, 2 * np.pi, CORNERS + 1)
    return np.stack([np.cos(turns), np.sin(turns)], -1) * circle[2] + circle[:2]


def chart_lines(white: Point, black: Point) -> list[F64]:
    """The line between the two patches, and the squares on the six greys, where there is room for them."""
    ends = np.array([white, black], np.float64)
    if np.hypot(*(ends[1] - ends[0])) < 30.0:
        return [ends]
    return [ends, *(square_line((x, y, side)) for x, y, side in chart_squares(white, black).tolist())]
