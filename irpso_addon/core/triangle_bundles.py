"""Boxes around runs of triangles: what is asked of every corner of a dense mesh is asked of a few."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .data import F32, F64

BUNDLE = 512  # triangles in a box


@dataclass(frozen=True)
class Bundles:
    """Triangles, and in their order a box around each BUNDLE of them; the same for all cameras and lamps."""

    triangles: F32  # (T, 3, 3)
    low: F64  # (B, 3)
    high: F64  # (B, 3)

    @staticmethod
    def of(triangles: F32) -> Bundles:
        """Of triangles (T, 3, 3)."""
        starts = np.arange(0, 3 * len(triangles), 3 * BUNDLE)
        if not len(starts):
            return Bundles(triangles, np.zeros((0, 3)), np.zeros((0, 3)))
        corners = triangles.reshape(-1, 3)
        return Bundles(triangles, *(of.reduceat(corners, starts).astype(np.float64) for of in (np.minimum, np.maximum)))

    @cached_property
    def centers(self) -> F64:
        """(B, 3) of spheres around the triangles."""
        return np.asarray((self.low + self.high) / 2)

    @cached_property
    def radii(self) -> F64:
        """(B,) of the spheres."""
        with np.errstate(all="ignore"):  # what is not finite is looked at by itself
            return np.asarray(np.linalg.norm(self.high - self.low, axis=1) / 2)

    @cached_property
    def edges(self) -> F64:
        """(B,) the longest edges."""
        longest = np.zeros(len(self.triangles), np.float32)
        with np.errstate(all="ignore"):
            for corner in range(3):
                edge = self.triangles[:, corner] - self.triangles[:, corner - 1]
                np.maximum(longest, np.einsum("tk,tk->t", edge, edge), out=longest)
        starts = np.arange(0, len(longest), BUNDLE)
        return np.sqrt(np.maximum.reduceat(longest, starts).astype(np.float64)) if len(starts) else np.zeros(0)

    def farthest(self, point: F64) -> float:
        """Distance of the farthest corner from a point (3,)."""
        away = np.linalg.norm(self.centers - point, axis=1)
        least = np.linalg.norm(self.triangles[::BUNDLE, 0] - point, axis=1).max()  # of corners that are there
        return max(float(np.linalg.norm(self._of(n) - point, axis=2).max())
                   for n in np.flatnonzero(away + self.radii >= least * (1 - 1e-9)).tolist())

    def _of(self, bundle: int) -> F64:
        return self.triangles[bundle * BUNDLE:(bundle + 1) * BUNDLE].astype(np.float64)

    def extremes(self, least: F64, most: F64) -> F64:
        """(N, 3, 3) triangles among which are those with the least and the greatest of something.

        ``least``, ``most``: (B,) bounds of it in each bundle.
        """
        kept = np.flatnonzero((least <= most.min()) | (most >= least.max()))
        return np.concatenate([self._of(n) for n in kept.tolist()])
