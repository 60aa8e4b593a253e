"""The demo's object: a painted vase as arrays, with the maps it is painted with.

Everything is a formula, so the truth is known exactly and nothing needs to be downloaded.  The unwrap is
analytic: one strip for the lathed body, one for each handle, no overlap.  All angles are shares of a turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data import F32, I32, Bool

Floats = NDArray[np.floating[Any]]
Indices = NDArray[np.signedinteger[Any]]

Island = tuple[float, float, float, float]  # left, right, bottom, top in the UV square

SEGMENTS, RINGS = 128, 160  # faces around and along the body
# (radius, height) in metres from the middle of the underside, up the outside, over the lip, to a floor in the neck.
PROFILE = np.array([
    (0.01, -0.80), (0.24, -0.80), (0.29, -0.79), (0.30, -0.74), (0.27, -0.68), (0.40, -0.45), (0.56, -0.15),
    (0.58, 0.10), (0.44, 0.34), (0.25, 0.50), (0.22, 0.62), (0.25, 0.74), (0.30, 0.82), (0.31, 0.84), (0.29, 0.845),
    (0.25, 0.81), (0.20, 0.76), (0.01, 0.75),
])
OUTSIDE = (2, 16)  # the part of PROFILE that pictures show; the rest gets a third of the texels
HANDLE = np.array([(0.50, 0.10), (0.68, 0.20), (0.74, 0.38), (0.60, 0.55), (0.40, 0.60), (0.20, 0.58)])
HANDLE_RADIUS = 0.065
BODY: Island = (0.015, 0.985, 0.015, 0.775)
HANDLES = ((0.015, 0.485, 0.805, 0.985), (0.515, 0.985, 0.805, 0.985))
HANDLE_TURNS = (0.125, 0.625)  # where they sit around the body
# Plain discs around their ends, for nothing sees what a handle hides: place 0..1 up the body, its radius in metres.
ROOTS = ((0.513, 0.58), (0.772, 0.22))
METRES = 2.19  # up the body's outside, of its 0..1
SPIRAL = (0.17, 0.93)  # part of a handle that has one

CLAY, TEAL, COBALT = (0.46, 0.17, 0.075), (0.030, 0.230, 0.215), (0.020, 0.045, 0.260)
CREAM, OCHRE = (0.72, 0.62, 0.43), (0.62, 0.30, 0.035)


@dataclass(frozen=True)
class QuadMesh:
    """Vertices and quads with a UV per quad corner."""

    vertices: F32  # (V, 3) metres
    quads: I32  # (F, 4)
    uvs: F32  # (F, 4, 2)


def mesh() -> QuadMesh:
    """Body and two handles."""
    curve, along = _resample(PROFILE, RINGS, _density())
    turn = np.linspace(0, 1, SEGMENTS + 1)
    body = _strip(lambda a, i: _lathe(curve[i], a), turn, along, BODY)
    return _join([body, *(_handle(at, island) for at, island in zip(HANDLE_TURNS, HANDLES, strict=True))])


def truth(size: int, first: int = 0, end: int | None = None) -> tuple[F32, F32]:
    """Base colour (n, n, 3) linear and roughness (n, n), row 0 at the bottom; means over each texel's square.

    ``first``, ``end``: of these rows alone, for maps that are too large to be painted at once.
    """
    fine = 2 * size
    axis = ((np.arange(fine) + 0.5) / fine).astype(np.float32)  # the paint needs no more, and takes half the time
    rows = axis[2 * first:None if end is None else 2 * end]
    u, v = np.meshgrid(axis, rows)
    color, rough = np.empty((*u.shape, 3), np.float32), np.empty_like(u)
    above = v > (BODY[3] + HANDLES[0][2]) / 2
    color[~above], rough[~above] = _paint_body(*_local(u[~above], v[~above], BODY))
    for island, its in zip(HANDLES, (above & (u < 0.5), above & (u > 0.5)), strict=True):
        color[its], rough[its] = _paint_handle(*_local(u[its], v[its], island))
    mean = (len(rows) // 2, 2, size, 2)
    return (color.reshape(*mean, 3).mean((1, 3)).astype(np.float32),
            rough.reshape(mean).mean((1, 3)).astype(np.float32))


# ---- shape


def _density() -> Floats:
    """Texels per metre along each span of PROFILE, relative."""
    density = np.full(len(PROFILE) - 1, 0.33)
    density[OUTSIDE[0]:OUTSIDE[1]] = 1.0
    return density


def _resample(points: Floats, count: int, density: Floats) -> tuple[Floats, Floats]:
    """``count`` + 1 points of the Catmull-Rom curve through ``points``, and their place 0..1 in texels."""
    padded = np.vstack([2 * points[0] - points[1], points, 2 * points[-1] - points[-2]])
    t = np.linspace(0, 1, 64, endpoint=False)[:, None]
    spans = []
    for a, b, c, d in zip(padded, padded[1:], padded[2:], padded[3:], strict=False):
        spans.append(0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3))
    curve = np.vstack([*spans, points[-1:]])
    curve[:, 0] = np.maximum(curve[:, 0], 0.01)
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1) * np.repeat(density, 64)
    place = np.concatenate([[0.0], np.cumsum(steps)])
    place /= place[-1]
    at = np.linspace(0, 1, count + 1)
    return np.stack([np.interp(at, place, curve[:, k]) for k in range(2)], 1), at


def _lathe(profile: Floats, turn: Floats) -> Floats:
    """Points of a profile's (radius, height) turned about Z."""
    angle = 2 * np.pi * turn
    return np.stack([profile[:, 0] * np.cos(angle), profile[:, 0] * np.sin(angle), profile[:, 1]], -1)


