"""Squares of a material's texels, packed side by side: a source of their own, from which layers can be left out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import moderngl
import numpy as np

from ...core.data import F32, F64, I32, Bool
from ...core.evaluation.sampled_texels import SampledTexels
from ...core.shading.lights import light_irradiance
from ..device.context import Device
from ..observe.observation_atlas import (
    ArraySource,
    CameraSource,
    ObservationAtlas,
    ObservedTexels,
    Source,
    Tile,
    tiles,
)

SIDE = 16  # texels: width of a square
SQUARES = 24  # over which what differs from place to place shows ...
FEWEST = 10  # ... or, to bound the time, so few
LAYERS = 36  # with which a sample still has all its squares
COLUMNS = 6
LEAST_SHARE = 0.25  # of a square that the material must cover
CLUSTER = 8  # texels: width of the squares whose errors are taken to be alike
MOST = 3_000_000  # lobes that the sample is read back with


@dataclass(frozen=True)
class PackedTexels:
    """The squares as a grid."""

    position: moderngl.Texture  # as of GBufferMaps
    normal: moderngl.Texture


def spread_squares(texels: Bool, layers: int, seed: int) -> list[Tile]:
    """First texels of squares that show the material, spread over it as its area is; fewer for many layers."""
    h, w = texels.shape
    corners = [(x, y) for y in range(0, h, SIDE) for x in range(0, w, SIDE)]
    counts = np.array([texels[y:y + SIDE, x:x + SIDE].sum() for x, y in corners], np.float64)
    counts[counts < min(LEAST_SHARE * SIDE**2, counts.max())] = 0.0
    most = max(min(SQUARES, SQUARES * LAYERS // layers), FEWEST)
    count = min(most, int((counts > 0).sum()))
    chosen = np.random.default_rng(seed).choice(len(corners), count, replace=False, p=counts / counts.sum())
    return [corners[i] for i in sorted(chosen)]


class MaterialSample(Source, Protocol):
    """The packed squares."""

    left_out: Bool  # (V,) layers that are kept from the solver
    covered: Bool  # (h, w) texels of the material

    def layer_light(self, texels: I32) -> LayerLight:
        """What shone on some texels, given by their places in the grid."""
        ...


@dataclass(frozen=True)
class LayerLight:
    """Of V layers."""

    irradiance: F64  # (T, V, C) W/m^2 without shadows
    lamps: I32  # (V,) which set of lamps shone


def sampled(device: Device, source: Source, texels: Bool, seed: int) -> MaterialSample | None:
    """Squares of a material; None where nothing says which lamps shone.  ``texels``: (h, w) those of the material."""
    squares = spread_squares(texels, len(source.layers.groups), seed)
    if isinstance(source, CameraSource):
        return CameraSample(device, source, texels, squares)
    if isinstance(source, ArraySource) and source.texels.irradiance is not None:
        return ArraySample(device, source, texels, squares)
    return None


def clusters(sample: MaterialSample, indices: I32) -> I32:
    """Of texels, by their places in the grid: a number for each small square."""
    width = sample.size[0]
    row, column = np.divmod(indices, width)
    return np.asarray(row // CLUSTER * (width // CLUSTER + 1) + column // CLUSTER, np.int32)


def read_sample(device: Device, sample: MaterialSample, most: int) -> tuple[SampledTexels, I32]:
    """(what is observed of at most so many of its texels, (T,) their places in the grid)."""
    layers = sample.layers
    groups = np.array(layers.groups, np.int32)
    covered = np.flatnonzero(sample.covered.ravel()).astype(np.int32)
    most = min(most, max(MOST // (len(groups) * layers.lights), 64))
    if len(covered) > most:
        covered = covered[np.linspace(0, len(covered) - 1, most).astype(np.int32)]
    blocks = _blocks(device, sample, covered)
    first, lobes = blocks[:, :, 0].astype(np.float64), blocks[:, :, 2:].astype(np.float64)
    edge = first[..., 3].astype(int) % 2 == 1
    light = sample.layer_light(covered)
    dark = (light.irradiance <= 0).any(-1)
    reflected = blocks[:, :, 1, :3].astype(np.float64) if layers.channels == 1 else first[..., :1]
    return SampledTexels(
        reflected, np.where(edge | dark, 0.0, first[..., 1]), first[..., 2], lobes, light.irradiance,
        groups // layers.channels, groups % layers.channels, light.lamps), covered


def _blocks(device: Device, sample: MaterialSample, texels: I32) -> F32:
    """(T, layers, blocks, 4) of the observation atlas."""
    layers, (width, height) = sample.layers, sample.size
    with device.scope():
        atlas = ObservationAtlas(device, sample)
        w, h = atlas.tile
        grid = np.zeros((layers.blocks, height, width, 4), np.float32)
        for x, y in tiles(atlas, sample.covered):
            for _ in sample.gather(atlas, (x, y), layers.channels == 1):
                pass
            part = device.read(atlas.texture).reshape(layers.blocks, h, w, 4)
            grid[:, y:y + h, x:x + w] = part[:, :min(h, height - y), :min(w, width - x)]
    row, column = np.divmod(texels, width)
    result = np.moveaxis(grid[:, row, column], 0, 1)
    return result.reshape(len(texels), len(layers.groups), 2 + layers.lights, 4)


class CameraSample(CameraSource):
    """Of texels that cameras see."""

    def __init__(self, device: Device, source: CameraSource, texels: Bool, squares: list[Tile]) -> None:
        position = _pack_texture(device, source.grid.position, squares)
        normal = _pack_texture(device, source.grid.normal, squares)
        self.covered = _pack(texels, squares)
        position[~self.covered] = 0.0
        height, width = position.shape[:2]
        packed = PackedTexels(device.texture(width, height, data=position), device.texture(width, height, data=normal))
        super().__init__(device, packed, source.observations, source.extent * width / source.size[0])
        self.places, self.normals = position, normal
        self.covered &= position[..., 3] > 0.5
        self.left_out: Bool = np.zeros(len(self.layers.groups), bool)

    def gather(self, atlas: ObservationAtlas, tile: Tile, colour: bool) -> Iterator[None]:
        """As of `CameraSource`, but for the layers that are left out."""
        yield from super().gather(atlas, tile, colour)
        for layer in np.flatnonzero(self.left_out):
            atlas.target.clear(viewport=atlas.block(int(layer) * (2 + self.layers.lights)))

    def layer_light(self, texels: I32) -> LayerLight:
        """As of `MaterialSample`."""
        channels = self.layers.channels
        views = [view.view for camera in self.observations.cameras for _ in range(channels) for view in camera.views]
        channel = np.array(self.layers.groups) % channels
        sets = [tuple((light.name, tuple(light.power), light.matrix.tobytes()) for light in view.lights)
                for view in views]
        order = {key: n for n, key in enumerate(dict.fromkeys(sets))}
        position = self.places.reshape(-1, 4)[texels, :3].astype(np.float64)
        normal = self.normals.reshape(-1, 4)[texels, :3].astype(np.float64)
        irradiance = np.stack([
            sum((light_irradiance(light, position, normal)[:, None]
                 * (light.power if channels == 1 else light.power[channel[n]]) for light in view.lights),
                np.zeros((len(texels), 3 if channels == 1 else 1)))
            for n, view in enumerate(views)], 1)
        return LayerLight(irradiance, np.array([order[key] for key in sets], np.int32))


class ArraySample(ArraySource):
    """Of texels that arrays hold."""

    def __init__(self, device: Device, source: ArraySource, texels: Bool, squares: list[Tile]) -> None:
        of = source.texels
        self.covered = _pack(texels, squares)
        packed = {name: _pack(getattr(of, name), squares)
                  for name in ("rgb", "quality", "cos_v", "lobes", "irradiance")}
        packed["quality"][~self.covered] = 0.0
        super().__init__(device, ObservedTexels(**packed, groups=of.groups, lamps=of.lamps),
                         device.read(source.principled_table)[..., :source.principled_table.components])
        for name in ("model_error", "least_gain"):
            setattr(self, name, getattr(source, name))
        self.left_out: Bool = np.zeros(len(of.groups), bool)

    def gather(self, atlas: ObservationAtlas, tile: Tile, colour: bool) -> Iterator[None]:
        """As of `ArraySource`, but for the layers that are left out."""
        self._filled = None
        yield from super().gather(atlas, tile, colour)
        for layer in np.flatnonzero(self.left_out):
            atlas.target.clear(viewport=atlas.block(int(layer) * (2 + self.layers.lights)))

    def layer_light(self, texels: I32) -> LayerLight:
        """As of `MaterialSample`."""
        layers = len(self.layers.groups)
        assert self.texels.irradiance is not None
        irradiance = self.texels.irradiance.reshape(-1, layers, 1)[texels].astype(np.float64)
        return LayerLight(np.repeat(irradiance, 3, 2), np.array(self.texels.lamps, np.int32))


def _pack(grid: np.ndarray, squares: list[Tile]) -> np.ndarray:
    """Squares of (h, w, ...) side by side; 0 beyond the grid."""
    return _packed([grid[y:y + SIDE, x:x + SIDE] for x, y in squares])


def _pack_texture(device: Device, texture: moderngl.Texture, squares: list[Tile]) -> F32:
    """The same of a texture, of which no more is read."""
    width, height = texture.size
    return _packed([device.read(texture, (x, y, min(SIDE, width - x), min(SIDE, height - y))) for x, y in squares])


def _packed(parts: list[np.ndarray]) -> np.ndarray:
    rows = -(-len(parts) // COLUMNS)
    packed = np.zeros((rows * SIDE, min(COLUMNS, len(parts)) * SIDE, *parts[0].shape[2:]), parts[0].dtype)
    for n, part in enumerate(parts):
        row, column = n // COLUMNS * SIDE, n % COLUMNS * SIDE
        packed[row:row + part.shape[0], column:column + part.shape[1]] = part
    return packed
