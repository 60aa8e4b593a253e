"""The outline of a chrome ball in a picture: found, or refined from a circle that the user has drawn.

A camera sees a sphere under a circular cone of rays, whatever its lens does to the outline: a direction d lies on the
cone about the axis a with half angle h where d . a = cos h, that is, d . m = 1 with m = a / cos h.  So three points of
the outline give a cone, and many give it by linear least squares.

Pictures here are linear and begin at the **top**: row 0 is the upper one, as in files, and as pixel coordinates count
in `core/lens.py`.  Camera axes are those of that file: x to the right, y down, z forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..data import F64, Bool
from ..errors import BadInput
from ..lens import Lens
from .circle_search import find_circles
from .edge_lines import highest_peak, highest_peaks, sampled, smooth

Circle = tuple[float, float, float]  # x, y, radius in pixels

Reaches = tuple[tuple[float, float], ...]

ANGLES = 360  # points of an outline that are looked at
HOW = "(Draw Circle, or X Y R of --ball)"  # a user gives a circle
ROUGH = 0.35  # of its radius: how far a drawn circle may be off
TRIALS = 1000  # cones through three edges that are tried
CONES = 3  # of them that are looked at closely
EDGES = 6  # on each line across the outline that are tried
LEAST_SUPPORT = 0.45  # of the outline that has to show: a stand may hide some
MOST_OUTSIDE = 0.02  # of the outline that may lie beyond the picture
# Steps to the outline: how far lines reach to both sides of it, as a part of the half angle, and pixels at least.
WIDE: Reaches = ((0.05, 4.0), (0.03, 4.0), (0.03, 4.0), (0.03, 4.0))
NARROW: Reaches = ((0.012, 1.25), (0.012, 1.25), (0.012, 1.25))
CLEAR = 0.15  # of the clearest edge on a line
AGREES = 0.03  # of its radius: an outline that is as close to a drawn circle as that is the one that was drawn
SAME = 0.01  # of the half angle: outlines that differ by less are one, and that of most edges is the most exact
RING = 0.15  # of the half angle: how far outside a ring that the ball mirrors its outline may lie
GROWN = (0.02, 0.04, 0.06, 0.08, 0.1, 0.12)  # of the half angle: where it is looked for
RIM = 0.6  # of the support of that ring, which the outline has at least
LEAST_RADIUS = 8.0  # pixels; a smaller ball tells no direction


@dataclass(frozen=True)
class Ball:
    """The cone of rays under which a camera sees a sphere."""

    axis: F64  # (3,) unit, camera axes: towards the ball's centre
    half_angle: float  # radians
    residual: float  # pixels, root mean square: how far the edges found lie from the outline
    support: float  # 0 to 1: the share of the outline at which edges were found, beyond what chance puts there

    def centre(self, radius: float) -> F64:
        """Centre (3,) in camera axes of a ball of this ``radius``, both in metres."""
        return np.asarray(self.axis * (radius / np.sin(self.half_angle)))

    def outline(self, lens: Lens, count: int = ANGLES) -> F64:
        """Pixels (count, 2) along the outline; NaN where the lens does not reach."""
        return lens.project(_on_cone(self.axis, np.full(count, self.half_angle)))

    def circle(self, lens: Lens) -> Circle:
        """The circle (x, y, radius in pixels) nearest to the outline: what a user drags."""
        points = self.outline(lens)
        middle = points.mean(0)
        return float(middle[0]), float(middle[1]), float(np.hypot(*(points - middle).T).mean())


def find_ball(image: F64, lens: Lens, near: Circle | None = None, name: str = "picture") -> Ball:
    """The ball's outline in ``image`` (h, w, 3) or (h, w), linear, row 0 at the top.

    Of several pictures by the fixed camera, one for each lamp, take the mean: it shows the outline best.  ``near`` is
    a rough circle, off by at most a quarter of its radius; without it, the best circle in the picture is taken.
    Raises BadInput (about ``name``) where the picture does not fit the lens, no outline is found, or it is cut off.
    """
    bright = brightness(image, lens, name)
    if near is not None:
        ball = _fitted(bright, lens, [_checked(near, name)])
        if ball is None or ball.support < LEAST_SUPPORT:
            raise BadInput(f"{name}: no ball's outline was found near the circle at ({near[0]:.0f}, {near[1]:.0f}); "
                           f"give one that is closer to the ball's outline {HOW}")
        return _whole(ball, lens, name)
    best = _fitted(bright, lens, find_circles(bright))
    if best is None or best.support < LEAST_SUPPORT:
        raise BadInput(f"{name}: no chrome ball was found; give a circle around it {HOW}")
    return _whole(best, lens, name)


def drawn_ball(lens: Lens, circle: Circle, name: str = "picture") -> Ball:
    """The ball whose outline the user has drawn as a ``circle``, where edges mislead; BadInput as in `find_ball`."""
    x, y, radius = _checked(circle, name)
    turns = np.linspace(0, 2 * np.pi, ANGLES, endpoint=False)
    rays = lens.rays(np.stack([x + radius * np.cos(turns), y + radius * np.sin(turns)], -1))
    if not np.isfinite(rays).all():
        raise BadInput(f"{name}: the lens does not reach the circle at ({x:.0f}, {y:.0f}); give one around a ball "
                       f"{HOW}")
    m = np.linalg.lstsq(rays, np.ones(ANGLES), rcond=None)[0]
    return _whole(Ball(m / np.linalg.norm(m), float(np.arccos(1 / np.linalg.norm(m))), 0.0, 1.0), lens, name)


def confirmed_ball(image: F64, lens: Lens, circle: Circle, name: str = "picture") -> tuple[Ball, bool]:
    """The ball that the user has drawn as a ``circle``, and whether the picture's edges agree with it.

    Where an outline is within AGREES of the circle, that is the ball, since it is more exact than a hand; else the
    circle itself is.  Raises BadInput as `find_ball`, but not for want of an outline.
    """
    drawn = drawn_ball(lens, circle, name)
    bright = brightness(image, lens, name)
    cone = drawn.axis, drawn.half_angle
    found = [*_candidates(bright, lens, circle), *(_settled(bright, lens, cone, reaches) for reaches in (WIDE, NARROW))]
    best = _clearest([ball for ball in found if ball is not None and ball.support >= LEAST_SUPPORT
                      and np.abs(np.subtract(ball.circle(lens), circle)).max() < AGREES * circle[2]])
    return (drawn, False) if best is None else (_whole(best, lens, name), True)


def brightness(image: F64, lens: Lens, name: str) -> F64:
    """Mean of the channels (h, w) of a picture by ``lens``; BadInput where its size is another, or nothing shows."""
    pixels = np.asarray(image, np.float64)
    if pixels.shape[:2] != (lens.height, lens.width):
        raise BadInput(f"{name}: the picture has {pixels.shape[1]} x {pixels.shape[0]} pixels and its camera "
                       f"{lens.width} x {lens.height}; choose the camera that took it")
    mean = pixels if pixels.ndim == 2 else pixels.mean(-1)
    mean = np.nan_to_num(mean, nan=0.0, posinf=0.0, neginf=0.0)
    if not mean.max() > mean.min():
        raise BadInput(f"{name}: every pixel is the same; choose a picture that shows the ball")
    return np.asarray(mean)


def _checked(near: Circle, name: str) -> Circle:
    if not (np.isfinite(near).all() and near[2] >= LEAST_RADIUS):
        raise BadInput(f"{name}: the circle's radius is {near[2]:.0f} pixels, too small for a direction; "
                       f"give a circle of at least {LEAST_RADIUS:.0f} pixels around a ball {HOW}")
    return near


def _whole(ball: Ball, lens: Lens, name: str) -> Ball:
    x, y = ball.outline(lens).T
    inside = (x >= 0) & (x <= lens.width) & (y >= 0) & (y <= lens.height)
    if 1 - inside.mean() > MOST_OUTSIDE:
        raise BadInput(f"{name}: the picture cuts off the chrome ball; choose a picture that shows all of it")
    return ball


def _fitted(bright: F64, lens: Lens, circles: Sequence[Circle]) -> Ball | None:
    """The best outline near one of the circles, and then near and close around that; None where none fits."""
    found = [ball for near in circles for ball in _candidates(bright, lens, near)]
    best = _clearest(found)
    if best is None:
        return None
    around = [_settled(bright, lens, (best.axis, (1 + grown) * best.half_angle), NARROW) for grown in GROWN]
    again = _candidates(bright, lens, best.circle(lens))
    return _clearest([*found, *again, *(ball for ball in around if ball is not None)])


def _candidates(bright: F64, lens: Lens, near: Circle) -> list[Ball]:
    """First the cones that most edges near the circle lie on, then the edges near those.

    Before a plain backdrop the rim mirrors it, and its border is clearer than the outline, some per cent further in.
    So the outermost edges are tried too, and then only what is close to them.
    """
    seen = _edges_near(bright, lens, near)
    if seen is None:
        return []
    rays, strength, axis, half = seen
    outer = np.where(_outermost(strength), strength, 0.0)
    found = [_settled(bright, lens, cone, reaches)
             for weights, reaches in ((strength, WIDE), (outer, NARROW))
             for cone in _most_agreed(rays, weights, axis, half)]
    return [ball for ball in found if ball is not None]


def _outermost(strength: F64) -> Bool:
    """Of the edges (lines, samples), the last on each line that is not much weaker than the line's clearest."""
    clear = strength > CLEAR * strength.max(1, keepdims=True)
    return np.asarray(clear & (np.cumsum(clear[:, ::-1], axis=1)[:, ::-1] == 1))


