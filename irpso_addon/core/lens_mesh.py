"""Triangles divided so finely that a camera's lens does not bend their edges any more: what OpenGL can draw.

OpenGL draws straight edges between corners that lie where the lens shows them.  An edge is halved while its picture is
longer than a bound, and its own two ends alone decide that: the triangles on both its sides halve it alike, in the
same round, so that no cracks open.

What the picture does not show is left out.  Corners that the lens does not reach, or that lie behind the camera, have
no place in the picture: triangles that have such a corner are halved until each piece is either wholly within reach or
wholly out of the picture.  Where the lens's reach ends within the picture, pieces up to LEAST_BORDER wide are left out
along that limit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .data import F32, F64, Bool, Camera
from .lens import Lens
from .projection import lens_axes
from .triangle_bundles import BUNDLE, Bundles

TOLERANCE = 0.03  # pixels between a drawn place and its true one; OpenGL adds up to 1/256 of its own
ROUNDS = 40  # of halving: what is not decided then lies at the very eye
MOST = 2_000_000  # pieces; where more are needed, the rest stays as coarse as it is then
BORDER = 0.1  # of the angle that the picture shows: so far beyond it corners have places
LEAST_BORDER = 2e-3  # radians
AT_ONCE = 1 << 17  # triangles that are looked at together
I64 = NDArray[np.int64]
# Corners of a triangle's pieces, by how many of its edges are halved, which come first: 0 to 2 are its corners, 3 to 5
# the middles of the edges 0-1, 1-2, 2-0.
PIECES = {1: ((0, 3, 2), (3, 1, 2)), 2: ((3, 1, 4), (0, 3, 4), (0, 4, 2)),
          3: ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))}


@dataclass(frozen=True)
class Division:
    """S triangles, each a part of one that was given, in the order of those."""

    parent: I64  # (S,) of which
    weights: F32  # (S, 3, 3) barycentric coordinates of its corners in that
    positions: F32  # (S, 3, 3) world; shared corners are alike to the bit
    whole: bool  # nothing was divided or left out

    def divided(self, rows: F32) -> F32:
        """(S, 3, c) of values (T, 3, c) at the corners of the given triangles."""
        values = rows[self.parent]
        part = np.flatnonzero((self.weights != np.eye(3, dtype=np.float32)).any(axis=(1, 2)))
        values[part] = np.einsum("sij,sjk->sik", self.weights[part], values[part])
        return values


@dataclass(frozen=True)
class _Bounds:
    """What decides whether a triangle is divided."""

    lens: Lens  # of the picture's size
    axes: F64  # (4, 4) world to the lens's axes
    shown: float  # radians off the axis: farthest that the picture shows
    placed: float  # radians: corners farther off have no place
    curve: float  # pixels: most that the picture bends, per squared unit of r (a fisheye's: radian)
    longest: float  # in r (radians): an edge between corners that have places

    @property
    def narrow(self) -> float:
        """Longest edge between unit directions where a corner has no place."""
        return max(0.5 * (self.placed - self.shown), LEAST_BORDER)

    def fine(self, bundles: Bundles) -> Bool:
        """(B,) those in which every corner has a place, and no edge can be too long."""
        local = bundles.centers @ self.axes[:3, :3].T + self.axes[:3, 3]
        away = np.linalg.norm(local, axis=1)
        nearest = away - bundles.radii
        with np.errstate(all="ignore"):
            angle = (np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2])
                     + np.arcsin(np.minimum(bundles.radii / away, 1)))
            if self.lens.fisheye:  # an arc is at most pi / 2 of its chord
                longest = np.pi / 2 * bundles.edges / nearest * angle / np.sin(angle)
            else:  # |d(x/z)| <= |dx| / z + |x/z| |dz| / z
                longest = bundles.edges / np.cos(angle) / (local[:, 2] - bundles.radii)
        front = nearest > 0 if self.lens.fisheye else local[:, 2] > bundles.radii
        return np.asarray(front & (angle < 0.999 * self.placed) & (longest < 0.999 * self.longest))


def divided(triangles: F32, camera: Camera, size: tuple[int, int], bundles: Bundles | None = None) -> Division:
    """Triangles (T, 3, 3), world, for pictures of ``size`` (width, height) through the camera's lens.

    ``bundles``: of the triangles, where they are known.
    """
    bounds = _bounds(camera, size)
    identity = np.broadcast_to(np.eye(3, dtype=np.float32), (1, 3, 3))
    fine = np.repeat(bounds.fine(bundles or Bundles.of(triangles)), BUNDLE)[:len(triangles)]
    kept, others = np.flatnonzero(fine), np.flatnonzero(~fine)
    done, active, whole = [], [], True
    for first in range(0, len(others), AT_ONCE):
        parent = others[first:first + AT_ONCE]
        corners = triangles[parent].astype(np.float32)
        cells = np.concatenate([corners, np.repeat(identity, len(corners), axis=0)], axis=2)
        look = _Look(bounds, corners)
        whole = whole and not bool((look.astray | look.long.any(axis=1)).any())
        done.append((parent[look.ready], cells[look.ready]))
        active.append((parent[look.open], cells[look.open]))
    if whole:
        return Division(np.arange(len(triangles)), np.broadcast_to(identity, triangles.shape), triangles, True)
    done.append((kept, np.concatenate([triangles[kept], np.repeat(identity, len(kept), axis=0)], axis=2)))
    pieces = _joined(active)
    for _ in range(ROUNDS):
        if sum(len(parent) for parent, _ in done) - len(triangles) + 4 * len(pieces[0]) > MOST:
            bounds = replace(bounds, longest=np.inf)
        pieces = _halved(bounds, *pieces, done)
        if not len(pieces[0]):
            break
    parent, cells = _joined(done)
    order = np.argsort(parent, kind="stable")
    return Division(parent[order], cells[order][..., 3:], np.ascontiguousarray(cells[order][..., :3]), False)


def _halved(bounds: _Bounds, parent: I64, cells: F32, done: list[tuple[I64, F32]]) -> tuple[I64, F32]:
    """One round: what is to be looked at again; what is ready goes to ``done``.  cells: (A, 3, 6) position, weights."""
    again = []
    for first in range(0, len(parent), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        look = _Look(bounds, cells[part, :, :3])
        done.append((parent[part][look.ready], cells[part][look.ready]))
        split = look.open
        middles = look.middles(cells[part])[split]
        of, children = _split(cells[part][split], middles, look.long[split])
        again.append((parent[part][split][of], children))
    return _joined(again)


def _joined(parts: list[tuple[I64, F32]]) -> tuple[I64, F32]:
    return (np.concatenate([parent for parent, _ in parts] or [np.zeros(0, np.int64)]),
            np.concatenate([cells for _, cells in parts] or [np.zeros((0, 3, 6), np.float32)]))


class _Look:
    """What is to become of triangles (A, 3, 3)."""

    def __init__(self, bounds: _Bounds, corners: F32) -> None:
        lens = bounds.lens
        # Sums in a fixed order: a corner's numbers must not depend on its place in the array, as a product's would
        x, y, z = local = np.stack([sum(corners[..., k].astype(np.float64) * row[k] for k in range(3)) + row[3]
                                    for row in bounds.axes[:3]])
        with np.errstate(all="ignore"):
            across = np.sqrt(x * x + y * y)
            self.away = np.sqrt(across * across + z * z)
            angle = np.arctan2(across, z)
            self.placed = (angle <= bounds.placed) & (self.away > 0)
            unit = local / self.away
            flat = np.where(across > 0, local[:2] / across, 0.0) * (angle if lens.fisheye else across / z)
            self.weight = self.away if lens.fisheye else z
            between = self._squared(flat)
            self.both = self.placed & np.roll(self.placed, -1, axis=1)
            self.long: Bool = np.where(self.both, between > bounds.longest**2,
                                       self._squared(unit) > bounds.narrow**2)
            lost = ~self.placed.all(axis=1)
            outside = np.where(lost, _off_picture(bounds, unit), False)
            seen = ~lost
            reach = 1 + bounds.curve / 6 * between[seen].max(axis=1, initial=0.0)
            pixels = lens.project(np.moveaxis(local[:, seen], 0, -1))
            beyond = ((pixels.max(axis=1) < -reach[:, None])
                      | (pixels.min(axis=1) > (lens.width, lens.height) + reach[:, None]))
            outside[seen] = beyond.any(axis=1)
        self.astray: Bool = lost
        undecided = self.long.any(axis=1)
        self.ready: Bool = seen & ~undecided & ~outside
        self.open: Bool = undecided & ~outside

    def middles(self, cells: F32) -> F32:
        """(A, 3, 6) of the three edges' middles in the picture (where ends have no place: of the angle)."""
        ends = cells, np.roll(cells, -1, axis=1)
        weights = np.where(self.both, self.weight, self.away)
        others = np.where(self.both, np.roll(self.weight, -1, axis=1), np.roll(self.away, -1, axis=1))
        # From the same end whichever triangle asks
        turned = _later(ends[0][..., :3], ends[1][..., :3])
        first, second = (np.where(turned[..., None], ends[1 - i], ends[i]).astype(np.float64) for i in range(2))
        near, far = np.where(turned, others, weights), np.where(turned, weights, others)
        with np.errstate(all="ignore"):
            share = np.nan_to_num(near / (near + far), nan=0.5)[..., None]
        return np.asarray(first + share * (second - first), np.float32)

    @staticmethod
    def _squared(points: F64) -> F64:
        """(A, 3) squared lengths of the edges 0-1, 1-2, 2-0 of (k, A, 3)."""
        apart = points - np.roll(points, -1, axis=-1)
        return np.asarray((apart * apart).sum(axis=0))


