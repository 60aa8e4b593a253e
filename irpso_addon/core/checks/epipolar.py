"""How far two pictures of one place disagree: the distance of what both show from the other camera's epipolar line.

The line is where a ray through one camera's pixel appears in the other picture.  It does not depend on the mesh, which
only says where on the line to look, how a small patch is seen from there, and whether it is hidden.  A patch is found
again by normalised cross-correlation (Lewis, "Fast Normalized Cross-Correlation", Vision Interface 1995); patches are
taken where both eigenvalues of the gradients' covariance are large (Shi and Tomasi, CVPR 1994).  For lines in two views
see Hartley and Zisserman, "Multiple View Geometry", chapter 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..data import F32, F64, Bool, View
from ..projection import pixels_of
from .drawn_view import DrawnView
from .registration_fit import blurred
from .shoot_check import PairFigures

PAIRS = 5  # of views that are compared
ANGLES = 3.0, 35.0  # degrees between two cameras' directions, seen from the object: less is no pair, more looks unlike
OVERLAP = 0.5  # share of the places in a view's picture that the other picture must have
OCTAVE = 20.0  # degrees that a view counts farther away where it shows things twice or half as large
OTHER_LIGHT = 15.0  # degrees that a view under other lights counts farther away
PATCH, REACH = 6, 9  # pixels to each side: of a patch; how far beside the mesh's prediction it is looked for
CELL = 11  # pixels: one patch in each square of so many
MOST = 200  # patches of a pair
BETWEEN = 3  # pixels to each side over which a surface's slope is taken
ALIKE = 0.8  # correlation from which on a patch counts as found ...
DISTINCT = 0.1  # ... if the second best place is so much worse
LEAST = 25  # patches found, for the pair to count
NOISE = 0.5  # median pixels that the distances may scatter about a smooth change over the picture, or half their size
FARTHER = 0.02  # of the distance: the second point of a line
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Side:
    """What is kept of a drawn view to be compared with another; row 0 at the bottom."""

    view: View
    grey: F32  # (h, w) brightness, 0..1, evened out
    position: F32  # (h, w, 3) world
    usable: Bool  # (h, w) shows the object, and is not clipped
    reduction: float  # pixels of the file along a side of one of these

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        height, width = self.usable.shape
        return width, height


def side_of(drawn: DrawnView) -> Side:
    """Of a drawn view."""
    bright = np.maximum(drawn.brightness, np.float32(0))
    level = max(float(np.median(bright[drawn.shown])), 1e-20) if drawn.shown.any() else 1.0
    grey = np.asarray(bright / (bright + np.float32(level)), np.float32)
    return Side(drawn.view, grey, drawn.position, drawn.shown & drawn.image.valid,
                drawn.reduction)


def neighbours(views: Sequence[View], chosen: Sequence[View], places: F64, on_camera: bool) -> list[tuple[View, View]]:
    """Pairs of views: one of ``chosen``, and of all the one whose camera is the nearest but not the same.

    ``places`` (N, 3) on the object: a pair shows the same of them, about as large.  Lights should be the same, unless
    they go with the camera.
    """
    shown = np.array([_shown(view, places) for view in views])
    eyes = np.array([view.camera.position for view in views])
    flat = np.array([view.camera.orthographic for view in views])
    number = {id(view): n for n, view in enumerate(views)}
    pairs: list[tuple[View, View]] = []
    for view in chosen:
        own = shown[number[id(view)]]
        if view.camera.orthographic or not own.any():
            continue
        cost = _angles(eyes, view.camera.position, places[own].mean(0))
        cost[~((cost >= ANGLES[0]) & (cost <= ANGLES[1])) | flat | (shown[:, own].mean(1) < OVERLAP)] = np.inf
        sizes = np.array([_size(other, places[own]) if np.isfinite(each) else 1.0
                          for other, each in zip(views, cost, strict=True)])
        names = {light.name for light in view.lights}
        unlike = np.array([not on_camera and {light.name for light in other.lights} != names for other in views])
        cost += OTHER_LIGHT * unlike + OCTAVE * np.abs(np.log2(sizes / _size(view, places[own])))
        other = views[int(np.argmin(cost))]
        if np.isfinite(cost.min()) and not any({a.image, b.image} == {view.image, other.image} for a, b in pairs):
            pairs.append((view, other))
    taken = np.unique(np.linspace(0, len(pairs) - 1, min(PAIRS, len(pairs))).round().astype(int))
    return [pairs[n] for n in taken]


def _shown(view: View, places: F64) -> Bool:
    """(N,) which places lie in the picture, hidden or not."""
    at = pixels_of(view.camera, places, (1, 1))  # NaN is not inside
    return np.asarray(((at >= 0) & (at <= 1)).all(-1))


def _angles(eyes: F64, own: F64, middle: F64) -> F64:
    """(V,) degrees between the directions in which cameras at ``eyes`` and at ``own`` lie from a place."""
    towards, straight = eyes - middle, own - middle
    return np.asarray(np.degrees(np.arctan2(np.linalg.norm(np.cross(towards, straight), axis=1), towards @ straight)))


def _size(view: View, places: F64) -> float:
    """Of the places in the picture, in its heights: the median distance from their middle one, along both axes."""
    at = pixels_of(view.camera, places, (1, 1)) * (view.camera.aspect, 1.0)
    at = at[np.isfinite(at).all(-1)]
    return max(float(np.median(np.abs(at - np.median(at, 0)))), 1e-9) if len(at) else 1e-9


def compared(one: Side, other: Side) -> PairFigures:
    """By how many pixels of ``other``'s file its picture lies beside the lines, in the median; NaN: not measured."""
    at, distance = epipolar_distances(one, other)
    figures = PairFigures(one.view.image.name, other.view.image.name, len(at), float("nan"), other.reduction)
    if len(at) < LEAST:
        return figures
    length = float(np.median(np.abs(distance)))
    if _scatter(at, distance) > max(NOISE, length / 2):
        return figures
    return PairFigures(figures.one, figures.other, len(at), length * other.reduction, other.reduction)


