"""Emitters of simple shapes."""

from __future__ import annotations

import numpy as np

from irpso_addon.core.data import Emitter

WHITE = (1.0, 1.0, 1.0)


def rectangle(center, u, v, radiance=WHITE, name: str = "Panel", both_sides: bool = True) -> Emitter:
    """Of half extents u and v; its front is where u x v points."""
    center, u, v = (np.asarray(x, np.float64) for x in (center, u, v))
    a, b, c, d = center - u - v, center + u - v, center + u + v, center - u + v
    return emitter([(a, b, c), (a, c, d)], radiance, name, both_sides)


def ball(center, radius: float, radiance=WHITE, name: str = "Bulb", rings: int = 48) -> Emitter:
    """A closed sphere of flat triangles."""
    theta, phi = np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1)
    points = np.stack([np.sin(theta)[:, None] * np.cos(phi), np.sin(theta)[:, None] * np.sin(phi),
                       np.cos(theta)[:, None] + 0 * phi], -1) * radius + np.asarray(center)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    triangles = np.concatenate([np.stack([a, b, c], -2)[:-1], np.stack([a, c, d], -2)[1:]])
    return emitter(triangles.reshape(-1, 3, 3), radiance, name, False)


def emitter(triangles, radiance=WHITE, name: str = "Glow", both_sides: bool = True) -> Emitter:
    found = np.array(triangles, np.float32)
    return Emitter(name, found, np.broadcast_to(np.asarray(radiance, np.float32), (len(found), 3)).copy(), both_sides)