def _clearest(found: list[Ball]) -> Ball | None:
    """The best supported, unless a sharper outline is close around it.

    The border of a bounded backdrop shows again in the ball as a ring beside the rim, often clearer than the rim: there
    the ball is only somewhat darker than the backdrop.  The ring is not quite a circle, so its edges scatter more.
    """
    best = max(found, key=_score, default=None)
    if best is None:
        return None
    least = max(RIM * best.support, LEAST_SUPPORT)
    around = [ball for ball in found if ball.support > least and ball.residual < best.residual
              and 1 + SAME < ball.half_angle / best.half_angle < 1 + RING and _encloses(ball, best)]
    return max(around, key=_score, default=best)


def _score(ball: Ball) -> float:
    """Of two with like support the larger one."""
    return float(ball.support * ball.half_angle ** 0.5)


def _encloses(outer: Ball, inner: Ball) -> bool:
    """But for a little, since the inner one is mostly a fit to what is no circle."""
    apart = np.linalg.norm(outer.axis - inner.axis)  # radians: both are near each other
    return bool(apart < outer.half_angle - inner.half_angle + 0.03 * inner.half_angle)


def _settled(bright: F64, lens: Lens, cone: tuple[F64, float], reaches: Reaches = WIDE) -> Ball | None:
    for reach, pixels in reaches:
        ball = _refined(bright, lens, cone, reach, pixels)
        if ball is None:
            return None
        cone = ball.axis, ball.half_angle
    return ball


