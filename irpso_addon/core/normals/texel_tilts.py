"""The tilts of a map's texels: smoothed where data are few, without drift from the mesh's large shape.

A Gaussian Markov random field: what the observations say of each texel, normal about no tilt, normal about its four
neighbours on the surface, and hardly any circulation around four texels, because normals are those of a surface
(Horn and Brooks, Comput. Vision Graph. 33, 1986).  Conjugate gradients find its most likely tilts.  They begin with
those of texels twice as wide, found alike: what whole regions have in common takes them hundreds of rounds otherwise.
"""

from __future__ import annotations

import numpy as np

from ..data import F32, F64, I32, Bool
from ..shading.lights import light_basis
from .low_pass import common

ROUNDS, AGAIN = 200, 40  # from nothing; from what coarser texels say
COARSEST = 32  # rows or columns of the grid with which the search begins
SETTLED = 3e-3  # of the residual of no tilts
CURL = 10.0  # times as stiff against circulation as against steps from texel to texel
ALIKE = 0.5  # cosine between normals of neighbours
NEAR = 4.0  # times the usual step from texel to texel: farther apart is another part of the surface
FINEST, ROUGHEST = 0.02, 0.5  # of a tilt's deviation: what steps from texel to texel may be
FARTHER = 1.9  # times as much as over one texel such a field varies over four (mean squares)
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

    def halved(self) -> TexelTilts:
        """Texels twice as wide, which know what theirs do."""
        count = _fours(self.texels.astype(np.float32))
        position, normal = (_fours(np.where(self.texels[..., None], values, np.float32(0))) for values in (
            self.position, self.normal))
        wide = TexelTilts(np.asarray(position / np.maximum(count, 1)[..., None], np.float32), normal, count > 0)
        turn = np.einsum("hwik,hwjk->hwij", _axes(self.normal), _spread(_axes(wide.normal), self.texels.shape))
        across = np.where(self.texels[..., None, None], turn, 0).swapaxes(2, 3)
        wide.information = _fours(across @ self.information @ turn)
        wide.pull = _fours((across @ self.pull[..., None])[..., 0])
        return wide

    def offsets(self, deviation: float, relief: bool = False, large: bool = False) -> F32:
        """(h, w, 3) what is to be added to the unit normals.

        ``relief``: of a plane, whose tilts may differ from texel to texel as much as any.  ``large``: with what whole
        regions have in common.
        """
        field = _Field(self, deviation, 1 / deviation**2 / 2 if relief else None)
        tilt = field.relaxed()
        offset = field.in_space(tilt)
        offset = offset if large else self._small_scale(offset, field)
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

    def __init__(self, found: TexelTilts, deviation: float, stiffness: float | None = None) -> None:
        """``stiffness``: as of `_stiffness`; None: it is to be found."""
        self.found, self.position, self.deviation = found, found.position, deviation
        self.information, self.pull = found.information, found.pull
        self.axes = _axes(found.normal)
        self.joined = (self._joined(found, 0), self._joined(found, 1))
        self.stiffness = self._stiffness() if stiffness is None else stiffness

    def in_space(self, tilt: F32) -> F32:
        """(h, w, 3)."""
        return np.asarray(np.einsum("hwi,hwik->hwk", tilt, self.axes), np.float32)

    def certainty(self) -> F32:
        """(h, w) 0..1: how much more is known than was assumed."""
        least = 0.5 * np.trace(self.information, axis1=2, axis2=3)
        return np.asarray(least / (least + 1 / self.deviation**2), np.float32)

    def relaxed(self) -> F32:
        """(h, w, 2) the most likely tilts."""
        surface = _Surface(self.axes, *self.joined, self.position)
        own = (1 / self.deviation**2 + self.stiffness * surface.own())[..., None, None] * np.eye(2)
        inverse, known = _planes(np.linalg.inv(self.information + own)), _planes(self.information)

        def held(tilt: F32) -> F32:
            return np.asarray(_times(known, tilt) + tilt / np.float32(self.deviation**2) + np.float32(
                self.stiffness) * surface.bent(tilt))

        pull, start = np.ascontiguousarray(np.moveaxis(self.pull, -1, 0)), self._begun()
        least, before = SETTLED**2 * float(np.vdot(pull, _times(inverse, pull))), 1.0
        tilt, way = np.zeros_like(pull) if start is None else start, np.zeros_like(pull)
        left = pull if start is None else pull - held(start)
        for n in range(ROUNDS if start is None else AGAIN):
            nearer = _times(inverse, left)
            now = float(np.vdot(left, nearer))
            if now <= least:
                break
            way = np.asarray(nearer + np.float32(now / before if n else 0.0) * way, np.float32)
            pulled = held(way)
            step = np.float32(now / float(np.vdot(way, pulled)))
            tilt, left, before = tilt + step * way, left - step * pulled, now
        length = np.linalg.norm(tilt, axis=0)
        return np.moveaxis(tilt * np.minimum(1, STEEPEST / np.maximum(length, 1e-12)), 0, -1).astype(np.float32)

    def _begun(self) -> F32 | None:
        """(2, h, w) the tilts of texels twice as wide; None where these are few."""
        if min(self.found.texels.shape) < 2 * COARSEST:
            return None
        wide = _Field(self.found.halved(), self.deviation / 2, self.stiffness)  # four are known to be small
        offset = _spread(wide.in_space(wide.relaxed()), self.found.texels.shape)
        return np.ascontiguousarray(np.einsum("hwk,hwik->ihw", offset, self.axes), np.float32)

    def _joined(self, found: TexelTilts, axis: int) -> Bool:
        """Whether a texel and the next along an axis lie side by side on the surface."""
        ends = ENDS[axis]
        both = found.texels[ends[0]] & found.texels[ends[1]]
        step = np.linalg.norm(found.position[ends[1]] - found.position[ends[0]], axis=-1)
        usual = float(np.median(step[both])) if both.any() else 0.0
        alike = (found.normal[ends[0]] * found.normal[ends[1]]).sum(-1) > ALIKE
        return np.asarray(both & alike & (step < NEAR * usual))

    def _stiffness(self) -> float:
        """1 / variance of a step of the tilt from texel to texel, by what the texels say beyond their errors.

        A smooth surface varies over four texels 16 times as much as over one, this field hardly twice.  What neighbours
        are to fill in is wider than one texel, so the field is as loose as steps over four texels need.
        """
        known = self.information + np.eye(2, dtype=np.float32) / np.float32(self.deviation) ** 2
        covariance = np.linalg.inv(known)
        offset = self.in_space(np.einsum("hwij,hwj->hwi", covariance, self.pull))
        noise = np.trace(covariance, axis1=2, axis2=3) / 2
        one, four = (self._steps(offset, noise, far) for far in (1, 4))
        low, high = (share * self.deviation for share in (FINEST, ROUGHEST))
        return 1 / float(np.clip(max(one, four / FARTHER), low**2, high**2)) / 2

    def _steps(self, offset: F32, noise: F32, far: int) -> float:
        """Mean square of steps so many texels far along the surface, an axis, beyond their errors."""
        sure, steps = self.certainty() > 0.5, []
        for axis, joined in enumerate(self.joined):
            count = joined.shape[axis] + 1 - far
            if count < 1:
                continue
            between = [joined.take(range(n, n + count), axis) for n in range(far)]
            ends = [[values.take(range(n, n + count), axis) for n in (0, far)] for values in (offset, noise, sure)]
            some = np.logical_and.reduce([*between, *ends[2]])
            square = ((ends[0][1] - ends[0][0]) ** 2).sum(-1) / 2
            steps.append((square - ends[1][0] - ends[1][1])[some])
        every = np.concatenate(steps) if steps else np.zeros(0)
        return float(np.mean(every)) if len(every) else 0.0


