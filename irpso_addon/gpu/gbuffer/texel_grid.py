"""A mesh on the device, and what its G-buffer over the texel grid holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.data import F32, I32, Bool, MeshArrays
from ..device.context import Device
from .gbuffer import GBufferMaps, MeshBuffer, draw_texel_grid


@dataclass(frozen=True)
class TexelGrid:
    """A mesh on the device and its G-buffer over the texel grid, drawn once and read once."""

    mesh: MeshBuffer
    maps: GBufferMaps
    position: F32  # (n, n, 3) world, metres; zero where not covered
    normal: F32  # (n, n, 3) world, unit, normal map included
    coverage: Bool  # (n, n)
    slots: I32  # (n, n) material slot; -1 where not covered


def draw_texels(device: Device, mesh: MeshArrays | MeshBuffer, size: int) -> TexelGrid:
    """The G-buffer of a mesh, ``size`` texels on a side."""
    buffer = mesh if isinstance(mesh, MeshBuffer) else MeshBuffer(device, mesh)
    maps = draw_texel_grid(device, buffer, size)
    position, normal = device.read(maps.position), device.read(maps.normal)
    coverage = position[..., 3] > 0.5
    slots = np.where(coverage, normal[..., 3].round().astype(np.int32), -1)
    return TexelGrid(buffer, maps, position[..., :3], normal[..., :3], coverage, slots)