def epipolar_distances(one: Side, other: Side) -> tuple[F64, F64]:
    """(N, 2) where ``other`` shows patches of ``one``, and their signed distances (N,) from the epipolar lines."""
    none = np.zeros((0, 2)), np.zeros(0)
    rows, columns = _corners(one)
    rows, columns, predicted, slope = _seen(one, other, rows, columns)
    if not len(rows):
        return none
    offset, found = _found(one, other, rows, columns, predicted, slope)
    place = one.position[rows, columns].astype(np.float64)
    eye = one.view.camera.position
    along = _at(other, eye + (place - eye) * (1 + FARTHER)) - predicted
    length = np.linalg.norm(along, axis=1)
    found &= length > 0.1
    moved = np.einsum("nij,nj->ni", slope, offset)
    with np.errstate(all="ignore"):
        distance = (along[:, 0] * moved[:, 1] - along[:, 1] * moved[:, 0]) / length
    return (predicted + moved)[found], distance[found]


def _scatter(at: F64, distance: F64) -> float:
    """Median distance from a plane over the picture, robustly: a camera that is off moves neighbours alike."""
    spread = at.std(0) + 1e-9
    basis = np.concatenate([np.ones((len(at), 1)), (at - at.mean(0)) / spread], 1)
    weight = np.ones(len(at))
    left = distance
    for _ in range(10):
        fit = np.linalg.lstsq(basis * weight[:, None], distance * weight, rcond=None)[0]
        left = np.abs(distance - basis @ fit)
        weight = 1 / np.sqrt(np.maximum(left, 0.05))
    return float(np.median(left))


def _at(side: Side, places: F64) -> F64:
    """(N, 2) as array indices x, y, which count from the first pixel's centre."""
    return pixels_of(side.view.camera, places, side.size) - 0.5


