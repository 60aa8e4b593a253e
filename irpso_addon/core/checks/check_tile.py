"""A picture with the mesh's edges over it, and the highlights that mesh and lamps would make: to be looked at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..data import F32, Bool
from .drawn_view import DrawnView
from .highlights import SeenHighlight
from .registration_fit import blurred
from .shoot_check import U8

WIDTH, HEIGHT = 480, 360  # pixels
MARGIN = 0.08  # of the object's size, around it
CREASE = 0.93  # cosine between neighbours' normals below which there is an edge
STEP = 0.03  # of the distance: neighbours that lie so much farther away are another part
EDGES, CLIPPED, PREDICTED, SEEN = (0.0, 0.9, 1.0), (1.0, 0.1, 0.1), (1.0, 0.85, 0.0), (1.0, 0.2, 0.9)  # colours
RADIUS = 13.0  # pixels, of a circle
BRIGHT = 0.8  # display brightness of the object's brighter parts
Index = NDArray[np.int64]


def tile(drawn: DrawnView, highlight: SeenHighlight | None) -> U8:
    """(HEIGHT, WIDTH, 3): the part of the picture that shows the object; row 0 at the bottom."""
    rows, columns = _grid(drawn.covered)
    picture = _developed(drawn, rows, columns)
    picture[(drawn.covered & ~drawn.image.valid)[np.ix_(rows, columns)]] = CLIPPED
    picture[_edges(drawn, rows, columns)] = EDGES
    for spot in () if highlight is None else highlight.predicted:
        _mark(picture, _distances(drawn, spot, rows, columns), PREDICTED)
    if highlight is not None and highlight.seen is not None:
        x, y = _offsets(drawn, highlight.seen, rows, columns)
        near = (np.abs(x) < 8) & (np.abs(y) < 8)
        _paint(picture, near & (np.abs(np.abs(x) - np.abs(y)) < 1.2), SEEN)
    whole = np.full((HEIGHT, WIDTH, 3), 0.05, np.float32)
    top, left = (HEIGHT - len(rows)) // 2, (WIDTH - len(columns)) // 2
    whole[top:top + len(rows), left:left + len(columns)] = picture
    return np.asarray(np.round(255 * np.clip(whole, 0, 1)), np.uint8)


def _grid(covered: Bool) -> tuple[Index, Index]:
    """Rows and columns of the picture that the tile's rows and columns show."""
    ends = []
    for axis, count in ((1, covered.shape[0]), (0, covered.shape[1])):
        found = np.flatnonzero(covered.any(axis))
        first, last = (int(found[0]), int(found[-1]) + 1) if len(found) else (0, count)
        pad = MARGIN * (last - first) + 2
        ends.append((max(first - pad, 0.0), min(last + pad, float(count))))
    (bottom, top), (left, right) = ends
    scale = min(WIDTH / (right - left), HEIGHT / (top - bottom))
    grids = []
    for (low, high), most, count in ((ends[0], HEIGHT, covered.shape[0]), (ends[1], WIDTH, covered.shape[1])):
        size = max(1, min(most, round((high - low) * scale)))
        at = low + (np.arange(size) + 0.5) * (high - low) / size
        grids.append(np.clip(at.astype(np.int64), 0, count - 1))
    return grids[0], grids[1]


def _developed(drawn: DrawnView, rows: Index, columns: Index) -> F32:
    """The picture for a display: the object's brighter parts light grey."""
    rgb, shown = drawn.image.rgb, drawn.shown
    level = float(np.quantile(drawn.brightness[shown], 0.9)) if shown.any() else float(drawn.brightness.max(initial=0))
    if len(rows) < 0.7 * (rows[-1] - rows[0] + 1):
        rgb = np.stack([blurred(np.ascontiguousarray(rgb[..., k])) for k in range(3)], -1)
    linear = np.maximum(rgb[np.ix_(rows, columns)], 0) * np.float32(BRIGHT**2.2 / max(level, 1e-20))
    return np.asarray(np.minimum(linear, 1) ** np.float32(1 / 2.2), np.float32)


def _edges(drawn: DrawnView, rows: Index, columns: Index) -> Bool:
    """Outline, creases, and where one part of the object hides another."""
    at = np.ix_(rows, columns)
    covered, normal = drawn.covered[at], drawn.normal[at]
    away = np.linalg.norm(drawn.position[at] - drawn.view.camera.position.astype(np.float32), axis=-1)
    edge = np.zeros(covered.shape, bool)
    for axis in (0, 1):
        a, b = (tuple(part if n == axis else slice(None) for n in (0, 1)) for part in (slice(1, None), slice(-1)))
        both = covered[a] & covered[b]
        crease = (normal[a] * normal[b]).sum(-1) < CREASE
        step = np.abs(away[a] - away[b]) > STEP * np.minimum(away[a], away[b])
        edge[a] |= (covered[a] != covered[b]) | (both & (crease | step))
    return edge


def _offsets(drawn: DrawnView, spot: int, rows: Index, columns: Index) -> tuple[F32, F32]:
    """Of the tile's pixels from one of the picture's, in the tile's own."""
    y, x = divmod(spot, drawn.size[0])
    row, column = int(np.argmin(np.abs(rows - y))), int(np.argmin(np.abs(columns - x)))
    across, up = np.meshgrid(np.arange(len(columns)) - column, np.arange(len(rows)) - row)
    return across.astype(np.float32), up.astype(np.float32)


def _distances(drawn: DrawnView, spot: int, rows: Index, columns: Index) -> F32:
    return np.hypot(*_offsets(drawn, spot, rows, columns))


def _mark(picture: F32, distance: F32, colour: tuple[float, float, float]) -> None:
    _paint(picture, np.abs(distance - RADIUS) < 1.1, colour)


def _paint(picture: F32, where: Bool, colour: tuple[float, float, float]) -> None:
    picture[where] = colour
