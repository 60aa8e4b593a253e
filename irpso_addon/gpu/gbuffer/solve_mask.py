"""The part of the texels that a solve changes, and grids that show nothing else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...core.data import F32, Bool
from ..device.context import Device, Inputs
from ..device.occupied_cells import OccupiedCells
from .gbuffer import GBufferMaps


@dataclass(frozen=True)
class SolveMask:
    """Which texels are solved."""

    weight: F32  # (n, n) of the new result: 1 in the region, falling to 0 around it; 0 where not covered
    whole: bool  # nothing is left out

    @property
    def solved(self) -> Bool:
        """(n, n) texels to solve."""
        return np.asarray(self.weight > 0)

    def grid(self, device: Device, whole: GBufferMaps) -> GBufferMaps:
        """The texel grid as if nothing but the part were covered.  Takes the place of ``whole``, which it releases."""
        if self.whole:
            return whole
        position = device.read(whole.position) * self.solved[..., None]
        whole.release_position()
        texture = device.texture(position.shape[1], position.shape[0], data=position)
        return replace(whole, position=texture, cells=OccupiedCells(device, texture))

    def pixels(self, device: Device, maps: GBufferMaps) -> GBufferMaps:
        """A camera's pixel grid as if it showed nothing but the part; takes the place of ``maps``."""
        if self.whole:
            return maps
        h, w = self.weight.shape
        position = device.texture(*maps.position.size)
        with device.scope(), device.target([position], clear=True) as target:
            weight = device.texture(w, h, 1, self.weight)
            device.draw("gbuffer/shown.frag", target, Inputs({
                "u_position": maps.position, "u_uv": maps.uv, "u_part": weight}), cells=maps.cells)
        maps.release_position()
        return replace(maps, position=position, cells=OccupiedCells(device, position))
