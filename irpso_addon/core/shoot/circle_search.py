"""Circles in a picture, by votes of its edges for centres (Ballard 1981, the generalised Hough transform)."""

from __future__ import annotations

import numpy as np

from ..data import F64

SIZE = 160  # pixels of the reduced picture's longer side
EDGE_SHARE = 0.12  # of the pixels that vote
LEAST, STEP = 5.0, 1.5  # pixels of the reduced picture: least radius that is tried, and from one to the next
FOUND = 6  # circles


def find_circles(bright: F64) -> list[tuple[float, float, float]]:
    """The likeliest circles (x, y, radius, in pixels from the upper left) of ``bright`` (h, w), likeliest first."""
    factor = max(1, -(-max(bright.shape) // SIZE))
    small = _reduced(bright, factor)
    height, width = small.shape
    if min(height, width) < 16:
        return []
    rows, columns, along_x, along_y = _edges(small)
    found = []
    for radius in np.arange(LEAST, 0.55 * min(height, width), STEP):
        votes = np.zeros((height, width))
        for sign in (-1, 1):  # the ball may be darker or brighter than what is behind it
            y = np.rint(rows + sign * radius * along_y).astype(int)
            x = np.rint(columns + sign * radius * along_x).astype(int)
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            votes += np.bincount(y[inside] * width + x[inside], minlength=height * width).reshape(height, width)
        # Votes by chance go with the circumference, and their scatter with its root.
        spread = box(votes) / np.sqrt(radius)
        for at in np.argsort(spread, axis=None)[-3:]:
            found.append((float(spread.flat[at]), at % width + 0.5, at // width + 0.5, float(radius)))
    return [(x * factor, y * factor, radius * factor) for x, y, radius in _apart(sorted(found, reverse=True))]


def _apart(found: list[tuple[float, float, float, float]]) -> list[tuple[float, float, float]]:
    """The best FOUND of them, without those that lie close to a better one."""
    chosen: list[tuple[float, float, float]] = []
    for _, x, y, radius in found:
        if all(np.hypot(x - u, y - v) > 0.2 * r or not 0.87 < radius / r < 1.15 for u, v, r in chosen):
            chosen.append((x, y, radius))
    return chosen[:FOUND]


def _reduced(bright: F64, factor: int) -> F64:
    """Cube roots of the means of squares of ``factor`` pixels: highlights would drown every other edge."""
    height, width = (n // factor * factor for n in bright.shape)
    squares = bright[:height, :width].reshape(height // factor, factor, width // factor, factor)
    means = squares.mean((1, 3))
    return np.asarray(np.cbrt(np.minimum(means, np.quantile(means, 0.8))))


def _edges(small: F64) -> tuple[F64, F64, F64, F64]:
    """Rows, columns and unit gradients (x, y) of the steepest pixels."""
    down, right = np.gradient(box(small))
    steepness = np.hypot(down, right)
    rows, columns = np.nonzero(steepness > max(np.quantile(steepness, 1 - EDGE_SHARE), 1e-12))
    length = steepness[rows, columns]
    return rows, columns, right[rows, columns] / length, down[rows, columns] / length


def box(values: F64) -> F64:
    """Means of 3 x 3; at the border the outermost values count again."""
    rows = np.pad(values, 1, mode="edge")
    rows = rows[:-2] + rows[1:-1] + rows[2:]
    return np.asarray((rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 9)