def _edges_near(bright: F64, lens: Lens, near: Circle) -> tuple[F64, F64, F64, float] | None:
    """Edges on lines across the circle, from inside out, and the circle's axis (3,) and half angle in radians.

    Rays (lines, EDGES, 3) and strengths (lines, EDGES), 0 where there is no edge.
    """
    x, y, radius = near
    turns = np.linspace(0, 2 * np.pi, ANGLES // 2, endpoint=False)
    steps = np.arange(1 - ROUGH, 1 + ROUGH, max(0.5 / radius, 1 / 200))
    lines = np.stack([np.cos(turns), np.sin(turns)], -1)[:, None] * radius * steps[None, :, None] + (x, y)
    # Highlights would drown the outline: the cube root, as in lightness.
    slopes = np.abs(np.gradient(smooth(np.cbrt(sampled(bright, lines)), 1.5), axis=1))
    at, strength = highest_peaks(slopes, EDGES)
    rays = lens.rays(np.take_along_axis(lines, at[..., None], 1))
    strength = np.where(np.isfinite(rays).all(-1), strength, 0.0)
    axis = lens.rays(np.array([x, y]))
    rim = lens.rays(np.stack([x + radius * np.cos(turns), y + radius * np.sin(turns)], -1))
    half = float(np.nanmean(np.arccos(np.clip(rim @ axis, -1, 1)))) if np.isfinite(rim).any() else np.nan
    if not np.isfinite(half) or np.count_nonzero(strength) < 12:
        return None
    return np.nan_to_num(rays), strength, axis, half


def _most_agreed(rays: F64, strength: F64, axis: F64, half: float) -> list[tuple[F64, float]]:
    """Of cones through three random edges (Fischler and Bolles 1981), some that most lines have an edge near.

    ``rays`` (lines, edges, 3) with ``strength`` (lines, edges); ``axis`` and ``half`` (radians) of the drawn circle.
    """
    random = np.random.default_rng(0)
    flat, weight = rays.reshape(-1, 3), np.sqrt(strength).ravel()
    if np.count_nonzero(weight) < 12:
        return []
    picks = random.choice(len(flat), (TRIALS, 3), p=weight / weight.sum())
    three = flat[picks]
    three = three[np.abs(np.linalg.det(three)) > 1e-4 * half ** 2]
    m = np.linalg.solve(three, np.ones((len(three), 3, 1)))[..., 0]
    length = np.linalg.norm(m, axis=1)
    axes = m / length[:, None]
    halves = np.arccos(np.clip(1 / length, 0, 1))
    near = (np.abs(halves / half - 1) < ROUGH) & (np.arccos(np.clip(axes @ axis, -1, 1)) < ROUGH * half)
    axes, halves = axes[near], halves[near]
    relative = np.sqrt(strength / np.maximum(strength.max(1, keepdims=True), 1e-12))
    scores = [np.where(np.abs(np.arccos(np.clip(rays @ a, -1, 1)) - h) < 0.01 * half, relative, 0).max(1).sum()
              for a, h in zip(axes, halves, strict=True)]
    chosen: list[tuple[F64, float]] = []
    for k in np.argsort(scores)[::-1]:
        if all(np.linalg.norm(axes[k] - a) + abs(halves[k] - h) > 0.08 * half for a, h in chosen):
            chosen.append((axes[k], float(halves[k])))
        if len(chosen) == CONES:
            break
    return chosen


def _refined(bright: F64, lens: Lens, cone: tuple[F64, float], reach: float, pixels: float) -> Ball | None:
    """The cone by the strongest edge on each line across the outline; Tukey's weights leave out what lies apart.

    Lines reach to both sides by ``reach`` of the half angle, and by ``pixels`` at least.
    """
    axis, half = cone
    per_pixel = _radians_per_pixel(lens, axis, half)
    most = max(reach * half, pixels * per_pixel)
    ends = most + 2.5 * per_pixel  # what the smoothing takes from the lines
    offsets = np.arange(-ends, ends, 0.25 * per_pixel)
    lines = lens.project(_on_cone(axis, half + offsets[:, None] + np.zeros(ANGLES)))  # (offsets, angles, 2)
    slopes = np.abs(np.gradient(smooth(sampled(bright, lines.swapaxes(0, 1)), 3.0), axis=1))
    peak, found = highest_peak(slopes)
    if np.count_nonzero(found) < 12:
        return None
    rays = _on_cone(axis, half + np.interp(peak, np.arange(len(offsets)), offsets))
    weights = found.astype(np.float64)
    for _ in range(30):
        m = np.linalg.lstsq(rays * weights[:, None] ** 0.5, weights ** 0.5, rcond=None)[0]
        length = np.linalg.norm(m)
        if not length > 1:
            return None
        half_angle = float(np.arccos(1 / length))
        misses = (np.arccos(np.clip(rays @ (m / length), -1, 1)) - half_angle) / per_pixel
        scale = max(1.4826 * float(np.median(np.abs(misses[found]))), 0.05)
        weights = found * np.clip(1 - (misses / (4.685 * scale)) ** 2, 0, None) ** 2
    near = found & (np.abs(misses) < most / per_pixel / 3)
    if not near.any():
        return None
    chance = float((found & ~near).mean()) / 2  # as dense as in the outer two thirds
    return Ball(m / length, half_angle, float(np.sqrt(np.mean(misses[near] ** 2))), float(near.mean()) - chance)


def _on_cone(axis: F64, half_angles: F64) -> F64:
    """Unit directions (..., n, 3) evenly around ``axis`` at ``half_angles`` (..., n) from it."""
    turns = np.linspace(0, 2 * np.pi, half_angles.shape[-1], endpoint=False)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    around = np.cos(turns)[:, None] * across + np.sin(turns)[:, None] * np.cross(axis, across)
    return np.asarray(np.cos(half_angles)[..., None] * axis + np.sin(half_angles)[..., None] * around)


def _radians_per_pixel(lens: Lens, axis: F64, half: float) -> float:
    """Across the outline, in the mean."""
    inner, outer = (lens.project(_on_cone(axis, np.full(ANGLES, half * f))) for f in (0.99, 1.01))
    apart = np.hypot(*(outer - inner).T)
    return 0.02 * half / float(np.nanmean(apart)) if np.isfinite(apart).any() else half
