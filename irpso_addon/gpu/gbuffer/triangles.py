"""Triangles of a vertex buffer, drawn in pieces that take about a slice each."""

from __future__ import annotations

from collections.abc import Hashable, Iterable

import moderngl
import numpy as np
from numpy.typing import NDArray

from ...core.data import F32, F64
from ..device.context import Device
from ..device.draw_budget import Rectangle, rectangles

BUNDLE = 1024  # triangles that are drawn together
TRIANGLE = 64  # pixels that take as long as a triangle
FIRST_PIXELS = 131072.0  # of a draw of triangles before its speed is known
I64 = NDArray[np.int64]


class Triangles:
    """A run of triangles in a vertex buffer, drawn in pieces: bundles of them, and a dear bundle in bands of rows.

    In their order, so that what lies over what does not depend on how they are divided.
    """

    def __init__(self, positions: F32, first: int, count: int, grid: F32 | None = None) -> None:
        """``positions``: (T, 3, 3), world, of the whole buffer; ``grid``: (T, 3, 2) places on the texel grid."""
        self._ends = np.array([*range(first, first + count, BUNDLE), first + count], np.int64)
        self._boxes = _boxes(positions, self._ends)
        self._flat = None if grid is None else _boxes(grid, self._ends)

    def draw(
        self, device: Device, kind: Hashable, array: moderngl.VertexArray, target: moderngl.Framebuffer,
        clip: F64 | None, region: Rectangle | None = None,
    ) -> None:
        """Draw with what ``array`` and its program are; ``clip``: world to clip space, None: on the texel grid.

        ``kind``: what draws are alike in cost.  ``region``: the part of the target that is the picture; None: all.
        """
        at = _projected(self._boxes, clip) if clip is not None else self._flat
        assert at is not None
        x, y, width, height = region or (0, 0, *target.size)
        low, high = _pixels(at, (width, height))
        area = (high - low).prod(axis=1)
        cost = np.where(area > 0, area + TRIANGLE * np.diff(self._ends), 0.0)
        target.use()
        device.ctx.viewport = x, y, width, height
        i, shown = 0, np.append(area > 0, False)
        while i < len(cost):
            if not shown[i]:
                i += 1
                continue
            allowed = device.budget.most(kind, FIRST_PIXELS)
            end = i + int(np.argmin(shown[i:]))
            end = i + int(np.searchsorted(np.cumsum(cost[i:end]), allowed, side="right"))
            first, last = self._ends[i], self._ends[max(end, i + 1)]
            bands: Iterable[tuple[Rectangle | None, float]] = [(None, float(cost[i:end].sum()))]
            if end == i:  # even one is too much
                size = high[i] - low[i]
                bands = rectangles((*(low[i] + (x, y)).tolist(), *size.tolist()),
                                   lambda: device.budget.most(kind, FIRST_PIXELS),
                                   np.full(size[1], cost[i] / size[1], np.float32))
            for part, units in bands:
                if part is not None:
                    target.scissor = part
                    target.use()
                with device.budget.piece(kind, units):
                    array.render(moderngl.TRIANGLES, vertices=3 * int(last - first), first=3 * int(first))
            if end == i:
                target.scissor = None  # type: ignore[assignment]  # the stub does not know how to take it back
                target.use()
            i = max(end, i + 1)


def _boxes(points: F32, ends: I64) -> F64:
    """(B, 2^K, K) corners of the boxes around bundles of (T, 3, K) points."""
    if len(ends) < 2:
        return np.zeros((0, 2 ** points.shape[-1], points.shape[-1]))
    corners = points[ends[0]:ends[-1]].reshape(-1, points.shape[-1])
    starts = 3 * (ends[:-1] - ends[0])
    box = np.stack([of.reduceat(corners, starts) for of in (np.minimum, np.maximum)]).astype(np.float64)  # (2, B, K)
    choice = np.array(np.meshgrid(*[[0, 1]] * points.shape[-1])).reshape(points.shape[-1], -1).T
    return np.stack([box[choice[:, k], :, k] for k in range(points.shape[-1])], axis=-1).swapaxes(0, 1)


def _projected(corners: F64, clip: F64) -> F64:
    """(B, 8, 2) places in the picture, 0 to 1; not finite where a box reaches behind the camera."""
    at = corners @ clip[:, :3].T + clip[:, 3]
    behind = at[..., 3].min(axis=1, initial=np.inf) <= 0.0
    at[behind] = np.nan
    return np.asarray(0.5 * at[..., :2] / at[..., 3:] + 0.5)


def _pixels(at: F64, size: tuple[int, int]) -> tuple[I64, I64]:
    """First and end, (B, 2) each, of the pixels that boxes span in a picture, with one to spare; all where unknown."""
    known = np.isfinite(at).all(axis=(1, 2))
    at = np.where(known[:, None, None], at, np.array([[0.0, 0.0], [1.0, 1.0]])[np.arange(at.shape[1]) % 2])
    low, high = (np.clip(end, -1.0, 2.0) * size for end in (at.min(axis=1), at.max(axis=1)))
    first = np.clip(np.floor(low).astype(np.int64) - 1, 0, size)
    return first, np.maximum(np.clip(np.ceil(high).astype(np.int64) + 1, 0, size), first)
