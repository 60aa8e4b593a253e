"""Where a camera's picture shows places of the world, and what its pixels look at, in float64; lenses included.

Pixels are counted from the picture's lower left corner; the first one's centre is (0.5, 0.5).
"""

from __future__ import annotations

import numpy as np

from .data import F64, Camera
from .lens import Lens

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's camera axes (x right, y up, z backward) and those of `Lens`


def lens_axes(camera: Camera) -> F64:
    """(4, 4) world to the camera axes of `Lens`: x right, y down, z forward."""
    return np.asarray(FLIP @ camera.world_to_camera, np.float64)


def lens_for(camera: Camera, size: tuple[int, int]) -> Lens:
    """The lens of a perspective camera for pictures of ``size`` (width, height): its own, or that of its matrix."""
    width, height = size
    if camera.lens is not None:
        return camera.lens.resized(width, height)
    p = camera.projection
    return Lens(width, height, float(p[0, 0]) * width / 2, float(p[1, 1]) * height / 2,
                float(1 - p[0, 2]) * width / 2, float(1 + p[1, 2]) * height / 2)


def pixels_of(camera: Camera, points: F64, size: tuple[int, int]) -> F64:
    """(N, 2) where a picture of ``size`` (width, height) shows points (N, 3), also beyond its edges.

    NaN for what lies behind the camera, or beyond its lens's reach.
    """
    if camera.lens is not None:
        axes = lens_axes(camera)
        at = camera.lens.project(points @ axes[:3, :3].T + axes[:3, 3]) * size / (camera.lens.width, camera.lens.height)
        return np.asarray(at * (1.0, -1.0) + (0.0, size[1]))
    clip = points @ (camera.projection @ camera.world_to_camera)[:, :3].T
    clip += (camera.projection @ camera.world_to_camera)[:, 3]
    front = clip[:, 3:] > 0
    at = (clip[:, :2] / np.where(front, clip[:, 3:], 1.0) * 0.5 + 0.5) * size
    return np.asarray(np.where(front, at, np.nan))


def rays_of(camera: Camera, pixels: F64, size: tuple[int, int]) -> tuple[F64, F64]:
    """Origins and directions (N, 3) through places (N, 2) of a picture of ``size``.

    A direction has the length 1 along the camera's axis, with a lens it is a unit vector.  NaN where no direction
    reaches the pixel.
    """
    rotation = camera.world_to_camera[:3, :3]
    if camera.lens is not None:
        lens = camera.lens
        at = (pixels * (1.0, -1.0) + (0.0, size[1])) * (lens.width, lens.height) / size
        direction = lens.rays(at) @ lens_axes(camera)[:3, :3]
        return np.broadcast_to(camera.position, direction.shape).astype(np.float64), direction
    p = camera.projection
    x, y = (pixels / size * 2 - 1).T
    flat = np.zeros_like(x)
    if camera.orthographic:
        start = np.stack([(x - p[0, 3]) / p[0, 0], (y - p[1, 3]) / p[1, 1], flat], -1)
        origin = camera.position + start @ rotation
        return origin, np.broadcast_to(camera.forward, origin.shape).astype(np.float64)
    direction = np.stack([(x + p[0, 2]) / p[0, 0], (y + p[1, 2]) / p[1, 1], flat - 1], -1) @ rotation
    return np.broadcast_to(camera.position, direction.shape).astype(np.float64), direction


def pixel_widths(camera: Camera, points: F64, height: int) -> F64:
    """(N,) metres between the rows of a picture ``height`` pixels high where it shows points (N, 3).

    On a surface across the axis or, of a fisheye, one that faces the camera; where a lens bends, by its least
    magnification.
    The twin of pixel_width in shaders/include/pixel.glsl.
    """
    width = 2 / (abs(camera.projection[1, 1]) * height)
    if camera.orthographic:
        return np.full(len(points), width)
    if camera.lens is None:
        return np.asarray(width * -(points @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]))
    axes = lens_axes(camera)
    local = points @ axes[:3, :3].T + axes[:3, 3]
    away = np.linalg.norm(local, axis=-1) if camera.lens.fisheye else local[:, 2]
    return np.asarray(width * away / camera.lens.least_scale(local))
