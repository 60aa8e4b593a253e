"""Charts of a scan's UV map: parts that a projection along one axis shows without folds.

A scan's faces are small and rough, so that neighbours' normals differ by tens of degrees.  What groups faces by their
own normals, such as Blender's Smart UV Project, cuts such a mesh into as many islands as it has bumps, and the margins
around them leave nothing of the texture.  Here normals are smoothed over many faces first, and small parts join their
neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..data import F64, Bool

ROUNDS = 20  # of smoothing: normals are means over some sixty faces
CLEANED = 10  # rounds in which a face takes the axis of most of its neighbours
LEAST = 0.002  # of the surface: smaller charts join a neighbour ...
ANGLE = 0.26  # ... whose axis is at most as far from theirs: cosine of 75 degrees
CELL = 3.0  # of a face's width: of the grid on which folds are looked for; ...
FOLD = 3.0  # ... surfaces that lie so many cells apart in one are two
FOLDED = 0.002  # of a chart's faces, from which on it is divided
DIVIDED = 4  # times, at most
TURN = 5.0  # degrees between the turns of a chart that are tried
AXES = np.concatenate([np.eye(3), -np.eye(3)])
I64 = NDArray[np.int64]


@dataclass(frozen=True)
class Faces:
    """A mesh's faces."""

    centers: F64  # (F, 3)
    normals: F64  # (F, 3) unit
    areas: F64  # (F,)
    pairs: I64  # (P, 2) that share an edge