def _handle(at: float, island: Island) -> QuadMesh:
    """A tube along HANDLE, which leaves the body at ``at`` of a turn."""
    path, along = _resample(HANDLE, 40, np.ones(len(HANDLE) - 1))
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    angle = 2 * np.pi * at
    radial, side = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
    plane = np.stack([radial, np.array([0.0, 0.0, 1.0])])  # the handle's own plane, spanned by outwards and up
    centre, across = path @ plane, np.stack([tangent[:, 1], -tangent[:, 0]], -1) @ plane

    def point(turn: Floats, i: Indices) -> Floats:
        phi = 2 * np.pi * turn[:, None]
        on_tube: Floats = centre[i] + HANDLE_RADIUS * (np.cos(phi) * across[i] + np.sin(phi) * side)
        return on_tube

    return _strip(point, np.linspace(0, 1, 25), along, (island[2], island[3], island[0], island[1]), swap=True)


def _strip(
    point: Callable[[Floats, Indices], Floats], turn: Floats, along: Floats, island: Island, *, swap: bool = False,
) -> QuadMesh:
    """A closed tube of quads: ``point(turn, ring)``; the first and last column share vertices, not UVs."""
    around, rings = len(turn) - 1, len(along)
    ring, step = np.divmod(np.arange(rings * around), around)
    vertices = point(turn[step], ring)
    i, j = np.divmod(np.arange((rings - 1) * around), around)
    corner = [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)]
    quads = np.stack([a * around + b % around for a, b in corner], -1)
    left, right, bottom, top = island
    uvs = np.stack([
        np.stack([left + (right - left) * turn[b], bottom + (top - bottom) * along[a]], -1) for a, b in corner], 1)
    if swap:
        uvs = uvs[..., ::-1]
    return QuadMesh(vertices.astype(np.float32), quads.astype(np.int32), uvs.astype(np.float32))


def _join(parts: list[QuadMesh]) -> QuadMesh:
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return QuadMesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.quads + offset for part, offset in zip(parts, offsets, strict=True)]).astype(np.int32),
        np.concatenate([part.uvs for part in parts]))


# ---- paint


def _local(u: Floats, v: Floats, island: Island) -> tuple[Floats, Floats]:
    """UV to the island's own 0..1; beyond its border the paint goes on, so padding shows no seam."""
    left, right, bottom, top = island
    return (u - left) / (right - left), np.clip((v - bottom) / (top - bottom), 0, 1)


