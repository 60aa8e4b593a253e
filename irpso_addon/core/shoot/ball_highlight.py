"""A lamp mirrored in a chrome ball: where its highlight is, and the ray from the ball towards the lamp.

Pictures have row 0 at the top; camera axes are those of `core/lens.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..data import F64, Bool
from ..errors import BadInput
from ..lens import Lens
from .chrome_ball import Ball, brightness
from .circle_search import box

INNER = 0.97  # of the half angle: closer to the outline, a pixel shows half the room
LARGEST = 0.1  # of the ball: what is larger is no lamp's highlight
CONTRAST = 2.0  # of the highlight to the brightest tenth of the ball
EQUAL = 0.5  # of the highlight: a second one of so much light might be the lamp as well
MOST_BLOBS = 8  # that are looked at closely: a noisy picture has thousands
FRINGE = 2  # pixels around the bright part that belong to the highlight


@dataclass(frozen=True)
class Ray:
    """A half line, in camera axes or any others that all rays of a lamp share."""

    origin: F64  # (3,) metres
    direction: F64  # (3,) unit


def find_highlight(image: F64, lens: Lens, ball: Ball, name: str = "picture") -> F64:
    """Pixel (2,) of the centre of the lamp's highlight on ``ball``: the centroid of its light.

    ``image`` is (h, w, 3) or (h, w), linear, row 0 at the top, lit by this lamp; the highlight may be clipped.
    Raises BadInput (about ``name``) where none stands out, or another has as much light.
    """
    bright = brightness(image, lens, name)
    corner, patch, inside = _window(bright, lens, ball, name)
    smooth = box(patch)  # a single hot pixel is no highlight
    floor, high = np.quantile(smooth[inside], [0.5, 0.9])
    top = float(smooth[inside].max())
    lit = inside & (smooth > floor + 0.5 * (top - floor))
    if not top > CONTRAST * high or lit.sum() > LARGEST * inside.sum():
        raise BadInput(f"{name}: no lamp's highlight stands out on the ball; "
                       "choose a darker exposure, or darken the room")
    brightest = sorted(_blobs(lit), key=lambda blob: -float(patch.flat[blob].sum()))[:MOST_BLOBS]
    blobs = sorted((_centroid(patch, blob) for blob in brightest), key=lambda blob: -blob[0])
    if len(blobs) > 1 and blobs[1][0] > EQUAL * blobs[0][0]:
        places = " and ".join(f"({x + corner[0]:.0f}, {y + corner[1]:.0f})" for _, x, y in blobs[:2])
        raise BadInput(f"{name}: the ball shows similar highlights at {places}; take a picture with one lamp switched "
                       "on")
    return np.array([blobs[0][1] + corner[0], blobs[0][2] + corner[1]])


def reflected_ray(ball: Ball, lens: Lens, highlight: F64, radius: float, name: str = "picture") -> Ray:
    """The ray from the ball of ``radius`` metres towards the lamp, in camera axes, by its ``highlight`` (2,).

    Raises BadInput where the highlight is not on the ball, or the radius is not positive.
    """
    if not (np.isfinite(radius) and radius > 0):
        raise BadInput(f"{name}: the chrome ball's radius is {radius:g} m; enter the radius that you measured")
    sight = lens.rays(np.asarray(highlight, np.float64))
    centre = ball.centre(radius)
    along = float(sight @ centre)
    inside = along ** 2 - float(centre @ centre) + radius ** 2
    if not inside > 0:  # also where the lens does not reach
        raise BadInput(f"{name}: the highlight at ({highlight[0]:.0f}, {highlight[1]:.0f}) is not on the ball; "
                       "drag it onto the lamp's mirror image")
    origin = sight * (along - np.sqrt(inside))
    normal = (origin - centre) / radius
    direction = sight - 2 * (sight @ normal) * normal
    return Ray(origin, direction / np.linalg.norm(direction))


def _window(bright: F64, lens: Lens, ball: Ball, name: str) -> tuple[tuple[int, int], F64, Bool]:
    """Left upper corner of the pixels around the ball, those pixels, and which of them show its inner part."""
    outline = replace(ball, half_angle=INNER * ball.half_angle).outline(lens)
    if not np.isfinite(outline).all():
        raise BadInput(f"{name}: the ball is outside the picture; find the ball again")
    left, top = np.clip(outline.min(0).astype(int) - 1, 0, (lens.width - 1, lens.height - 1))
    right, bottom = np.clip(outline.max(0).astype(int) + 2, (left + 1, top + 1), (lens.width, lens.height))
    middle = outline.mean(0)  # the outline around it in polar coordinates: rays of every pixel would take seconds
    turns, radii = np.arctan2(*(outline - middle).T[::-1]), np.hypot(*(outline - middle).T)
    x, y = np.meshgrid(np.arange(left, right) + 0.5 - middle[0], np.arange(top, bottom) + 0.5 - middle[1])
    order = np.argsort(turns)
    inside = np.hypot(x, y) < np.interp(np.arctan2(y, x), turns[order], radii[order], period=2 * np.pi)
    if not inside.any():
        raise BadInput(f"{name}: the ball is outside the picture; find the ball again")
    return (int(left), int(top)), bright[top:bottom, left:right], inside


def _blobs(lit: Bool) -> list[NDArray[np.intp]]:
    """Connected parts (of eight neighbours), each as indices into the flat array: the lowest spreads over its part."""
    places = np.flatnonzero(lit)
    number = np.full((lit.shape[0] + 2, lit.shape[1] + 2), -1)
    number[1:-1, 1:-1][lit] = np.arange(len(places))
    here = number[1:-1, 1:-1][lit]
    beside = [number[1 + down:, 1 + right:][: lit.shape[0], : lit.shape[1]][lit]
              for down, right in ((0, 1), (1, -1), (1, 0), (1, 1))]
    first = np.concatenate([here[other >= 0] for other in beside])
    second = np.concatenate([other[other >= 0] for other in beside])
    label = np.arange(len(places))
    while True:
        least = np.minimum(label[first], label[second])
        spread = label.copy()
        np.minimum.at(spread, label[first], least)  # the whole part of either end
        np.minimum.at(spread, label[second], least)
        spread = spread[spread[label]]
        if (spread == label).all():
            order = np.argsort(label, kind="stable")
            return np.split(places[order], np.flatnonzero(np.diff(label[order])) + 1)
        label = spread


def _centroid(patch: F64, blob: NDArray[np.intp]) -> tuple[float, float, float]:
    """Light of a blob, above what surrounds it, and its centre (x, y) in pixels of ``patch``.

    Scratches draw streaks from a highlight, flares draw stars.  So the light counts that lies within the largest
    circle that the blob has room for, widened by the fringe; the circle follows its centroid.
    """
    rows, columns = np.unravel_index(blob, patch.shape)
    top, left = (max(0, int(where.min()) - 3 * FRINGE) for where in (rows, columns))
    near = patch[top:rows.max() + 3 * FRINGE + 1, left:columns.max() + 3 * FRINGE + 1]
    core = np.zeros(near.shape, bool)
    core[rows - top, columns - left] = True
    whole = _grown(core, FRINGE)
    around = _grown(whole, FRINGE) & ~whole
    light = np.clip(near - (np.median(near[around]) if around.any() else 0.0), 0, None)
    reach = 0.5
    while (less := ~_grown(~core, 1)).any():
        core, reach = less, reach + 1.0
    y, x = np.indices(near.shape) + 0.5
    u, v = x[core].mean(), y[core].mean()
    for _ in range(20):
        inside = np.where(np.hypot(x - u, y - v) < reach + FRINGE, light, 0.0)
        u, v = ((inside * at).sum() / max(inside.sum(), 1e-300) for at in (x, y))
    return float(light[whole].sum()), float(u) + left, float(v) + top


def _grown(mask: Bool, steps: int) -> Bool:
    for _ in range(steps):
        mask = np.lib.stride_tricks.sliding_window_view(np.pad(mask, 1), (3, 3)).any((2, 3))
    return mask
