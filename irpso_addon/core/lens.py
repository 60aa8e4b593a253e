"""How a real lens maps directions to pixels: Brown's model and the equidistant fisheye, forwards in closed form.

Camera axes here are those of photogrammetry: x to the right, y **down**, z forward.  Pixel coordinates begin at the
picture's upper left corner; the first pixel's centre is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
LEAST_SCALE = 0.1  # where a lens's polynomial turns back, pixels show endless stretches


@dataclass(frozen=True)
class Lens:
    """Interior orientation of a camera.

    The radial and tangential terms are those of Brown (1966, "Decentering distortion of lenses") in the order of
    OpenCV's documentation: with x, y = X / Z, Y / Z and r^2 = x^2 + y^2,

        x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) + 2 p1 x y + p2 (r^2 + 2 x^2)
        y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) + p1 (r^2 + 2 y^2) + 2 p2 x y

    A fisheye (Kannala and Brandt 2006) puts x, y at the angle to the axis, in radians, along the same direction; the
    terms are the same.  Then u = cx + fx x' + skew y', v = cy + fy y'.
    """

    width: int  # pixels of the pictures that it holds for
    height: int
    fx: float  # pixels
    fy: float
    cx: float  # pixels from the left edge
    cy: float  # pixels from the upper edge
    radial: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # k1 to k4
    tangential: tuple[float, float] = (0.0, 0.0)  # p1, p2
    skew: float = 0.0  # pixels
    fisheye: bool = False

    def project(self, points: F64) -> F64:
        """Pixels (..., 2) of ``points`` (..., 3) in camera axes; NaN where the lens does not reach.

        That is behind the camera (but for a fisheye), and beyond the angle at which the polynomial turns back.
        """
        with np.errstate(all="ignore"):
            return self._pixels(self._seen(points))

    def bent(self, points: F64) -> F64:
        """Where a pinhole camera of focal length 1 shows what the lens shows of ``points``; (..., 3), NaN as `project`.

        Those are x' w, y' w, w: w is the depth or, of a fisheye, which also looks sideways, the distance.  On each ray
        the order of points stays.  `matrix` maps them to the picture.
        """
        points = np.asarray(points, np.float64)
        w = np.sqrt((points**2).sum(axis=-1)) if self.fisheye else points[..., 2]
        return np.stack([*(self._seen(points) * w), w], axis=-1)

    @property
    def matrix(self) -> F64:
        """(4, 4) OpenGL clip matrix of the lens without its distortion: of a camera that looks along -Z, y up.

        Its near and far rows are Blender's own, 0.1 m to 1 km.
        """
        matrix = np.zeros((4, 4))
        matrix[0, :3] = 2 * self.fx / self.width, -2 * self.skew / self.width, 1 - 2 * self.cx / self.width
        matrix[1, 1:3] = 2 * self.fy / self.height, 2 * self.cy / self.height - 1
        matrix[2, 2:], matrix[3, 2] = (-1.0002, -0.20002), -1
        return matrix

    def resized(self, width: int, height: int) -> Lens:
        """The same for pictures of another size."""
        x, y = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * x, skew=self.skew * x, cx=self.cx * x,
                       fy=self.fy * y, cy=self.cy * y)

    def part(self, left: float, upper: float, width: int, height: int) -> Lens:
        """Of the part of its pictures of that size whose first pixel's outer corner is at ``left`` and ``upper``."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - upper)

    def rays(self, pixels: F64) -> F64:
        """Unit directions (..., 3) in camera axes of ``pixels`` (..., 2): the inverse of `project`, by Newton's steps.

        NaN where no direction reaches the pixel.
        """
        u, v = np.moveaxis(np.asarray(pixels, np.float64), -1, 0)
        y = (v - self.cy) / self.fy
        target = np.stack([(u - self.cx - self.skew * y) / self.fx, y])
        flat = target
        with np.errstate(all="ignore"):
            for _ in range(50):  # a contraction: the tangential terms are small
                before, flat = flat, self._without_radial(target - self._tangential(flat))
                if not (np.abs(flat - before) > 1e-14).any():
                    break
            lost = ~(np.hypot(*(self._distorted(flat) - target)) * self.fx < 1e-3)
            t = np.hypot(flat[0], flat[1])
            direction = np.where(t > 0, flat / t, 0.0)
        sine, cosine = (np.sin(t), np.cos(t)) if self.fisheye else (t / np.hypot(1, t), 1 / np.hypot(1, t))
        directions = np.stack([direction[0] * sine, direction[1] * sine, cosine], axis=-1)
        directions[lost] = np.nan
        return directions

    def least_scale(self, points: F64) -> F64:
        """(...) by how much less the picture is magnified where it shows ``points`` (..., 3) than in its middle.

        Along the radius or across it, whichever is less; the tangential terms are left out.  At least LEAST_SCALE.
        """
        s = self._off_axis(*np.moveaxis(np.asarray(points, np.float64), -1, 0)) ** 2
        return np.maximum(np.minimum(self._along(s), self._across(s)), LEAST_SCALE)

    @cached_property
    def reach(self) -> float:
        """Greatest r (fisheye: angle) up to which the radial polynomial rises; beyond it, pictures would fold over."""
        k1, k2, k3, k4 = self.radial
        roots = np.roots([1.0, 3 * k1, 5 * k2, 7 * k3, 9 * k4])  # of the derivative by r, in 1 / r^2: never of degree 0
        turns = [root.real**-0.5 for root in roots if root.imag == 0 and root.real > 0]
        return float(min([np.pi if self.fisheye else np.inf, *turns]))

    @property
    def reached(self) -> float:
        """x', y' from the middle at `reach`, the tangential terms left out."""
        return float(self._radius(np.array(self.reach))[0])

    def _seen(self, points: F64) -> F64:
        """x', y' of points (..., 3); (2, ...), NaN as `project`."""
        x, y, z = np.moveaxis(np.asarray(points, np.float64), -1, 0)
        with np.errstate(all="ignore"):
            across, t = np.hypot(x, y), self._off_axis(x, y, z)
            direction = np.where(across > 0, np.stack([x, y]) / across, 0.0)
            return self._distorted(direction * np.where(t <= self.reach, t, np.nan))

    def _off_axis(self, x: F64, y: F64, z: F64) -> F64:
        """r, or a fisheye's angle."""
        with np.errstate(all="ignore"):
            across = np.hypot(x, y)
            return np.asarray(np.arctan2(across, z) if self.fisheye else np.where(z > 0, across / z, np.nan))

    def _pixels(self, flat: F64) -> F64:
        return np.stack([self.cx + self.fx * flat[0] + self.skew * flat[1], self.cy + self.fy * flat[1]], axis=-1)

    def _distorted(self, flat: F64) -> F64:
        """x', y' of x, y; (2, ...)."""
        return np.asarray(flat * self._across(flat[0] ** 2 + flat[1] ** 2) + self._tangential(flat))

    def _tangential(self, flat: F64) -> F64:
        p1, p2 = self.tangential
        x, y = flat
        s = x * x + y * y
        return np.stack([2 * p1 * x * y + p2 * (s + 2 * x * x), p1 * (s + 2 * y * y) + 2 * p2 * x * y])

    def _without_radial(self, flat: F64) -> F64:
        """The point that the radial terms move to ``flat``, not beyond `reach`.

        Newton's steps along the radius; bisection where they leave the bracket or do not shrink, as near an inflection.
        """
        along = np.hypot(flat[0], flat[1])
        low, high = np.zeros_like(along), np.minimum(np.maximum(along, 1.0), self.reach)
        while (short := (self._radius(high)[0] < along) & (high < self.reach)).any():
            high = np.where(short, np.minimum(2 * high, self.reach), high)
        t, last = np.minimum(along, high), np.full_like(along, np.inf)
        for _ in range(100):
            value, slope = self._radius(t)
            low, high = np.where(value < along, t, low), np.where(value < along, high, t)
            step = t - (value - along) / slope
            shrinks = np.abs(step - t) <= np.maximum(last / 2, 1e-14 * along)
            step = np.where(shrinks & (step >= low) & (step <= high), step, (low + high) / 2)
            last, t = np.abs(step - t), step
            if not (last > 1e-14 * along).any():
                break
        return np.asarray(np.where(along > 0, flat * (t / along), 0.0))

    def _radius(self, t: F64) -> tuple[F64, F64]:
        """Where the radial terms move radius ``t``, and the derivative."""
        s = t * t
        return t * self._across(s), self._along(s)

    def _across(self, s: F64) -> F64:
        """By how much the radial terms stretch circles of squared radius ``s``."""
        k1, k2, k3, k4 = self.radial
        return 1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))

    def _along(self, s: F64) -> F64:
        """The same of lengths along the radius: the derivative of t times `_across` by t."""
        k1, k2, k3, k4 = self.radial
        return 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))
