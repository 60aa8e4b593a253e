"""A small ray tracer: mirror balls before a wall, and a lamp, through a lens with distortion.

Axes are a camera's: x to the right, y down, z forward; row 0 of a picture is its upper one.  Nothing of the add-on is
used but the record of the lens: pixels go to rays by a fixed point of Brown's formula, written here again.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from irpso_addon.core.lens import Lens

SAMPLES = 3  # across a pixel


@dataclass(frozen=True)
class MirrorBall:
    centre: tuple[float, float, float]  # metres
    radius: float


@dataclass(frozen=True)
class Lamp:
    """A disc that faces the camera's neighbourhood; its middle is the lamp's position."""

    position: tuple[float, float, float]
    radius: float = 0.03
    radiance: float = 200.0


def rays(lens: Lens, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Unit directions (..., 3) of pixel coordinates."""
    k1, k2, k3, k4 = lens.radial
    p1, p2 = lens.tangential
    goal_x, goal_y = (x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy
    u, v = goal_x, goal_y
    for _ in range(15):
        s = u * u + v * v
        radial = 1 + k1 * s + k2 * s ** 2 + k3 * s ** 3 + k4 * s ** 4
        u, v = ((goal_x - 2 * p1 * u * v - p2 * (s + 2 * u * u)) / radial,
                (goal_y - p1 * (s + 2 * v * v) - 2 * p2 * u * v) / radial)
    found = np.stack([u, v, np.ones_like(u)], -1)
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def picture(lens: Lens, balls: list[MirrorBall], lamps: list[Lamp], noise: float = 0.003, clip: float = 1.0,
            seed: int = 0, plain: tuple[float, float] | None = None) -> np.ndarray:
    """(h, w, 3) linear: antialiased by a box of SAMPLES x SAMPLES, noise added, clipped at 0 and ``clip``.

    ``plain``: half the width of a bright backdrop and its distance in metres, in place of the wall and the table.
    """
    total = sum(_radiance(directions, room, balls, lamps, plain)
                for directions, room in zip(_sights(lens), _rooms(lens, plain), strict=True))
    shown = total / SAMPLES ** 2
    random = np.random.default_rng(seed)
    return np.clip(shown[..., None] * (1.0, 0.9, 0.8) + random.normal(0, noise, (*shown.shape, 3)), 0, clip)


@functools.cache
def _sights(lens: Lens) -> tuple[np.ndarray, ...]:
    """Unit directions (h, w, 3) of each sample of every pixel."""
    x, y = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
    at = (np.arange(SAMPLES) + 0.5) / SAMPLES
    return tuple(rays(lens, x + i, y + j) for i in at for j in at)


@functools.cache
def _rooms(lens: Lens, plain: tuple[float, float] | None) -> tuple[np.ndarray, ...]:
    """What `_sights` see without balls and lamps."""
    return tuple(_room(np.zeros(3), directions, plain) for directions in _sights(lens))


def _radiance(directions: np.ndarray, room: np.ndarray, balls: list[MirrorBall], lamps: list[Lamp],
              plain: tuple[float, float] | None) -> np.ndarray:
    shown = _with_lamps(room, np.zeros(3), directions, lamps)
    free = np.ones(shown.shape, bool)
    for ball in balls:  # they do not mirror one another
        centre = np.array(ball.centre)
        along = directions @ centre
        root = along ** 2 - centre @ centre + ball.radius ** 2
        hit = (root > 0) & free
        sight = directions[hit]
        point = sight * (along[hit] - np.sqrt(root[hit]))[:, None]
        normal = (point - centre) / ball.radius
        mirrored = sight - 2 * (sight * normal).sum(-1)[:, None] * normal
        shown[hit] = 0.6 * _with_lamps(_room(point, mirrored, plain), point, mirrored, lamps)
        free &= ~hit
    return shown


def _with_lamps(room: np.ndarray, origins: np.ndarray, directions: np.ndarray, lamps: list[Lamp]) -> np.ndarray:
    """Radiance of the lamps and of the room behind them."""
    shown = room.copy()
    for lamp in lamps:
        position = np.array(lamp.position)
        facing = position / -np.linalg.norm(position)  # towards the camera
        with np.errstate(all="ignore"):
            t = ((position - origins) @ facing) / (directions @ facing)
            off = np.linalg.norm(origins + t[..., None] * directions - position, axis=-1)
        shown = np.where((t > 1e-6) & (off < lamp.radius), lamp.radiance, shown)
    return shown


def _room(origins: np.ndarray, directions: np.ndarray, plain: tuple[float, float] | None) -> np.ndarray:
    """A patterned wall 3 m ahead and a table, or a plain backdrop; a dim room behind the camera."""
    with np.errstate(all="ignore"):
        far = 3.0 if plain is None else plain[1]
        wall = origins + ((far - origins[..., 2]) / directions[..., 2])[..., None] * directions
        table = origins + ((0.4 - origins[..., 1]) / directions[..., 1])[..., None] * directions
    ahead, below = directions[..., 2] > 1e-3, directions[..., 1] > 1e-3
    on_wall = 0.15 + 0.05 * np.sin(7 * wall[..., 0]) * np.cos(9 * wall[..., 1]) + 0.03 * np.sin(31 * wall[..., 0])
    on_table = 0.05 + 0.02 * np.sign(np.sin(15 * table[..., 0]) * np.sin(15 * table[..., 2]))
    room = 0.01 + 0.008 * np.sin(3 * directions[..., 0]) * np.sin(4 * directions[..., 1])
    if plain is not None:
        backdrop = ahead & (np.abs(wall[..., :2]) < plain[0]).all(-1)
        return np.where(backdrop, 0.5, room)
    nearer = below & (~ahead | (table[..., 2] < 3.0))
    return np.where(nearer, on_table, np.where(ahead, on_wall, room))
