"""Where a lamp is, by the rays that chrome balls reflect to it, and how far the rays disagree.

All rays of a lamp share one set of axes: those of the camera, or the world's if several cameras took the pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..data import F64
from ..errors import BadInput
from .ball_highlight import Ray

# Degrees that a ray is off at best: two rays that happen to meet closely prove no smaller error.
RAY_ERROR = 0.2
DETERMINED = 1 / 3  # of the distance: a position with a larger standard error is none
CONTRADICTING = 3.0  # degrees of scatter without a position: a circle or a radius is wrong, the lamp is not far
LIKELY = 2.0  # standard errors within which a distance is thought possible


@dataclass(frozen=True)
class LampPosition:
    """What several rays say of a lamp.  Lengths in metres unless the name says millimetres."""

    position: F64 | None  # (3,); None where the rays are too near to parallel
    standard_error: float  # of the position along its least certain direction; infinite without a position
    middle: F64  # (3,) mean of the rays' origins
    direction: F64  # (3,) unit: from the middle to the position, or the rays' mean direction
    distance: float  # from the middle: of the position, or the least that the rays allow
    scatter_degrees: float  # root mean square angle between the rays and the position (without one: the direction)
    scatter_millimetres: float | None  # root mean square distance of the position from the rays

    def summary(self, name: str) -> str:
        """One line about the lamp ``name``."""
        if self.position is None:
            x, y, z = self.direction
            if self.scatter_degrees > CONTRADICTING:
                return (f"{name}: the rays of the balls contradict each other, and differ from their mean ({x:.3f}, "
                        f"{y:.3f}, {z:.3f}) by {self.scatter_degrees:.2f} degrees; check each ball's circle and radius")
            return (f"{name}: the rays are too nearly parallel for a position; the lamp is at least "
                    f"{self.distance:.2f} m away in the direction ({x:.3f}, {y:.3f}, {z:.3f}), "
                    f"and the rays differ from it by {self.scatter_degrees:.2f} degrees")
        return (f"{name}: {self.distance:.3f} m from the balls, standard error {1000 * self.standard_error:.0f} mm; "
                f"the rays miss it by {self.scatter_degrees:.2f} degrees, {self.scatter_millimetres:.1f} mm")


def lamp_position(rays: Sequence[Ray], name: str = "lamp") -> LampPosition:
    """The point whose directions from the rays' origins differ least from the rays, by least squares of the angles.

    The standard error follows from the scatter, which is taken for at least RAY_ERROR.  Raises BadInput (about
    ``name``) for fewer than two rays, and for rays that part by more than the scatter.
    """
    if len(rays) < 2:
        raise BadInput(f"{name}: one ray gives a direction only; for a position, use two balls or move the ball")
    origins = np.array([ray.origin for ray in rays])
    directions = np.array([ray.direction for ray in rays])
    found = _nearest(origins, directions)
    if found is not None:
        position, error = found
        middle = origins.mean(0)
        distance = float(np.linalg.norm(position - middle))
        if error < DETERMINED * distance:
            angles, misses = _scatter(position, origins, directions)
            return LampPosition(position, error, middle, (position - middle) / distance, distance,
                                float(np.degrees(_rms(angles))), 1000 * _rms(misses))
    return _distant(origins, directions, name)


def direction_scatter(directions: Sequence[F64]) -> float:
    """Mean angle in degrees between any two of the directions (3,) that several balls give for one distant lamp."""
    if len(directions) < 2:
        return 0.0
    units = np.array(directions) / np.linalg.norm(directions, axis=1, keepdims=True)
    first, second = np.triu_indices(len(units), 1)
    return float(np.degrees(_angle(units[first], units[second]).mean()))


def _nearest(origins: F64, directions: F64) -> tuple[F64, float] | None:
    """The point and its largest standard error; None where it is behind a ball or nothing holds it."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]  # what of a step is seen from the ray
    weights = np.ones(len(origins))
    for _ in range(20):  # distances turn angles into lengths, and depend on the point
        system = (across * weights[:, None, None]).sum(0)
        if np.linalg.cond(system) > 1e12:
            return None
        point = np.linalg.solve(system, np.einsum("n,nij,nj->i", weights, across, origins))
        weights = 1 / np.maximum(((point - origins) ** 2).sum(1), 1e-12)
    if (np.einsum("ni,ni->n", point - origins, directions) <= 0).any():
        return None
    angles, _ = _scatter(point, origins, directions)
    information = np.linalg.eigvalsh((across * weights[:, None, None]).sum(0))[0]
    return point, float(_ray_error(angles, 2 * len(origins) - 3) / np.sqrt(information))


def _distant(origins: F64, directions: F64, name: str) -> LampPosition:
    """Mean direction and least distance of a lamp whose rays are nearly parallel.

    To first order a ray from an origin that lies b across the mean direction turns by -b / distance: one over the
    distance follows by linear least squares.
    """
    direction = directions.mean(0)
    length = float(np.linalg.norm(direction))
    angles = _angle(directions, direction / max(length, 1e-300))
    if length < 0.5 or np.degrees(angles.max()) > 45:
        raise BadInput(f"{name}: the rays of the balls point apart; check each ball's highlight and radius")
    direction = direction / length
    middle = origins.mean(0)
    apart = origins - middle
    apart = apart - (apart @ direction)[:, None] * direction
    baseline = float((apart ** 2).sum())
    turned = directions - (directions @ direction)[:, None] * direction
    inverse = -float((apart * turned).sum()) / max(baseline, 1e-300)
    rest = turned + inverse * apart
    error = _ray_error(np.linalg.norm(rest, axis=1), 2 * len(origins) - 3) / np.sqrt(max(baseline, 1e-300))
    most = inverse + LIKELY * error
    if most <= 0:
        raise BadInput(f"{name}: the rays of the balls point apart; check each ball's highlight and radius")
    return LampPosition(None, np.inf, middle, direction, 1 / most, float(np.degrees(_rms(angles))), None)


def _scatter(point: F64, origins: F64, directions: F64) -> tuple[F64, F64]:
    """Angles in radians between the rays and the directions to ``point``, and its distances from the rays."""
    towards = point - origins
    along = np.einsum("ni,ni->n", towards, directions)
    return _angle(towards, directions), np.linalg.norm(towards - along[:, None] * directions, axis=1)


def _ray_error(angles: F64, freedom: int) -> float:
    """Radians: standard error of a ray across one direction, by angles that were left."""
    return max(float(np.sqrt((angles ** 2).sum() / freedom)), float(np.radians(RAY_ERROR)))


def _angle(first: F64, second: F64) -> F64:
    """Radians between vectors, exact for small angles too."""
    second = np.broadcast_to(second, first.shape)
    return np.arctan2(np.linalg.norm(np.cross(first, second), axis=-1), (first * second).sum(-1))


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values ** 2)))
