"""The tilts of a map's texels: smoothed where data are few, without drift from the mesh's large shape.

A Gaussian Markov random field: what the observations say of each texel, normal about no tilt, and normal about its four
neighbours on the surface.  Its most likely tilts are found by relaxing texels of one colour of a chessboard at a time.
"""

from __future__ import annotations

import numpy as np

from ..data import F32, F64, I32, Bool
from ..shading.lights import light_basis
from .low_pass import common

SWEEPS = 40
ALIKE = 0.5  # cosine between normals of neighbours
NEAR = 4.0  # times the usual step from texel to texel: farther apart is another part of the surface
FINEST, ROUGHEST = 0.02, 0.5  # of a tilt's deviation: what steps from texel to texel may be
STEEPEST = 1.2  # tangent of the steepest tilt
ALL = slice(None)
# Of (h, w) arrays, along each axis: texels that have a next one, and these.
ENDS = (((slice(None, -1), ALL), (slice(1, None), ALL)), ((ALL, slice(None, -1)), (ALL, slice(1, None))))


class TexelTilts:
    """Collects what is known of each texel, then finds the tilts."""

    def __init__(self, position: F32, normal: F32, texels: Bool) -> None:
        """(h, w, 3) world; ``texels``: (h, w) those that have tilts."""
        self.position, self.texels = position, texels
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        self.normal: F32 = np.asarray(normal / np.maximum(length, 1e-12), np.float32)
        self.information = np.zeros((*texels.shape, 2, 2), np.float32)
        self.pull = np.zeros((*texels.shape, 2), np.float32)

    def add(self, at: tuple[I32, I32], information: F64, pull: F64) -> None:
        """Of some texels, as of `TiltsFound`."""
        self.information[at], self.pull[at] = information, pull

    def of(self, some: tuple[slice, slice]) -> TexelTilts:
        """Of some rows and columns."""
        part = TexelTilts(self.position[some], self.normal[some], self.texels[some])
        part.information, part.pull = self.information[some], self.pull[some]
        return part

    def offsets(self, deviation: float) -> F32:
        """(h, w, 3) what is to be added to the unit normals."""
        field = _Field(self, deviation)
        tilt = field.relaxed()
        offset = field.in_space(tilt)
        offset = self._small_scale(offset, field)
        return np.where(self.texels[..., None], offset, 0.0).astype(np.float32)

    def _small_scale(self, offset: F32, field: _Field) -> F32:
        """Without what whole regions have in common; regions that nothing is known of do not count."""
        some, weight = self.texels, field.certainty()[self.texels].astype(np.float64)
        position, normal, known = (values[some].astype(np.float64) for values in (self.position, self.normal, offset))
        result = offset.copy()
        result[some] -= (common(position, normal, known, weight) * weight[:, None]).astype(np.float32)
        return result


class _Field:
    """The random field.  (h, w, ...) arrays."""

    def __init__(self, found: TexelTilts, deviation: float) -> None:
        self.texels, self.deviation = found.texels, deviation
        self.information, self.pull = found.information, found.pull
        first, second = light_basis(found.normal.astype(np.float64))
        self.axes = np.stack([first, second], -2).astype(np.float32)  # (h, w, 2, 3)
        self.joined = [self._joined(found, axis) for axis in (0, 1)]
        self.stiffness = self._stiffness()

    def in_space(self, tilt: F32) -> F32:
        """(h, w, 3)."""
        return np.asarray(np.einsum("hwi,hwik->hwk", tilt, self.axes), np.float32)

    def certainty(self) -> F32:
        """(h, w) 0..1: how much more is known than was assumed."""
        least = 0.5 * np.trace(self.information, axis1=2, axis2=3)
        return np.asarray(least / (least + 1 / self.deviation**2), np.float32)

    def relaxed(self) -> F32:
        """(h, w, 2) the most likely tilts."""
        count = self._neighbours(np.ones(self.texels.shape, np.float32))
        known = self.information + (1 / self.deviation**2 + self.stiffness * count)[..., None, None] * np.eye(
            2, dtype=np.float32)
        inverse = np.linalg.inv(known)
        tilt = np.einsum("hwij,hwj->hwi", inverse, self.pull)
        height, width = self.texels.shape
        odd = (np.arange(height)[:, None] + np.arange(width)) % 2
        for sweep in range(SWEEPS):
            around = np.stack([self._neighbours(part) for part in np.moveaxis(self.in_space(tilt), -1, 0)], -1)
            wanted = self.pull + self.stiffness * np.einsum("hwik,hwk->hwi", self.axes, around)
            colour = (odd == sweep % 2)[..., None]
            tilt = np.where(colour, np.einsum("hwij,hwj->hwi", inverse, wanted), tilt)
        length = np.linalg.norm(tilt, axis=-1, keepdims=True)
        return np.asarray(tilt * np.minimum(1, STEEPEST / np.maximum(length, 1e-12)), np.float32)

    def _joined(self, found: TexelTilts, axis: int) -> Bool:
        """Whether a texel and the next along an axis lie side by side on the surface."""
        ends = ENDS[axis]
        both = found.texels[ends[0]] & found.texels[ends[1]]
        step = np.linalg.norm(found.position[ends[1]] - found.position[ends[0]], axis=-1)
        usual = float(np.median(step[both])) if both.any() else 0.0
        alike = (found.normal[ends[0]] * found.normal[ends[1]]).sum(-1) > ALIKE
        return np.asarray(both & alike & (step < NEAR * usual))

    def _neighbours(self, values: F32) -> F32:
        """(h, w) sums over neighbours."""
        result = np.zeros_like(values)
        down, right = self.joined
        result[:-1] += np.where(down, values[1:], 0)
        result[1:] += np.where(down, values[:-1], 0)
        result[:, :-1] += np.where(right, values[:, 1:], 0)
        result[:, 1:] += np.where(right, values[:, :-1], 0)
        return result

    def _stiffness(self) -> float:
        """1 / variance of a step of the tilt from texel to texel, by what the texels say beyond their errors."""
        known = self.information + np.eye(2, dtype=np.float32) / np.float32(self.deviation) ** 2
        covariance = np.linalg.inv(known)
        offset = self.in_space(np.einsum("hwij,hwj->hwi", covariance, self.pull))
        noise = np.trace(covariance, axis1=2, axis2=3) / 2
        sure = self.certainty() > 0.5
        steps = []
        for joined, ends in zip(self.joined, ENDS, strict=True):
            both = joined & sure[ends[0]] & sure[ends[1]]
            square = ((offset[ends[0]] - offset[ends[1]]) ** 2).sum(-1) / 2
            steps.append((square - noise[ends[0]] - noise[ends[1]])[both])
        every = np.concatenate(steps)
        variance = float(np.mean(every)) if len(every) else 0.0
        low, high = (share * self.deviation for share in (FINEST, ROUGHEST))
        return 1 / float(np.clip(variance, low**2, high**2)) / 2

