"""How a camera maps places to its picture on the device: a matrix and, where there is one, a lens.

The twin in float64 is core/projection.py; the shaders' part is shaders/include/projection.glsl.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...core.data import F32, F64, Camera
from ...core.lens import Lens
from ...core.projection import FLIP, lens_axes
from ...core.triangle_bundles import Bundles

AT_ONCE = 1 << 10  # triangles that are bent together: what a processor's cache holds


@dataclass(frozen=True)
class Projection:
    """World to clip space."""

    clip: F64  # (4, 4) from the world or, with a lens, from where it bends places (`Lens.bent`)
    lens: Lens | None = None
    axes: F64 = field(default_factory=lambda: np.eye(4))  # (4, 4) world to the lens's axes

    @property
    def uniforms(self) -> dict[str, object]:
        """Of include/projection.glsl."""
        return {"u_clip": column_major(self.clip), **(lens_uniforms(self.lens, self.axes) if self.lens else {})}

    @property
    def defines(self) -> dict[str, str]:
        """Of every program that includes it."""
        return lens_defines(self.lens)


def lens_uniforms(lens: Lens, axes: F64) -> dict[str, object]:
    """Of include/projection.glsl but ``u_clip``."""
    return {"u_to_lens": column_major(axes), "u_radial": lens.radial, "u_tangential": lens.tangential,
            "u_fisheye": lens.fisheye, "u_lens_reach": min(lens.reach, 1e30)}


def lens_defines(lens: Lens | None) -> dict[str, str]:
    """LENS, where there is one: programs for cameras without one do not know of lenses."""
    return {"LENS": "1"} if lens is not None else {}


def projection_of(camera: Camera, shown: Sequence[Bundles]) -> Projection:
    """The camera's, near and far fitted to what it is to show."""
    axes = lens_axes(camera) if camera.lens is not None else np.eye(4)
    return Projection(clip_matrix(camera, shown), camera.lens, axes)


def boxed(camera: Camera, positions: F32) -> F32:
    """What the matrix of a camera with a lens maps, of triangles (T, 3, 3) that the lens reaches."""
    assert camera.lens is not None
    axes, found = lens_axes(camera), np.empty(positions.shape, np.float32)
    for first in range(0, len(found), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        found[part] = camera.lens.bent(positions[part] @ axes[:3, :3].T + axes[:3, 3])
    return found


def clip_matrix(camera: Camera, shown: Sequence[Bundles]) -> F64:
    """World to clip space, near and far fitted around what is in front of the camera.

    The camera's own clip range would waste depth precision (0.1 m to 1 km by default).  With a lens from where that
    bends places.
    """
    depth = np.concatenate([_depths(camera, bundles) for bundles in shown if len(bundles.triangles)])
    far = max(float(depth.max()) * 1.01, 1e-3)
    if camera.orthographic:
        near, far = max(float(depth.min()) - 0.01 * far - 1e-3, 0.0), far + 1e-3  # what lies behind is not seen
        row = [0.0, 0.0, -2.0 / (far - near), -(far + near) / (far - near)]
    else:
        near = max(float(depth.min()) * 0.99, 1e-3 * far)
        row = [0.0, 0.0, -(far + near) / (far - near), -2.0 * far * near / (far - near)]
    projection = camera.projection.copy()
    projection[2] = row
    return np.asarray(projection @ (camera.world_to_camera if camera.lens is None else FLIP), dtype=np.float64)


def _depths(camera: Camera, bundles: Bundles) -> F64:
    """(N,) of which the least and the greatest bound those of the triangles: depths, a fisheye's distances."""
    if camera.lens is not None and camera.lens.fisheye:
        away = np.linalg.norm(bundles.centers - camera.position, axis=1)
        triangles = bundles.extremes(away - 3 * bundles.radii, away + bundles.radii)
        middle = triangles.mean(axis=1)
        radius = np.linalg.norm(triangles - middle[:, None], axis=2).max(axis=1)  # corners may be farther than a side
        return np.concatenate([np.linalg.norm(triangles.reshape(-1, 3) - camera.position, axis=1),
                               np.linalg.norm(middle - camera.position, axis=1) - radius])
    row = -camera.world_to_camera[2]
    center, half = bundles.centers @ row[:3] + row[3], 0.5 * (bundles.high - bundles.low) @ np.abs(row[:3])
    half += 1e-9 * (np.abs(center) + half)  # rounding
    return np.asarray(bundles.extremes(center - half, center + half).reshape(-1, 3) @ row[:3] + row[3])


def column_major(matrix: F32 | F64) -> bytes:
    """A matrix as a GL uniform's bytes."""
    return np.ascontiguousarray(np.asarray(matrix).T, dtype=np.float32).tobytes()