def _later(a: F32, b: F32) -> Bool:
    """Whether points (..., 3) come after others in the order of x, then y, then z."""
    x, y, z = (np.sign(a[..., k] - b[..., k]) for k in range(3))
    return np.asarray(np.where(x != 0, x, np.where(y != 0, y, z)) > 0)


def _off_picture(bounds: _Bounds, unit: F64) -> Bool:
    """(A,) whether triangles of directions (3, A, 3) lie beside the cone that the picture shows."""
    middle = unit.sum(axis=-1)
    middle /= np.sqrt((middle**2).sum(axis=0))
    wide = np.arccos(np.clip((middle[..., None] * unit).sum(axis=0).min(axis=-1), -1, 1))
    off = np.arccos(np.clip(middle[2], -1, 1))
    return np.asarray((wide < 1.5) & (off - wide > bounds.shown))


def _split(cells: F32, middles: F32, long: Bool) -> tuple[I64, F32]:
    """The pieces of triangles (A, 3, 6) whose marked edges (A, 3) are halved: of which, and (P, 3, 6)."""
    count = long.sum(axis=1)
    turn = np.where(count == 1, long.argmax(axis=1), np.where(count == 2, long.argmin(axis=1) + 1, 0))
    order = ((turn[:, None] + np.arange(3)) % 3)[..., None]
    points = np.concatenate([np.take_along_axis(cells, order, 1), np.take_along_axis(middles, order, 1)], axis=1)
    of, children = [], []
    for number, pieces in PIECES.items():
        mine = np.flatnonzero(count == number)
        of.append(np.repeat(mine, len(pieces)))
        children.append(points[mine][:, np.array(pieces)].reshape(-1, 3, 6))
    return np.concatenate(of), np.concatenate(children)


