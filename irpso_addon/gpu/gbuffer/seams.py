"""Which of a camera's pixels show more than one UV island, or two stretches of surface."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

from ...core.data import Camera
from ..device.context import Device, Inputs
from .gbuffer import GBufferMaps, MeshBuffer, Occluders
from .projection import Projection, projection_of

CORNER = 0.44  # of a pixel's footprint from its centre: a corner, less what the mesh's own rounding may be
POINT = 0.25  # pixels: a footprint below it mixes nothing


def mark_seams(
    device: Device, mesh: MeshBuffer, occluders: Occluders, camera: Camera, maps: GBufferMaps, footprint: float,
) -> None:
    """Lower the coverage in ``maps.position`` of pixels one of whose corners shows what their centre does not tell.

    That is another place on the texel grid than its slopes there say.
    """
    if footprint < POINT:
        return
    width, height = size = maps.position.size
    projection = projection_of(camera, [mesh.bundles, occluders.bundles])
    with device.scope():
        seen = device.texture(width, height, 1)
        for x, y in product((-CORNER * footprint, CORNER * footprint), repeat=2):
            moved = _moved(projection, x / width, y / height)
            with device.target([seen], device.depth_map(*size)) as target, device.keeping_nearest():
                target.clear(red=1.0, depth=1.0)  # beside the mesh a picture has nothing that mixes in
                with mesh.through(camera, size) as drawn:
                    drawn.draw_told(target, moved, maps, (x, y))
                with occluders.through(camera, size) as others:
                    others.draw(target, "gbuffer/occluder.frag", moved, {"u_depth_plane": (0.0, 0.0, 0.0, 0.0)})
            with device.target([maps.position]) as target, device.adding():
                device.draw("gbuffer/seam.frag", target, Inputs({"u_told": seen}), cells=maps.cells)


def _moved(projection: Projection, x: float, y: float) -> Projection:
    """The projection that shows at pixels' centres what lies so far from them, in widths and heights of the picture."""
    clip = projection.clip.copy()
    clip[0] -= 2 * x * clip[3]
    clip[1] -= 2 * y * clip[3]
    return replace(projection, clip=clip)