def _waves(a: Floats, s: Floats, seed: int, count: int = 7) -> Floats:
    """Smooth noise of mean 0 and deviation 1, periodic in ``a``."""
    rng = np.random.default_rng(seed)
    total = np.zeros_like(a)
    for _ in range(count):
        k, m, phase = int(rng.integers(-6, 7)), rng.uniform(-5, 5), rng.uniform(0, 1)
        total += np.cos(2 * np.pi * (k * a + m * s + phase))
    scaled: Floats = total / np.sqrt(count / 2)
    return scaled


def _layer(
    color: Floats, rough: Floats, mask: Bool, paint: Floats | tuple[float, ...], roughness: Floats | float,
) -> None:
    """Lay a paint over what is there, where ``mask`` is."""
    color[mask] = np.broadcast_to(paint, color.shape)[mask]
    rough[mask] = np.broadcast_to(roughness, rough.shape)[mask]


def _paint_body(a: Floats, s: Floats) -> tuple[Floats, Floats]:
    """Matte clay below, a glaze that ran down over it, a painted band, a fluted neck."""
    cloud = _waves(a, s, 3)
    color = np.array(CLAY) * (1 + 0.12 * cloud + 0.05 * _waves(8 * a, 9 * s, 5))[..., None]
    rough = 0.70 + 0.04 * cloud
    drips = sum(h * np.maximum(0, np.cos(2 * np.pi * (k * a + p))) ** 6
                for h, k, p in ((0.05, 5, 0.1), (0.04, 8, 0.4), (0.06, 3, 0.8)))
    above = s - (0.345 - drips)  # how far above the edge of the glaze
    pool = np.exp(-np.maximum(above, 0) / 0.02)[..., None]  # it is thicker, so darker, where it ran to
    glaze = (1 - pool) * np.array(TEAL) * (1 + 0.15 * _waves(a, s, 7))[..., None] + pool * np.array(COBALT)
    _layer(color, rough, above > 0, glaze, 0.33 + 0.05 * _waves(a, s, 11))
    y = (s - 0.50) / 0.062
    _layer(color, rough, abs(y) < 1.25, OCHRE, 0.26)
    _layer(color, rough, abs(y) < 1.10, CREAM, 0.50 + 0.06 * np.cos(2 * np.pi * 3 * a))
    x = (12 * a) % 1 - 0.5
    radius, angle = np.hypot(1.6 * x, 0.8 * y), np.arctan2(0.8 * y, 1.6 * x)
    _layer(color, rough, radius < 0.50 + 0.22 * np.cos(6 * angle), COBALT, 0.38)
    _layer(color, rough, radius < 0.17, OCHRE, 0.26)
    _layer(color, rough, (abs(abs(x) - 0.5) < 0.03) & (abs(y) < 1.1), COBALT, 0.38)
    flutes = (np.sin(2 * np.pi * 20 * a) > 0.2) & (s > 0.695) & (s < 0.810)
    _layer(color, rough, flutes, CREAM, 0.45)
    _layer(color, rough, (s > 0.840) & (s < 0.905), OCHRE, 0.26 + 1.5 * (s - 0.840))
    for place, radius in ROOTS:
        for at in HANDLE_TURNS:
            across, along = 2 * np.pi * radius * ((a - at + 0.5) % 1 - 0.5), METRES * (s - place)
            off = np.hypot(across, along)
            _layer(color, rough, off < 0.135, OCHRE, 0.26)
            _layer(color, rough, off < 0.120, COBALT, 0.38)
    return color, rough


def _paint_handle(a: Floats, s: Floats) -> tuple[Floats, Floats]:
    """Cobalt that dulls along the handle, with a cream spiral where it shows."""
    color = np.broadcast_to(np.array(COBALT), (*a.shape, 3)) * (1 + 0.2 * _waves(a, s, 13))[..., None]
    rough = 0.30 + 0.25 * np.clip(a, 0, 1)
    _layer(color, rough, ((4 * a + s) % 1 < 0.3) & (a > SPIRAL[0]) & (a < SPIRAL[1]), CREAM, 0.5)
    return color, rough