def _bounds(camera: Camera, size: tuple[int, int]) -> _Bounds:
    """Of pictures of ``size`` through the camera."""
    assert camera.lens is not None
    lens = camera.lens.resized(*size)
    reach = lens.reach if lens.fisheye else float(np.arctan(lens.reach))
    at = np.linspace(0, 1, 65)
    border = np.concatenate([np.stack(np.broadcast_arrays(*pair), -1)
                             for pair in ((at, 0.0), (at, 1.0), (0.0, at), (1.0, at))])
    rays = lens.rays(border * size)
    angles = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    shown = min(float(np.where(np.isfinite(angles), angles, reach).max()), reach)
    placed = min(shown * (1 + BORDER) + LEAST_BORDER, reach, np.pi - 0.05)
    if not lens.fisheye:
        placed = min(placed, (shown + np.pi / 2) / 2)
    curve = _curve(lens, shown)
    widest = placed if lens.fisheye else float(np.tan(placed))
    return _Bounds(lens, lens_axes(camera), shown, placed, curve,
                   min(float(np.sqrt(6 * TOLERANCE / max(curve, 1e-12))), 4 * widest))


def _curve(lens: Lens, widest: float) -> float:
    """Most that a straight line's picture bends, or is drawn unevenly: pixels per squared unit of r, or radian.

    Linear interpolation over a triangle whose edges are at most e long then errs by at most a sixth of it times e^2
    (Waldron 1998, "The error in linear interpolation at the vertices of a simplex": R^2 / 2, R its circumradius).
    """
    angle, turn, way = np.meshgrid(np.linspace(0, widest, 49), np.linspace(0, 2 * np.pi, 24, endpoint=False),
                                   np.linspace(0, np.pi, 8, endpoint=False), indexing="ij")
    outward = np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    aside = np.stack([-np.sin(turn), np.cos(turn), 0 * turn], -1)
    axis = np.array([0.0, 0.0, 1.0])
    if lens.fisheye:
        points = np.sin(angle)[..., None] * outward + np.cos(angle)[..., None] * axis
        outward = np.cos(angle)[..., None] * outward - np.sin(angle)[..., None] * axis
    else:
        points = np.tan(angle)[..., None] * outward + axis
    step = 1e-3 * (np.cos(way)[..., None] * outward + np.sin(way)[..., None] * aside)
    bend = lens.project(points + step) - 2 * lens.project(points) + lens.project(points - step)
    most = np.hypot(bend[..., 0], bend[..., 1]) / 1e-6
    return float(np.nanmax(most)) if np.isfinite(most).any() else 0.0
