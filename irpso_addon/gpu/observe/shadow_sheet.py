"""Shadow maps side by side in one texture."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import nullcontext

import moderngl

from ..device.context import Device
from ..gbuffer.projection import Projection
from .visibility import FAR_TEXEL, SHADOW, Frustum, LightVisibility

COLUMNS = 8  # maps side by side in a sheet, and rows of them


def draw_sheet(
    device: Device, visibility: LightVisibility, frusta: Iterable[Frustum], side: int, fronts_alone: bool = False,
) -> moderngl.Texture:
    """R16F: the depth of what is nearest in each of COLUMNS^2 maps of ``side`` texels; belongs to the scope.

    ``fronts_alone``: the mesh is closed, and seen from outside.
    """
    sheet = device.texture(side * COLUMNS, side * COLUMNS, 1, dtype="f2")
    with device.target([sheet]) as target, device.keeping_least():
        target.clear(red=FAR_TEXEL)
        for n, frustum in enumerate(frusta):
            region = side * (n % COLUMNS), side * (n // COLUMNS), side, side
            projection, uniforms = Projection(frustum.clip), {"u_depth_plane": frustum.plane}
            with device.leaving_out("back") if fronts_alone else nullcontext():
                visibility.mesh.draw_positions(target, SHADOW, projection, uniforms, region)
            visibility.occluders.draw(target, SHADOW, projection, uniforms, region)
    return sheet
