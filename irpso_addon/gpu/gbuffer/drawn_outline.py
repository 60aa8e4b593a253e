"""What share of each pixel an object covers: the outline that registration compares with the pictures'.

Pixels' centres alone are not enough. Where edges run through them, as on a mesh with a vertex at each pixel of an
orthographic camera, OpenGL counts a centre on a left edge as covered and one on a right edge as not covered, and so
with lower and upper edges: the outline lies half a pixel off.  A few points see an edge along the pixels in steps: a
board straight below its camera lay up to an eighth of a pixel off by four.
"""

from __future__ import annotations

from collections.abc import Sequence
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
# The same of a 32 x 32 grid, where outlines run along the pixels: steps are below what registration corrects.
MANY = tuple(((n + 0.5) / 32 - 0.5, ((13 * n + 6) % 32 + 0.5) / 32 - 0.5) for n in range(32))
MANY_WIDTH = 0.5  # pixels: least width over which so many lie beside corners
RUN = 4  # pixels to both sides over which an edge looks the same where it runs along the pixels
ALONG = 0.1  # of an outline, from which on more points are worth their time


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
        device = self.device
        with (device.scope(), self.mesh.through(camera, size) as drawn,
              Occluders(device, self.occluders).through(camera, size) as others):
            seen, depth = device.texture(*size, 1), device.depth_map(*size)

            def mean(points: Sequence[tuple[float, float]]) -> F32:
                total = np.zeros((part[3], part[2]), np.float32)
                for x, y in points:
                    beside = moved(camera, (width * x, width * y), size)
                    projection = projection_of(beside, [self.mesh.bundles, others.bundles])
                    with device.target([seen], depth) as target, device.keeping_nearest():
                        target.clear(depth=1.0)
                        drawn.draw_positions(target, "gbuffer/count.frag", projection, {})
                        others.draw(target, "gbuffer/occluder.frag", projection,
                                    {"u_depth_plane": (0.0, 0.0, 0.0, 0.0)})
                    total += device.read(seen, part)[..., 0]
                return np.asarray(total / len(points), np.float32)

            shares = mean(POINTS)
            return mean(MANY) if width >= MANY_WIDTH and _along_pixels(shares) else shares


def _along_pixels(shares: F32) -> bool:
    """Whether much of an outline, of (h, w) shares, runs along rows or columns: all of it is then off alike."""
    edges = along = 0
    for grid in (shares, shares.T):
        edge = grid[1:] != grid[:-1]
        same = (grid[:, RUN:-RUN] == grid[:, 2 * RUN:]) & (grid[:, RUN:-RUN] == grid[:, :-2 * RUN])
        edges += int(edge.sum())
        along += int((edge[:, RUN:-RUN] & same[1:] & same[:-1]).sum())
    return along > ALONG * edges
