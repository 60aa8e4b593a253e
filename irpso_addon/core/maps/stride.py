"""How fine the pictures are beside the map, and which texels must therefore be solved: every one, or every second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..data import F32, F64, I32, Bool, Camera, MeshArrays
from ..projection import pixels_of

SAMPLE = 2000  # places on the surface, as many to each texel
FACING = 0.2  # cosine to the camera: what is seen at a more grazing angle is not what shows a texel best
FLAT = 1e-14  # of the UV square: what triangles without area have
ENOUGH = 2.0  # pixels (mean) that a solved texel stands for, at most: with more, pixels would be left out
LEAST, MOST = 256, 8  # texels on a side that are solved at the least; the largest stride
REACH = 2.0  # times the distance at which solved texels are expected: what is farther is another piece of the surface
STRETCHED = 4.0  # how much longer a texel may be than wide
ALIKE = 0.15  # relative difference of base colours at which a texel counts a quarter
DARK = 0.01  # base colour up to which relative differences are noise
T = TypeVar("T", bound=np.generic)
I64 = NDArray[np.int64]


def pixels_per_texel(
    mesh: MeshArrays, cameras: Sequence[tuple[Camera, tuple[int, int]]], size: int, counted: Bool | None = None,
) -> F64:
    """(S,) pixels that a texel fills in the picture that shows it best, at places all over the map.

    ``cameras``: with width and height of their pictures.  ``size``: texels on a side of the map.  What no camera faces
    is left out.  Objects in front are not looked for: there may be fewer pixels than this, not more.  ``counted``: (T,)
    the triangles that are solved; None: those whose middle lies on the map.
    """
    grid = (mesh.uvs if mesh.grid is None else mesh.grid).astype(np.float64)
    if counted is None:
        middle = grid.mean(axis=1)
        counted = np.all((middle >= 0) & (middle <= 1), axis=1)
    edges = grid[:, 1:] - grid[:, :1]  # (T, 2 edges, uv)
    area = _crossed(edges[:, 0], edges[:, 1])
    total = np.cumsum(np.where(counted & (np.abs(area) > FLAT), np.abs(area), 0.0))
    if not len(total) or total[-1] == 0:
        return np.zeros(0)
    chosen = np.searchsorted(total, (np.arange(SAMPLE) + 0.5) / SAMPLE * total[-1])
    corners, edges = mesh.positions[chosen].astype(np.float64), edges[chosen]
    along = corners[:, 1:] - corners[:, :1]
    inverse = np.stack([edges[:, 1, 1], -edges[:, 0, 1], -edges[:, 1, 0], edges[:, 0, 0]], -1).reshape(-1, 2, 2)
    # (S, 2, 3) how the place changes with u and with v, over a texel.
    steps = inverse @ along / (size * area[chosen])[:, None, None]
    place = corners[:, 0] + np.einsum("sk,skx->sx", _spots(SAMPLE), along)
    normal = np.cross(along[:, 0], along[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    inside = (normal * mesh.normals[chosen].sum(axis=1)).sum(axis=1, keepdims=True) < 0  # as of a mirrored object
    normal = np.where(inside, -normal, normal)
    best = np.zeros(SAMPLE)
    for camera, picture in cameras:
        away = np.broadcast_to(-camera.forward, place.shape) if camera.orthographic else camera.position - place
        away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-30)
        at, right, up = (pixels_of(camera, points, picture) for points in (
            place, place + steps[:, 0], place + steps[:, 1]))
        shown = np.abs(_crossed(right - at, up - at))
        seen = ((normal * away).sum(1) > FACING) & np.all((at > 0) & (at < picture), axis=1)
        best = np.fmax(best, np.where(seen, shown, 0.0))
    return best[best > 0]


def _spots(count: int) -> F64:
    """(count, 2) places in triangles, as shares of two sides: Roberts' R2 sequence, folded at the third side."""
    at = (0.5 + np.outer(np.arange(1, count + 1), [0.7548776662466927, 0.5698402909980532])) % 1
    return np.where(at.sum(1, keepdims=True) > 1, 1 - at, at)