@dataclass(frozen=True)
class Charts:
    """Which face is on which chart, and how charts are projected."""

    of_face: I64  # (F,)
    frames: F64  # (n, 2, 3) unit directions of the plane, counter-clockwise as seen from outside

    def places(self, faces: I64, points: F64) -> F64:
        """(N, 2) of points (N, 3) on the faces (N,), in the mesh's own units; no two charts touch."""
        chart = self.of_face[faces]
        at = np.einsum("njk,nk->nj", self.frames[chart], points)
        low = np.stack([_extreme(np.minimum, chart, at[:, k], len(self.frames)) for k in range(2)], axis=1)
        high = np.stack([_extreme(np.maximum, chart, at[:, k], len(self.frames)) for k in range(2)], axis=1)
        step, columns = 1.1 * float((high - low).max()), int(np.ceil(np.sqrt(len(low))))
        return np.asarray(at - low[chart] + step * np.stack([chart % columns, chart // columns], axis=1))


def charts_of(faces: Faces) -> Charts:
    """Few charts that together show all faces."""
    smooth = _smoothed(faces)
    side = _cleaned(np.asarray((smooth @ AXES.T).argmax(axis=1), np.int64), faces.pairs)
    chart = _merged(faces, smooth, _parts(side, faces.pairs))
    for _ in range(DIVIDED):
        divided = _unfolded(faces, chart, _axes(faces, smooth, chart))
        if divided is None:
            break
        chart = divided
    return Charts(chart, _upright(faces, chart, _planes(_axes(faces, smooth, chart))))


def _planes(axis: F64) -> F64:
    """(n, 2, 3) two unit directions across each of (n, 3) axes."""
    other = np.eye(3)[np.abs(axis).argmin(axis=1)]
    right = np.cross(other, axis)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(axis, right)], axis=1)


def _upright(faces: Faces, chart: I64, frames: F64) -> F64:
    """The frames turned so that a chart's box is smallest: boxes are what is packed."""
    x, y = np.einsum("fjk,fk->jf", frames[chart], faces.centers)
    best, chosen = np.full(len(frames), np.inf), np.zeros(len(frames))
    for angle in np.radians(np.arange(0.0, 90.0, TURN)):
        turned = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        size = np.prod([_extreme(np.maximum, chart, part, len(frames)) - _extreme(np.minimum, chart, part, len(frames))
                        for part in turned], axis=0)
        chosen = np.where(size < best, angle, chosen)
        best = np.minimum(size, best)
    cosine, sine = np.cos(chosen)[:, None], np.sin(chosen)[:, None]
    return np.stack([cosine * frames[:, 0] + sine * frames[:, 1], cosine * frames[:, 1] - sine * frames[:, 0]], axis=1)


def _extreme(of: np.ufunc, index: I64, values: F64, count: int) -> F64:
    """(count,) the least or the greatest value of each index; 0 of those that are not there."""
    found = np.full(count, np.inf if of is np.minimum else -np.inf)
    of.at(found, index, values)
    return np.where(np.isfinite(found), found, 0.0)


def _smoothed(faces: Faces) -> F64:
    """(F, 3) unit normals, averaged over neighbours of neighbours."""
    value, (a, b) = faces.normals * faces.areas[:, None], faces.pairs.T
    for _ in range(ROUNDS):
        value = value + np.stack([_sum(a, value[b, k], len(value)) + _sum(b, value[a, k], len(value))
                                  for k in range(3)], axis=1)
        value /= np.maximum(np.linalg.norm(value, axis=1, keepdims=True), 1e-30)
        value *= faces.areas[:, None]
    return np.asarray(value / np.maximum(np.linalg.norm(value, axis=1, keepdims=True), 1e-30))


def _sum(index: I64, values: F64, count: int) -> F64:
    return np.asarray(np.bincount(index, values, count), np.float64)


def _cleaned(side: I64, pairs: I64) -> I64:
    """Ragged borders between sides straightened, and single faces given to what surrounds them."""
    both, near = np.concatenate([pairs[:, 0], pairs[:, 1]]), np.concatenate([pairs[:, 1], pairs[:, 0]])
    every = np.arange(len(side))
    for _ in range(CLEANED):
        votes = np.bincount(both * 6 + side[near], minlength=6 * len(side)).reshape(-1, 6)
        votes[every, side] += 1
        side = np.asarray(votes.argmax(axis=1), np.int64)
    return side


def _parts(side: I64, pairs: I64) -> I64:
    """(F,) numbers of the connected parts of alike faces."""
    parent, open_ = np.arange(len(side)), pairs[side[pairs[:, 0]] == side[pairs[:, 1]]]
    while len(open_):
        ends = parent[open_]
        np.minimum.at(parent, ends.max(axis=1), ends.min(axis=1))
        while ((root := parent[parent]) != parent).any():
            parent = root
        ends = parent[open_]
        open_ = open_[ends[:, 0] != ends[:, 1]]
    return np.asarray(np.unique(parent, return_inverse=True)[1], np.int64)


def _axes(faces: Faces, smooth: F64, chart: I64) -> F64:
    """(n, 3) the charts' mean normals."""
    total = np.stack([np.bincount(chart, faces.areas * smooth[:, k]) for k in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-12 * max(float(faces.areas.sum()), 1e-30), total / np.maximum(length, 1e-30), AXES[2])


def _merged(faces: Faces, smooth: F64, chart: I64) -> I64:
    """Small charts joined to the larger neighbour with which they share most edges and that looks the same way."""
    total = faces.areas.sum()
    while True:
        count = int(chart.max()) + 1
        area, axis = np.bincount(chart, faces.areas), _axes(faces, smooth, chart)
        ends = chart[faces.pairs]
        ends = np.concatenate([ends, ends[:, ::-1]])[np.tile(ends[:, 0] != ends[:, 1], 2)]
        keys, shared = np.unique(ends[:, 0] * count + ends[:, 1], return_counts=True)
        small, large = keys // count, keys % count
        larger = (area[large] > area[small]) | ((area[large] == area[small]) & (large < small))
        fits = (area[small] < LEAST * total) & larger & (np.einsum("nk,nk->n", axis[small], axis[large]) > ANGLE)
        small, large, shared = small[fits], large[fits], shared[fits]
        if not len(small):
            return chart
        order = np.argsort(shared, kind="stable")  # the last one written is that with most
        target = np.arange(count)
        target[small[order]] = large[order]
        while ((root := target[target]) != target).any():
            target = root
        chart = np.asarray(np.unique(target[chart], return_inverse=True)[1], np.int64)


def _unfolded(faces: Faces, chart: I64, axes: F64) -> I64 | None:
    """Charts that lie over themselves, divided halfway between what lies above and what lies below; None: none do."""
    layer = _layers(faces, chart, axes)
    over = np.bincount(chart, layer >= 0) > np.maximum(FOLDED * np.bincount(chart), 1)
    if not over.any():
        return None
    layer[~over[chart]] = 0
    inside = faces.pairs[chart[faces.pairs[:, 0]] == chart[faces.pairs[:, 1]]]
    layer = _grown(layer, inside[over[chart[inside[:, 0]]]])
    return _parts(chart * 4 + layer, faces.pairs)


def _layers(faces: Faces, chart: I64, axes: F64) -> I64:
    """(F,) 0 of faces below others of their chart, 1 to 3 of those above; -1 where there is one layer."""
    frame, origin = _planes(axes)[chart], faces.centers.mean(axis=0)
    cell = CELL * float(np.sqrt(np.median(faces.areas)))
    place = np.floor(np.einsum("fjk,fk->fj", frame, faces.centers - origin) / max(cell, 1e-30)).astype(np.int64)
    depth = np.einsum("fk,fk->f", axes[chart], faces.centers - origin)
    order = np.lexsort([depth, place[:, 1], place[:, 0], chart])
    same = (np.diff(chart[order]) == 0) & (np.diff(place[order], axis=0) == 0).all(axis=1)
    gap = same & (np.diff(depth[order]) > FOLD * cell)
    starts = np.flatnonzero(np.concatenate([[True], ~same]))
    gaps = np.concatenate([[0], np.cumsum(gap)])
    group = np.cumsum(np.concatenate([[True], ~same])) - 1
    ends = np.append(starts[1:], len(order)) - 1
    layer = np.full(len(chart), -1, np.int64)
    folded = (gaps[ends] > gaps[starts])[group]
    layer[order[folded]] = np.minimum(gaps - gaps[starts][group], 3)[folded]
    return layer


def _grown(layer: I64, pairs: I64) -> I64:
    """Faces of layer -1 take that of the nearest ones, counted in faces."""
    both, near = np.concatenate([pairs[:, 0], pairs[:, 1]]), np.concatenate([pairs[:, 1], pairs[:, 0]])
    order = np.argsort(both, kind="stable")
    near, first = near[order], np.searchsorted(both[order], np.arange(len(layer) + 1))
    front = np.flatnonzero(layer >= 0)
    layer = layer.copy()
    while len(front):
        counts = first[front + 1] - first[front]
        at = np.repeat(first[front] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts) + np.arange(counts.sum())
        reached, source = near[at], np.repeat(layer[front], counts)
        new: Bool = layer[reached] < 0
        layer[reached[new]] = source[new]
        front = np.unique(reached[new])
    return np.maximum(layer, 0)
