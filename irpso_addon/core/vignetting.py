"""What a lens, or a flash, lets through towards the edges of a picture: a power of the cosine to the camera's axis.

The power 4 is that of a thin lens in front of a flat sensor (Reiss, J. Opt. Soc. Am. 35, 1945); what a camera's own
profile has evened out has the power 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .data import F32, F64, Camera
from .projection import rays_of

NODES = 192  # of the picture's width and height, between which the cosine is interpolated
LEAST_COSINE = 1e-3
ROWS = 256  # that are brightened at a time


def brightened(rgb: F32, camera: Camera, power: float) -> F32:
    """(h, w, 3) a picture divided by cos^power, row 0 at the bottom.  An orthographic camera changes nothing."""
    height, width = rgb.shape[:2]
    if power == 0.0 or camera.orthographic or not height:
        return rgb
    nodes = log_cosines(camera, (width, height))
    across, result = _places(width), np.empty_like(rgb)
    for first in range(0, height, ROWS):
        rows = slice(first, min(first + ROWS, height))
        at = _between(nodes, _places(height)[rows])
        log = _between(at.T, across).T
        result[rows] = rgb[rows] * np.exp(-power * log).astype(np.float32)[..., None]
    return result


def log_cosines(camera: Camera, size: tuple[int, int]) -> F64:
    """(NODES + 1, NODES + 1) logarithm of the cosine at nodes from the lower left to the upper right corner."""
    x, y = np.meshgrid(np.linspace(0, size[0], NODES + 1), np.linspace(0, size[1], NODES + 1))
    _, direction = rays_of(camera, np.stack([x.ravel(), y.ravel()], -1), size)
    return log_cosine(camera, direction).reshape(x.shape)


def log_cosine(camera: Camera, direction: F64) -> F64:
    """(N,) of directions (N, 3) from the camera, of any length; 0 where they are not known."""
    if camera.orthographic:
        return np.zeros(len(direction))
    cosine = direction @ camera.forward / np.linalg.norm(direction, axis=-1)
    return np.asarray(np.log(np.maximum(np.nan_to_num(cosine, nan=1.0), LEAST_COSINE)))


def corner_stops(cameras: Sequence[Camera], power: float) -> float:
    """EV by which the corners of the widest picture are darker than its middle."""
    least = min((float(log_cosines(camera, (1, 1)).min()) for camera in cameras if not camera.orthographic),
                default=0.0)
    return -power * least / math.log(2)


def _places(count: int) -> F64:
    """Of pixels' centres, in nodes."""
    return np.asarray((np.arange(count) + 0.5) * (NODES / count))


def _between(nodes: F64, places: F64) -> F64:
    """(len(places), n) linear between rows."""
    first = np.minimum(places.astype(np.int64), len(nodes) - 2)
    part = (places - first)[:, None]
    return np.asarray(nodes[first] * (1 - part) + nodes[first + 1] * part)
