"""What share of each pixel an object covers: the outline that registration compares with the pictures'.

Pixels' centres alone are not enough. Where edges run through them, as on a mesh with a vertex at each pixel of an
orthographic camera, OpenGL counts a centre on a left edge as covered and one on a right edge as not covered, and so
with lower and upper edges: the outline lies half a pixel off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.checks.mended_cameras import moved
from ...core.data import F32, Camera
from ..device.context import Device
from ..device.draw_budget import Rectangle
from .gbuffer import MeshBuffer, Occluders
from .projection import projection_of

LEAST_WIDTH = 0.125  # pixels: OpenGL has corners at 1/256 of a pixel, and the points must lie beside them
# Where a pixel is looked at, in its widths from its centre: each row and column of a 4 x 4 grid once, so that an edge
# along the pixels shows in steps of a quarter; each point with its mirror image, so that no side is preferred.
POINTS = ((-0.375, -0.125), (-0.125, 0.375), (0.125, -0.375), (0.375, 0.125))


@dataclass(frozen=True)
class DrawnOutline:
    """Draws the outlines of one object behind others."""

    device: Device
    mesh: MeshBuffer
    occluders: F32  # (T, 3, 3) triangles of the other objects
    footprint: float  # width in pixels over which a pixel of the pictures averages

    def shares(self, camera: Camera, size: tuple[int, int], part: Rectangle) -> F32:
        """(h, w) 0..1 of the pixels in a part of a camera's picture of this size."""
        width = max(self.footprint, LEAST_WIDTH)
        device, total = self.device, np.zeros((part[3], part[2]), np.float32)
        with (device.scope(), self.mesh.through(camera, size) as drawn,
              Occluders(device, self.occluders).through(camera, size) as others):
            seen, depth = device.texture(*size, 1), device.depth_map(*size)
            for x, y in POINTS:
                beside = moved(camera, (width * x, width * y), size)
                projection = projection_of(beside, [self.mesh.mesh.positions, self.occluders])
                with device.target([seen], depth) as target, device.keeping_nearest():
                    target.clear(depth=1.0)
                    drawn.draw_positions(target, "gbuffer/count.frag", projection, {})
                    others.draw(target, "gbuffer/occluder.frag", projection, {"u_depth_plane": (0.0, 0.0, 0.0, 0.0)})
                total += device.read(seen, part)[..., 0]
        return np.asarray(total / len(POINTS), np.float32)