def _crossed(a: F64, b: F64) -> F64:
    """(N,) signed areas of parallelograms with sides (N, 2) each."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def stride_of(pixels: F64, size: int) -> int:
    """Every how many-th texel of a row and column is solved, if the texels fill so many ``pixels``; 1: each.

    ``pixels``: as of `pixels_per_texel`, at ``size`` texels on a side.
    """
    each, stride = float(pixels.mean()) if len(pixels) else 1.0, 1
    while each * (2 * stride) ** 2 <= ENOUGH and size // (2 * stride) >= LEAST and stride < MOST:
        stride *= 2
    return stride


@dataclass(frozen=True)
class SparseTexels:
    """The texels that are solved where not all are: one of each block; and what the others take from them.

    A texel takes the bilinear mean of the four solved ones around it, as far as these are of its material and of the
    same piece of the surface.
    """

    rows: I32  # (m, m) of the solved texel of each block: the first one that is covered
    columns: I32
    stride: int  # width of a block, in texels
    size: int  # n, texels on a side of the map
    texels: I32  # (N,) covered texels, as places in the flat map
    corners: I32  # (4, N) the solved texels around each, as places in the flat (m, m) array
    weights: F32  # (4, N), whose sum is 1; or 0

    @classmethod
    def of(cls, position: F32, slots: I32, stride: int) -> SparseTexels:
        """``position``: (n, n, 3) metres.  ``slots``: (n, n) material slot of each texel to solve, -1 elsewhere."""
        size = len(slots)
        side = -(-size // stride)
        covered = np.pad(slots >= 0, (0, side * stride - size))
        blocks = covered.reshape(side, stride, side, stride).swapaxes(1, 2).reshape(side, side, stride**2)
        first = blocks.argmax(-1)
        rows, columns = (np.minimum(stride * at + off, size - 1).astype(np.int32) for at, off in zip(
            np.mgrid[:side, :side], np.divmod(first, stride), strict=True))
        row, column = np.nonzero(slots >= 0)
        low = [at // stride for at in (row, column)]
        along = [(at % stride / stride).astype(np.float32) for at in (row, column)]
        width = _widths(position, slots >= 0, row, column)
        here, slot = position[row, column], slots[row, column]
        corners, weights, same = [], [], []
        for down, right in np.ndindex(2, 2):
            y, x = np.minimum(low[0] + down, side - 1), np.minimum(low[1] + right, side - 1)
            there = rows[y, x], columns[y, x]
            apart = _lengths(position[there] - here)
            weight = (along[0] if down else 1 - along[0]) * (along[1] if right else 1 - along[1])
            alike = (slots[there] == slot) & (apart <= REACH * stride * width)
            corners.append((y * side + x).astype(np.int32))
            same.append(alike)
            weights.append(weight * alike)
        weight = np.stack(weights).astype(np.float32)
        alone = ~weight.any(0)  # the solved one of its block is of another piece
        weight[:, alone] = np.stack(same)[:, alone]
        return cls(rows, columns, stride, size, (row * size + column).astype(np.int32), np.stack(corners),
                   _whole(weight))

    def picked(self, values: NDArray[T]) -> NDArray[T]:
        """(m, m, ...) of the solved texels, from (n, n, ...)."""
        return values[self.rows, self.columns]

    def among(self, solved: Bool) -> SparseTexels:
        """The same where so many of the (m, m) texels have a value."""
        return replace(self, weights=_whole(self.weights * solved.reshape(-1)[self.corners]))

    def guided(self, base: F32) -> SparseTexels:
        """The same, where texels of about a texel's own colour count more: ``base``, (n, n, 3) linear base colour.

        Joint bilateral upsampling (Kopf et al. 2007): where colour changes from one texel to the next, so may
        roughness, and the mean of both sides is that of none.
        """
        flat = base.reshape(-1, 3)
        own, solved = flat[self.texels], self.picked(base).reshape(-1, 3)
        weights = self.weights.copy()
        bright, brightness = _lengths(own), _lengths(solved)
        for corner, weight in zip(self.corners, weights, strict=True):
            relative = _lengths(solved[corner] - own) / (0.5 * (brightness[corner] + bright) + DARK)
            weight /= np.square(1 + np.square(relative / ALIKE))
        return replace(self, weights=_whole(weights))

    @property
    def known(self) -> Bool:
        """(n, n) texels that get a value."""
        return self._everywhere(self.weights.any(0))

    def spread(self, values: F32) -> F32:
        """(n, n, ...) from (m, m, ...): means by weight; 0 where nothing is known."""
        flat = values.reshape(len(self.rows) ** 2, -1)
        means = np.zeros((flat.shape[1], len(self.texels)), np.float32)
        for channel, mean in zip(np.ascontiguousarray(flat.T), means, strict=True):
            for corner, weight in zip(self.corners, self.weights, strict=True):
                np.add(mean, channel[corner] * weight, out=mean, where=weight > 0)
        return self._everywhere(means.T.reshape(len(self.texels), *values.shape[2:]))

    def _everywhere(self, values: NDArray[T]) -> NDArray[T]:
        result = np.zeros((self.size**2, *values.shape[1:]), values.dtype)
        result[self.texels] = values
        return result.reshape(self.size, self.size, *values.shape[1:])


def _whole(weights: F32) -> F32:
    """(4, N) whose sum is 1, or 0."""
    return np.asarray(weights / np.maximum(weights.sum(0), np.float32(1e-30)), np.float32)


def _lengths(vectors: F32) -> F32:
    """(...) of (..., 3)."""
    return np.asarray(np.sqrt(np.einsum("...k,...k->...", vectors, vectors)), np.float32)


def _widths(position: F32, covered: Bool, row: I64, column: I64) -> F32:
    """(N,) metres from a texel to its nearest covered neighbour along a row and along a column, together.

    One that is much farther than the other lies on another piece of the surface.
    """
    nearest = []
    for low, high in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        apart = np.where(covered[low] & covered[high], _lengths(position[high] - position[low]), np.float32(np.inf))
        least = np.full(covered.shape, np.inf, np.float32)
        least[low] = apart
        np.minimum(least[high], apart, out=least[high])
        nearest.append(least[row, column])
    across, along = nearest
    most = STRETCHED * np.minimum(across, along)
    return np.asarray(np.where(np.isfinite(most), np.minimum(across, most) + np.minimum(along, most), 0), np.float32)