class _Surface:
    """How steps from texel to texel, and circulation around four of them, hold tilts.  Arrays are (2 or 3, h, w)."""

    def __init__(self, axes: F32, down: Bool, right: Bool, position: F32) -> None:
        """``axes``: (h, w, 2, 3); ``down``, ``right``: as `_Field.joined`."""
        self.axes = np.ascontiguousarray(np.moveaxis(axes, (2, 3), (0, 1)))
        self.down, self.right = down.astype(np.float32), right.astype(np.float32)
        whole = down[:, :-1] & down[:, 1:] & right[:-1] & right[1:]
        first, second = position[1:, 1:] - position[:-1, :-1], position[:-1, 1:] - position[1:, :-1]
        area = np.linalg.norm(np.cross(first, second), axis=-1, keepdims=True) / 2
        scale = np.where(whole[..., None], 0.5 / np.maximum(np.sqrt(area), 1e-12), 0.0)
        self.whole = whole.astype(np.float32)
        self.first, self.second = (np.ascontiguousarray(np.moveaxis(scale * diagonal, -1, 0), np.float32)
                                   for diagonal in (first, second))

    def own(self) -> F32:
        """(h, w) about what holds each texel's own tilt."""
        count = np.zeros(self.axes.shape[2:], np.float32)
        for part in (count[:-1], count[1:]):
            part += self.down
        for part in (count[:, :-1], count[:, 1:]):
            part += self.right
        for part in (count[:-1, :-1], count[1:, 1:], count[:-1, 1:], count[1:, :-1]):
            part += np.float32(CURL / 4) * self.whole
        return count

    def bent(self, tilt: F32) -> F32:
        """The gradient of half the squared steps and circulations."""
        offset = tilt[0] * self.axes[0] + tilt[1] * self.axes[1]
        force = np.zeros_like(offset)
        step = self.down * (offset[:, 1:] - offset[:, :-1])
        force[:, 1:] += step
        force[:, :-1] -= step
        step = self.right * (offset[:, :, 1:] - offset[:, :, :-1])
        force[:, :, 1:] += step
        force[:, :, :-1] -= step
        around = np.float32(CURL) * (((offset[:, :-1, :-1] - offset[:, 1:, 1:]) * self.second).sum(0)
                                     + ((offset[:, :-1, 1:] - offset[:, 1:, :-1]) * self.first).sum(0))
        first, second = around * self.first, around * self.second
        force[:, :-1, :-1] += second
        force[:, 1:, 1:] -= second
        force[:, :-1, 1:] += first
        force[:, 1:, :-1] -= first
        return np.stack([(axis * force).sum(0) for axis in self.axes])


def _axes(normal: F32) -> F32:
    """(h, w, 2, 3) of (h, w, 3)."""
    return np.stack(light_basis(normal.astype(np.float64)), -2).astype(np.float32)


def _fours(values: F32) -> F32:
    """Sums of (h, w, ...) values over two rows and two columns each."""
    rows, columns = (np.arange(0, length, 2) for length in values.shape[:2])
    return np.asarray(np.add.reduceat(np.add.reduceat(values, rows, 0), columns, 1))


def _spread(values: F32, shape: tuple[int, ...]) -> F32:
    """Each of (h, w, ...) values four times, as far as there are rows and columns."""
    return values.repeat(2, 0).repeat(2, 1)[:shape[0], :shape[1]]


def _planes(matrix: F32 | F64) -> F32:
    """(2, 2, h, w) of (h, w, 2, 2)."""
    return np.ascontiguousarray(np.moveaxis(matrix, (2, 3), (0, 1)), np.float32)


def _times(matrix: F32, vector: F32) -> F32:
    """(2, h, w) of (2, 2, h, w) times (2, h, w)."""
    return np.asarray(matrix[:, 0] * vector[0] + matrix[:, 1] * vector[1])
