"""Some of a material's texels, packed: a source of their own, from which layers can be left out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import moderngl
import numpy as np

from ...core.data import F32, F64, I32, Bool
from ...core.evaluation.sampled_texels import SampledTexels
from ...core.shading.emitters import around_irradiance
from ...core.shading.lights import light_irradiance
from ..device.context import Device, Inputs
from ..observe.observation_atlas import (
    ArraySource,
    CameraSource,
    Layers,
    ObservationAtlas,
    ObservedTexels,
    Source,
    Tile,
    tiles,
)

SIDE = 8  # texels: width of a square
SQUARES = 64  # over which what differs from place to place shows ...
FEWEST = 40  # ... or, to bound the time, so few
LAYERS = 36  # with which a sample still has all its squares
WIDTH = 96  # texels: of a row of squares
LEAST_SHARE = 0.25  # of a square that the material must cover
CLUSTER = 8  # texels: width of the squares whose errors are taken to be alike
FEW = 256  # directions that stand for an environment where shadows are left out
MOST = 3_000_000  # lobes that the sample is read back with


@dataclass(frozen=True)
class PackedTexels:
    """The squares as a grid."""

    position: moderngl.Texture  # as of GBufferMaps
    normal: moderngl.Texture


class Packing(Protocol):
    """Which texels of a grid a sample holds, and where."""

    @property
    def stride(self) -> int:
        """Of the grid's texels along the sample's own."""

    def pack(self, grid: np.ndarray) -> np.ndarray:
        """Of (h, w, ...)."""

    def pack_texture(self, device: Device, texture: moderngl.Texture) -> F32:
        """The same of a texture."""


@dataclass(frozen=True)
class Thinned:
    """One texel of so many in a row and in a column, where the grid has them."""

    stride: int

    def pack(self, grid: np.ndarray) -> np.ndarray:
        """Of (h, w, ...)."""
        return np.array(grid[self.stride // 2::self.stride, self.stride // 2::self.stride])  # a copy at stride 1, too

    def pack_texture(self, device: Device, texture: moderngl.Texture) -> F32:
        """The same of a texture."""
        return self.pack(device.read(texture))


@dataclass(frozen=True)
class Squares:
    """Some squares of a grid of texels, which are packed side by side."""

    corners: tuple[Tile, ...]  # first texel of each
    side: int = SIDE  # texels
    stride: ClassVar[int] = 1

    def pack(self, grid: np.ndarray) -> np.ndarray:
        """Of (h, w, ...); 0 beyond the grid."""
        side, columns = self.side, WIDTH // self.side
        packed = np.zeros((*self.shape, *grid.shape[2:]), grid.dtype)
        for n, (x, y) in enumerate(self.corners):
            part, row, column = grid[y:y + side, x:x + side], n // columns * side, n % columns * side
            packed[row:row + part.shape[0], column:column + part.shape[1]] = part
        return packed

    def pack_texture(self, device: Device, texture: moderngl.Texture) -> F32:
        """The same of a texture, of which no more is read."""
        height, width = self.shape
        corners = np.zeros((1, len(self.corners), 4), np.float32)
        corners[0, :, :2] = self.corners
        with device.scope():
            places = device.texture(len(self.corners), 1, data=corners)
            packed = device.texture(width, height, texture.components)
            with device.target([packed]) as target:
                device.draw("solve/pack_squares.frag", target, Inputs(
                    {"u_grid": texture, "u_corners": places}, {"u_side": self.side, "u_columns": WIDTH // self.side}))
            return device.read(packed)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of what is packed.

        Powers of two, as most maps have: Mesa's software renderer compiles again for others (decision 0044).
        """
        columns = WIDTH // self.side
        rows = -(-len(self.corners) // columns)
        return _power_of_two(rows * self.side), _power_of_two(min(columns, len(self.corners)) * self.side)


def _power_of_two(least: int) -> int:
    return 1 << (least - 1).bit_length()


def squares_for(layers: int) -> int:
    """How many squares show what differs from place to place; fewer for many layers."""
    return max(min(SQUARES, SQUARES * LAYERS // layers), FEWEST)


def spread_squares(texels: Bool, most: int, seed: int, side: int = SIDE) -> Squares:
    """At most so many squares that show the material, spread over it as its area is."""
    h, w = texels.shape
    counts = np.add.reduceat(np.add.reduceat(texels, np.arange(0, h, side), 0, np.int64),
                             np.arange(0, w, side), 1).astype(np.float64).ravel()
    counts[counts < min(LEAST_SHARE * side**2, counts.max())] = 0.0
    count = min(most, int((counts > 0).sum()))
    chosen = np.random.default_rng(seed).choice(len(counts), count, replace=False, p=counts / counts.sum())
    columns = -(-w // side)
    return Squares(tuple((int(i) % columns * side, int(i) // columns * side) for i in sorted(chosen)), side)


class MaterialSample(Source, Protocol):
    """The packed texels."""

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


def squares_of(source: Source, texels: Bool, seed: int) -> Squares | None:
    """That show a material; None where nothing says which lamps shone.  ``texels``: (h, w) those of the material."""
    if isinstance(source, ArraySource) and source.texels.irradiance is None:
        return None
    return spread_squares(texels, squares_for(len(source.layers.groups)), seed)


def packed(device: Device, source: Source, texels: Bool, packing: Packing) -> MaterialSample:
    """Those texels of a material.  ``texels``: as of `squares_of`."""
    if isinstance(source, CameraSource):
        sample = CameraSample(device, source, texels, packing)
        sample.keep()
        return sample
    assert isinstance(source, ArraySource)
    return ArraySample(device, source, texels, packing)


def clusters(sample: MaterialSample, indices: I32) -> I32:
    """Of texels, by their places in the grid: a number for each small square."""
    width = sample.size[0]
    row, column = np.divmod(indices, width)
    return np.asarray(row // CLUSTER * (width // CLUSTER + 1) + column // CLUSTER, np.int32)


def read_sample(
    device: Device, sample: MaterialSample, most: int, bounds: bool = False,
) -> tuple[SampledTexels, I32]:
    """(what is observed of at most so many of its texels, (T,) their places in the grid).

    ``bounds``: with what clipped pixels show at least.
    """
    layers = sample.layers
    groups = np.array(layers.groups, np.int32)
    covered = np.flatnonzero(sample.covered.ravel()).astype(np.int32)
    most = min(most, max(MOST // (len(groups) * max(layers.each - 2, 1)), 64))
    if len(covered) > most:
        covered = covered[np.linspace(0, len(covered) - 1, most).astype(np.int32)]
    blocks = _blocks(device, sample, covered, layers.channels == 1 or bounds)
    observed = observed_texels(blocks, layers, sample.layer_light(covered))
    return _with_bounds(observed, blocks, layers) if bounds else observed, covered


def observed_texels(blocks: F32, layers: Layers, light: LayerLight) -> SampledTexels:
    """(T, layers, blocks, 4) of the observation atlas, as records."""
    groups = np.array(layers.groups, np.int32)
    first, lobes = blocks[:, :, 0].astype(np.float64), blocks[:, :, 2:2 + layers.lights].astype(np.float64)
    edge = first[..., 3].astype(int) % 2 == 1
    dark = (light.irradiance <= 0).any(-1)
    reflected = blocks[:, :, 1, :3].astype(np.float64) if layers.channels == 1 else first[..., :1]
    reflected = np.where(first[..., 1:2] > 0, reflected, 0.0)
    return SampledTexels(
        reflected, np.where(edge | dark, 0.0, first[..., 1]), first[..., 2], lobes, light.irradiance,
        groups // layers.channels, groups % layers.channels, light.lamps, nodes_of(blocks, layers))


def _with_bounds(observed: SampledTexels, blocks: F32, layers: Layers) -> SampledTexels:
    """With what clipped pixels show at least; as it is where none is clipped."""
    colours = blocks[:, :, 1, :3].astype(np.float64)
    least = colours if layers.channels == 1 else np.take_along_axis(colours, observed.channel[None, :, None], 2)
    share = 2 * (blocks[:, :, 0, 3].astype(np.float64) % 1)  # how well the pixel stands for the texel
    clipped = (blocks[:, :, 0, 1] <= 0) & (share > 0) & (least > 0).any(-1) & (observed.irradiance > 0).all(-1)
    if not clipped.any():
        return observed
    return replace(observed, reflected=np.where(clipped[..., None], least, observed.reflected),
                   clipped=np.where(clipped, share * observed.cos_v**2, 0.0))


def nodes_of(blocks: F32, layers: Layers) -> F64 | None:
    """(T, layers, 2, NODES) of (T, layers, blocks, 4); None where no view has an environment."""
    if not layers.environment:
        return None
    return blocks[:, :, 2 + layers.lights:].reshape(*blocks.shape[:2], 2, -1).astype(np.float64)


def _blocks(device: Device, sample: MaterialSample, texels: I32, colour: bool) -> F32:
    """(T, layers, blocks, 4) of the observation atlas."""
    layers, (width, height) = sample.layers, sample.size
    with device.scope():
        atlas = ObservationAtlas(device, sample)
        w, h = atlas.tile
        grid = np.zeros((layers.blocks, height, width, 4), np.float32)
        for x, y in tiles(atlas, sample.covered):
            for _ in sample.gather(atlas, (x, y), colour):
                pass
            part = device.read(atlas.texture).reshape(layers.blocks, h, w, 4)
            grid[:, y:y + h, x:x + w] = part[:, :min(h, height - y), :min(w, width - x)]
    row, column = np.divmod(texels, width)
    result = np.moveaxis(grid[:, row, column], 0, 1)
    return result.reshape(len(texels), len(layers.groups), layers.each, 4)


class CameraSample(CameraSource):
    """Of texels that cameras see."""

    def __init__(self, device: Device, source: CameraSource, texels: Bool, packing: Packing) -> None:
        position = packing.pack_texture(device, source.grid.position)
        normal = packing.pack_texture(device, source.grid.normal)
        self.covered = packing.pack(texels)
        position[~self.covered] = 0.0
        height, width = position.shape[:2]
        packed = PackedTexels(device.texture(width, height, data=position), device.texture(width, height, data=normal))
        super().__init__(device, packed, source.observations,
                         source.extent * width * packing.stride / source.size[0], source.misfit,
                         source.stride * packing.stride)
        if self.tilts is not None and source.tilts is not None:
            self.tilts = replace(self.tilts, deviation=source.tilts.deviation)
        self.places, self.normals = position, normal
        self.covered &= position[..., 3] > 0.5
        self.left_out: Bool = np.zeros(len(self.layers.groups), bool)
        self._kept: dict[Tile, moderngl.Texture] = {}  # what each tile's atlas holds, ...
        self._gathered: set[Tile] = set()  # once it was gathered
        self._filled: tuple[ObservationAtlas, Tile, bytes] | None = None  # the atlas that holds it; what is left out

    def keep(self) -> None:
        """Gather each tile once: a sample is solved many times."""
        atlas = ObservationAtlas(self.device, self)
        self._kept = {tile: self.device.texture(*atlas.texture.size) for tile in tiles(atlas, self.covered)}
        atlas.release()

    def gather(self, atlas: ObservationAtlas, tile: Tile, colour: bool) -> Iterator[None]:
        """As of `CameraSource`, but for the layers that are left out; nothing to do where the atlas holds that."""
        kept, holds = self._kept.get(tile), (atlas, tile, self.left_out.tobytes())
        if kept is not None and kept.size != atlas.texture.size:
            kept = None
        if kept is not None and self._filled == holds:
            return
        self._filled = None
        if kept is None:
            yield from super().gather(atlas, tile, colour)
        elif tile in self._gathered:
            self._copy_texture(kept, atlas.target)
        else:
            yield from super().gather(atlas, tile, True)
            with self.device.target([kept]) as target:
                self._copy_texture(atlas.texture, target)
            self._gathered.add(tile)
        for layer in np.flatnonzero(self.left_out):
            atlas.target.clear(viewport=atlas.block(int(layer) * self.layers.each))
        self._filled = holds

    def _copy_texture(self, texture: moderngl.Texture, target: moderngl.Framebuffer) -> None:
        self.device.draw("observe/copy.frag", target, Inputs({"u_map": texture}, {"u_corner": (0, 0)}))

    def layer_light(self, texels: I32) -> LayerLight:
        """As of `MaterialSample`."""
        channels = self.layers.channels
        views = [view.view for camera in self.observations.cameras for _ in range(channels) for view in camera.views]
        channel = np.array(self.layers.groups) % channels
        sets = [(view.environment and view.environment.key, *((light.name, tuple(light.power), light.matrix.tobytes())
                                         for light in view.lights)) for view in views]
        order = {key: n for n, key in enumerate(dict.fromkeys(sets))}
        position = self.places.reshape(-1, 4)[texels, :3].astype(np.float64)
        normal = self.normals.reshape(-1, 4)[texels, :3].astype(np.float64)
        shone = {view.environment.key: view.environment for view in views if view.environment is not None}
        around = {key: around_irradiance(found, position, normal, FEW) for key, found in shone.items()}
        irradiance = np.stack([
            sum((light_irradiance(light, position, normal)[:, None] * light.power for light in view.lights),
                around[view.environment.key] if view.environment is not None else np.zeros((len(texels), 3))
                )[:, slice(None) if channels == 1 else [channel[n]]]
            for n, view in enumerate(views)], 1)
        return LayerLight(irradiance, np.array([order[key] for key in sets], np.int32))


class ArraySample(ArraySource):
    """Of texels that arrays hold."""

    def __init__(self, device: Device, source: ArraySource, texels: Bool, packing: Packing) -> None:
        of = source.texels
        self.covered = packing.pack(texels)
        parts = {name: packing.pack(getattr(of, name))
                 for name in ("rgb", "quality", "cos_v", "lobes", "irradiance") if getattr(of, name) is not None}
        parts["quality"][~self.covered] = 0.0
        super().__init__(device, ObservedTexels(**parts, groups=of.groups, lamps=of.lamps),
                         device.read(source.principled_table)[..., :source.principled_table.components])
        for name in ("model_error", "least_gain"):
            setattr(self, name, getattr(source, name))
        self.left_out: Bool = np.zeros(len(of.groups), bool)

    def gather(self, atlas: ObservationAtlas, tile: Tile, colour: bool) -> Iterator[None]:
        """As of `ArraySource`, but for the layers that are left out."""
        self._filled = None
        yield from super().gather(atlas, tile, colour)
        for layer in np.flatnonzero(self.left_out):
            atlas.target.clear(viewport=atlas.block(int(layer) * self.layers.each))

    def layer_light(self, texels: I32) -> LayerLight:
        """As of `MaterialSample`."""
        layers = len(self.layers.groups)
        assert self.texels.irradiance is not None
        irradiance = self.texels.irradiance.reshape(-1, layers, 1)[texels].astype(np.float64)
        return LayerLight(np.repeat(irradiance, 3, 2), np.array(self.texels.lamps, np.int32))
