"""Views at the texels, as arrays: what `irpso compare` judges methods by."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..core.data import F32, I32, Bool, RadianceImage, SceneData, View
from ..core.job import Progress
from ..core.predict import TexelView
from ..gpu import thread
from ..gpu.atlas import Atlas, CameraSource, Layers, tiles
from ..gpu.observe import observe
from ..gpu.surface import MeshBuffer, draw_texel_grid

Result = TypeVar("Result")


@dataclass(frozen=True)
class Grid:
    """The texel grid of a map."""

    covered: Bool  # (n, n)
    slots: I32  # (n, n) material slot; -1 where not covered


def observe_texels(
    scene: SceneData, size: int, read_image: Callable[[View], RadianceImage],
    digest: Callable[[Bool, list[TexelView]], Result],
) -> Generator[Progress, None, tuple[Grid, list[Result]]]:
    """Runs on the GL thread.  The grid, and what ``digest`` makes of each of its tiles.

    It is given the tile's covered texels (n, n) and the scene's views there, in the order of the cameras.
    """
    device = thread.device()
    mesh = MeshBuffer(device, scene.mesh)
    grid = draw_texel_grid(device, mesh, size)
    observations = yield from observe(device, scene, mesh, read_image)
    source = CameraSource(device, grid, observations)
    atlas = Atlas(device, source)
    covered = device.read(grid.position)[..., 3] > 0.5
    slots = np.where(covered, device.read(grid.normal)[..., 3].round().astype(np.int32), -1)
    found = []
    width, height = atlas.tile
    for x, y in tiles(atlas, covered):
        for _ in source.gather(atlas, (x, y), True):
            yield Progress(1.0, "observe")
        inside = np.zeros_like(covered)
        inside[y:y + height, x:x + width] = covered[y:y + height, x:x + width]
        blocks = device.read(atlas.texture).reshape(source.layers.blocks, height, width, 4)
        part = inside[y:y + height, x:x + width]
        here = blocks[:, :part.shape[0], :part.shape[1]][:, part]
        found.append(digest(inside, _views(here, source.layers)))
    for thing in (atlas, observations, grid, mesh):
        thing.release()
    return Grid(covered, slots), found


def _views(blocks: F32, layers: Layers) -> list[TexelView]:
    """Blocks (B, T, 4) of an atlas as views.  Where channels are layers of their own, three layers are one view."""
    per_layer = blocks.reshape(len(layers.groups), 2 + layers.lights, *blocks.shape[1:])
    if layers.channels == 1:
        return [_view([layer] * 3) for layer in per_layer]
    views = []
    groups = np.array(layers.groups)
    for camera in range(int(groups.max()) // 3 + 1):
        channels = [per_layer[groups == 3 * camera + channel] for channel in range(3)]
        views += [_view(list(three)) for three in zip(*channels, strict=True)]
    return views


def _view(channels: list[F32]) -> TexelView:
    """One view from its layer (2 + L, T, 4) for each of R, G and B."""
    first = np.stack([layer[0] for layer in channels])  # (3, T, 4): f, quality, cos_v, flags
    edge = np.floor(first[..., 3]).astype(int) % 2 == 1
    lobes = np.stack([layer[2:] for layer in channels])  # (3, L, T, 4)
    return TexelView(
        rgb=channels[0][1, :, :3].copy(), weight=np.where(edge, 0, first[..., 1]).T.astype(np.float32),
        cos_v=first[..., 2].max(0), lobes=np.moveaxis(lobes, 2, 0).copy())
