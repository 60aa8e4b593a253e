"""Squares of a material's texels, packed side by side: a source of their own, from which layers can be left out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import moderngl
import numpy as np

from ...core.data import F32, I32, Bool
from ...core.evaluation.sampled_texels import SampledTexels
from ...core.shading.lights import light_irradiance
from ..device.context import Device
from ..observe.observation_atlas import CameraSource, ObservationAtlas, Tile, tiles

SIDE = 16  # texels: width of a square
SQUARES = 24  # over which what differs from place to place shows
COLUMNS = 6
LEAST_SHARE = 0.25  # of a square that the material must cover
CLUSTER = 8  # texels: width of the squares whose errors are taken to be alike
MOST = 3_000_000  # lobes that the sample is read back with


@dataclass(frozen=True)
class PackedTexels:
    """The squares as a grid."""

    position: moderngl.Texture  # as of GBufferMaps
    normal: moderngl.Texture


def spread_squares(texels: Bool, seed: int) -> list[Tile]:
    """First texels of squares that show the material, spread over it as its area is."""
    h, w = texels.shape
    corners = [(x, y) for y in range(0, h, SIDE) for x in range(0, w, SIDE)]
    counts = np.array([texels[y:y + SIDE, x:x + SIDE].sum() for x, y in corners], np.float64)
    counts[counts < min(LEAST_SHARE * SIDE**2, counts.max())] = 0.0
    count = min(SQUARES, int((counts > 0).sum()))
    chosen = np.random.default_rng(seed).choice(len(corners), count, replace=False, p=counts / counts.sum())
    return [corners[i] for i in sorted(chosen)]


class MaterialSample(CameraSource):
    """The packed squares."""

    def __init__(self, device: Device, source: CameraSource, texels: Bool, squares: list[Tile]) -> None:
        """``texels``: (h, w) those of the material."""
        rows = -(-len(squares) // COLUMNS)
        position = np.zeros((rows * SIDE, min(COLUMNS, len(squares)) * SIDE, 4), np.float32)
        normal = np.zeros_like(position)
        for n, (x, y) in enumerate(squares):
            w, h = min(SIDE, texels.shape[1] - x), min(SIDE, texels.shape[0] - y)
            at = np.s_[n // COLUMNS * SIDE:n // COLUMNS * SIDE + h, n % COLUMNS * SIDE:n % COLUMNS * SIDE + w]
            position[at] = device.read(source.grid.position, (x, y, w, h))
            position[at][~texels[y:y + h, x:x + w]] = 0.0
            normal[at] = device.read(source.grid.normal, (x, y, w, h))
        height, width = position.shape[:2]
        packed = PackedTexels(device.texture(width, height, data=position), device.texture(width, height, data=normal))
        super().__init__(device, packed, source.observations, source.extent * width / source.size[0])
        self.places, self.normals = position, normal
        self.left_out: Bool = np.zeros(len(self.layers.groups), bool)

    def gather(self, atlas: ObservationAtlas, tile: Tile, colour: bool) -> Iterator[None]:
        """As of `CameraSource`, but for the layers that are left out."""
        yield from super().gather(atlas, tile, colour)
        for layer in np.flatnonzero(self.left_out):
            atlas.target.clear(viewport=atlas.block(int(layer) * (2 + self.layers.lights)))

    def clusters(self, indices: I32) -> I32:
        """Of texels, by their places in the grid: a number for each small square."""
        width = self.size[0]
        row, column = np.divmod(indices, width)
        return np.asarray(row // CLUSTER * (width // CLUSTER + 1) + column // CLUSTER, np.int32)

    def read(self, most: int) -> tuple[SampledTexels, I32]:
        """(what is observed of at most so many of its texels, (T,) their places in the grid)."""
        layers, lights, channels = self.layers, self.layers.lights, self.layers.channels
        views = [view.view for camera in self.observations.cameras for _ in range(channels) for view in camera.views]
        covered = np.flatnonzero(self.places[..., 3].ravel() > 0.5).astype(np.int32)
        most = min(most, max(MOST // (len(views) * lights), 64))
        if len(covered) > most:
            covered = covered[np.linspace(0, len(covered) - 1, most).astype(np.int32)]
        blocks = self._blocks(covered)
        first, lobes = blocks[:, :, 0].astype(np.float64), blocks[:, :, 2:].astype(np.float64)
        edge = first[..., 3].astype(int) % 2 == 1
        channel = np.array([group % channels for group in layers.groups], np.int32)
        sets = [tuple((light.name, tuple(light.power), light.matrix.tobytes()) for light in view.lights)
                for view in views]
        order = {key: n for n, key in enumerate(dict.fromkeys(sets))}
        position = self.places.reshape(-1, 4)[covered, :3].astype(np.float64)
        normal = self.normals.reshape(-1, 4)[covered, :3].astype(np.float64)
        irradiance = np.stack([
            sum((light_irradiance(light, position, normal)
                 * (light.power.mean() if channels == 1 else light.power[channel[n]]) for light in view.lights),
                np.zeros(len(covered)))
            for n, view in enumerate(views)], 1)
        return SampledTexels(
            first[..., 0], np.where(edge | (irradiance <= 0), 0.0, first[..., 1]), first[..., 2], lobes, irradiance,
            np.array([group // channels for group in layers.groups], np.int32), channel,
            np.array([order[key] for key in sets], np.int32)), covered

    def _blocks(self, texels: I32) -> F32:
        """(T, layers, blocks, 4) of the observation atlas."""
        device, count, width = self.device, self.layers.blocks, self.size[0]
        with device.scope():
            atlas = ObservationAtlas(device, self)
            w, h = atlas.tile
            grid = np.zeros((count, self.size[1], width, 4), np.float32)
            for x, y in tiles(atlas, self.places[..., 3] > 0.5):
                for _ in self.gather(atlas, (x, y), False):
                    pass
                part = device.read(atlas.texture).reshape(count, h, w, 4)
                grid[:, y:y + h, x:x + w] = part[:, :min(h, self.size[1] - y), :min(w, width - x)]
        row, column = np.divmod(texels, width)
        result = np.moveaxis(grid[:, row, column], 0, 1)
        return result.reshape(len(texels), len(self.layers.groups), 2 + self.layers.lights, 4)