def _corners(side: Side) -> tuple[Index, Index]:
    """Rows and columns of the best patches, all inside the object."""
    height, width = (n // CELL * CELL for n in side.grey.shape)
    if not height or not width:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    up, right = np.gradient(blurred(side.grey))
    a, b, c = (_box(np.asarray(product)) for product in (right * right, right * up, up * up))
    least = (a + c) / 2 - np.hypot((a - c) / 2, b)
    least[_box(side.usable.astype(np.float32)) < (2 * PATCH + 1) ** 2 - 0.5] = 0
    split = least[:height, :width].reshape(height // CELL, CELL, width // CELL, CELL)
    cells = split.swapaxes(1, 2).reshape(height // CELL, width // CELL, CELL * CELL)
    best, score = cells.argmax(2), cells.max(2)
    order = np.argsort(-score, axis=None)[:MOST]
    order = order[score.ravel()[order] > 0]
    down, across = np.unravel_index(order, score.shape)
    inside = best[down, across]
    return down * CELL + inside // CELL, across * CELL + inside % CELL


def _box(values: F32 | F64) -> F64:
    """(h, w) sums over the patch around each pixel; 0 where that is not inside."""
    n = 2 * PATCH + 1
    out = np.zeros(values.shape)
    if min(values.shape) < n:
        return out
    total = np.pad(np.cumsum(np.cumsum(values, 0, np.float64), 1), ((1, 0), (1, 0)))
    out[PATCH:-PATCH, PATCH:-PATCH] = total[n:, n:] - total[:-n, n:] - total[n:, :-n] + total[:-n, :-n]
    return out


def _seen(one: Side, other: Side, rows: Index, columns: Index) -> tuple[Index, Index, F64, F64]:
    """Patches that the other camera sees too: where (N, 2), and (N, 2, 2) its pixels over one's."""
    def place(up: int, right: int) -> F64:
        return one.position[rows + up, columns + right].astype(np.float64)

    here = place(0, 0)
    right, left, above, below = place(0, BETWEEN), place(0, -BETWEEN), place(BETWEEN, 0), place(-BETWEEN, 0)
    predicted = _at(other, here)
    slope = np.stack([_at(other, right) - _at(other, left), _at(other, above) - _at(other, below)], -1) / (2 * BETWEEN)
    width = np.linalg.norm(right - left, axis=1) + np.linalg.norm(above - below, axis=1)
    bend = np.linalg.norm(right + left - 2 * here, axis=1) + np.linalg.norm(above + below - 2 * here, axis=1)
    good = np.isfinite(predicted).all(1) & np.isfinite(slope).all((1, 2)) & (bend < 0.3 * width)
    nearest = np.where(good[:, None], predicted, 0).round().astype(np.int64)
    size = np.array(other.size)
    good &= (nearest >= PATCH).all(1) & (nearest < size - PATCH).all(1)
    nearest = np.clip(nearest, 0, size - 1)
    behind = np.linalg.norm(other.position[nearest[:, 1], nearest[:, 0]] - here, axis=1)
    good &= other.usable[nearest[:, 1], nearest[:, 0]] & (behind < 2 * width)
    scale = np.abs(np.linalg.det(np.where(good[:, None, None], slope, np.eye(2))))
    good &= (scale > 0.3) & (scale < 3)
    return rows[good], columns[good], predicted[good], slope[good]


def _found(
    one: Side, other: Side, rows: Index, columns: Index, predicted: F64, slope: F64,
) -> tuple[F64, Bool]:
    """(N, 2) by how many pixels of ``one``, right and up, patches lie beside the prediction, and which are found."""
    n = np.arange(-PATCH, PATCH + 1)
    patch = _normed(one.grey[rows[:, None, None] + n[:, None], columns[:, None, None] + n])
    wide = np.arange(-PATCH - REACH, PATCH + REACH + 1)
    x, y = np.meshgrid(wide, wide)
    at = predicted[:, None, None] + np.einsum("nij,hwj->nhwi", slope, np.stack([x, y], -1).astype(np.float64))
    windows = sliding_window_view(_sampled(other.grey, at), (len(n), len(n)), axis=(1, 2))
    ones = np.ones(patch.shape[1:])
    total = np.einsum("nuvij,ij->nuv", windows, ones, optimize=True)
    squares = np.einsum("nuvij,nuvij->nuv", windows, windows)
    power = np.sqrt(np.maximum(squares - total**2 / ones.size, 1e-12))
    alike = np.einsum("nuvij,nij->nuv", windows, patch) / power
    count, side = len(rows), 2 * REACH + 1
    best = alike.reshape(count, -1).argmax(1)
    v, u = best // side, best % side
    value = alike.reshape(count, -1).max(1)
    apart = [np.abs(np.arange(side) - best_at[:, None]) for best_at in (v, u)]
    far = np.maximum(apart[0][:, :, None], apart[1][:, None]) > 3
    second = np.where(far, alike, -1).reshape(count, -1).max(1)
    inside = (np.minimum(u, v) > 0) & (np.maximum(u, v) < side - 1)
    u, v = np.clip(u, 1, side - 2), np.clip(v, 1, side - 2)
    all_of = np.arange(count)
    offset = np.stack([
        u - REACH + _summit(alike[all_of, v, u - 1], alike[all_of, v, u], alike[all_of, v, u + 1]),
        v - REACH + _summit(alike[all_of, v - 1, u], alike[all_of, v, u], alike[all_of, v + 1, u])], -1)
    return offset, inside & (value > ALIKE) & (value - second > DISTINCT)


def _normed(patches: F32) -> F64:
    """(N, n, n) without their means, of length 1."""
    values = patches - patches.mean((1, 2), keepdims=True, dtype=np.float64)
    return np.asarray(values / np.sqrt(np.maximum((values**2).sum((1, 2), keepdims=True), 1e-12)))


def _sampled(image: F32, at: F64) -> F64:
    """(...) of (h, w) at indices x, y (..., 2), bilinearly; beyond its edges they are repeated."""
    most = np.array(image.shape[::-1]) - 1
    at = np.clip(at, 0, most)
    low = np.minimum(at.astype(np.int64), most - 1)
    x, y = np.moveaxis(low, -1, 0)
    fx, fy = np.moveaxis(at - low, -1, 0)
    return np.asarray((image[y, x] * (1 - fx) + image[y, x + 1] * fx) * (1 - fy)
                      + (image[y + 1, x] * (1 - fx) + image[y + 1, x + 1] * fx) * fy)


def _summit(before: F64, here: F64, after: F64) -> F64:
    """Where the parabola through three values has its top."""
    bend = 2 * here - before - after
    return np.asarray(np.clip(np.where(bend > 0, (after - before) / np.maximum(2 * bend, 1e-12), 0), -0.5, 0.5))
