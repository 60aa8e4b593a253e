"""Where a texel's observations come from, and how a kernel finds them: one texture, block upon block.

Block b of the atlas is its rows [b h, (b + 1) h), h the height of a tile.  A layer is one view (of one
channel, where each is observed by itself) and has 2 + lights blocks:

    0      f (1/sr), quality, cos_v, 2 channel + edge + share / 2    f = radiance / irradiance
    1      f of R, G and B, of a clipped pixel at least so much      where a method asks for colour
    2 + l  lobe of light l: sin2h, radius2, cos_l, F / (2 cos_l cos_v) * E_light / E_view

Where some view has an environment, 2 NODES / 4 blocks more: logarithms of what the lobe returns at nodes of roughness
(core/shading/environment.py), 1/sr, and then V.H at which Fresnel's reflectance is the lobe's.

The layers of one camera (and channel) follow one another: they are a group, and share its pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import moderngl
import numpy as np

from ...core.data import F32, Bool
from ...core.shading.environment import LEAST, NODE_COLUMNS, NODE_ROWS
from ..device.context import Device, Inputs
from ..device.occupied_cells import CELL
from .observations import EDGE_QUALITY, Observations, ObservedView

TILE = (512, 128)  # width and height, in texels
NARROW = 128  # width where a software renderer reads more than UNROLLED layers, and at most ...
NARROW_BLOCKS = 192  # ... so many blocks: with more, tiles are low too, and draws many; decision 0026
ATLAS_ROWS = 16384  # texture height that every GL 3.3 driver offers in practice
UNROLLED = 16  # layers up to which loops over them are unrolled; shaders/solve/each_group.glsl goes so far
LOOP_ROUNDS = 65535  # of all loops of a shader, after which llvmpipe ends them without an error
AT_ONCE = (1, 4, 8)  # groups or layers that a round can do; shaders/solve/each_group.glsl
FEW_LAYERS = 4  # of every group: then a round does several groups
REACH = 1.0  # texels: a pixel that shows a place so far from the texel counts half
CAMERA_SLACK = 0.05  # relative: how much the albedo of two cameras' pixels may differ over one texel
SHARED_ERROR = 0.001  # relative: of the forward model in a pixel, and alike in neighbouring texels
ENVIRONMENT_ERROR = 0.006  # the same of light from all around, which is a sum: docs/environment.md
CURVE_ERROR = 0.027  # the same where a tone curve is undone: what its two numbers leave over, docs/decisions/0055
MODEL_ERROR = 0.003  # relative: pixels stand for texels
LEAST_GAIN = 5.0  # nats a texel: such errors are mimicked by more lobes; up to 2.9 was seen

Tile = tuple[int, int]  # its first texel


@dataclass(frozen=True)
class Layers:
    """What a texel is offered."""

    groups: tuple[int, ...]  # camera and channel of each layer
    lights: int  # lobes per layer
    channels: int  # 1: an observation is the mean of R, G and B; 3: each channel by itself
    spread: bool  # whether a lobe is seen from an area or lit by one
    environment: bool = False  # whether some view has one

    @property
    def blocks(self) -> int:
        """Blocks of the atlas."""
        return len(self.groups) * self.each

    @property
    def each(self) -> int:
        """Blocks of a layer."""
        return 2 + self.lights + (2 * NODE_ROWS if self.environment else 0)

    @property
    def starts(self) -> list[int]:
        """The first layer of each group."""
        return [n for n in range(len(self.groups)) if n == 0 or self.groups[n] != self.groups[n - 1]]

    @property
    def most(self) -> int:
        """Layers of the largest group."""
        return int(np.diff([*self.starts, len(self.groups)]).max(initial=1))

    def at_once(self, loops: int) -> int:
        """How many groups, or layers of one, a round must do, so that ``loops`` over all end within LOOP_ROUNDS.

        0: more than `AT_ONCE`.
        """
        groups = len(self.starts)
        sizes = np.diff([*self.starts, len(self.groups)])
        for count in AT_ONCE:
            if self.most <= (1 if count == 1 else FEW_LAYERS):
                rounds = -(-groups // count)
            else:
                rounds = groups + int((-(-sizes // count)).sum())
            if loops * rounds <= LOOP_ROUNDS:
                return count
        return 0

    def defines(self, at_once: int = 1) -> dict[str, str]:
        """Of every kernel that includes solve/observations.glsl."""
        count, starts, most = len(self.groups), self.starts, self.most
        several = at_once > 1 and count > UNROLLED
        if several and most <= FEW_LAYERS:
            empty = -len(starts) % at_once  # groups, the last ones
            bounds, channels = [*starts, *[count] * (empty + 1)], [*starts, *[0] * empty]
            loop = f"GROUPS_BY_{at_once}"
        else:
            bounds, channels, loop = [*starts, count], starts, "GROUPS_IN_A_LOOP"
        return {
            "EACH_GROUP": loop if count > UNROLLED else f"GROUPS_{len(starts)}",
            **{f"GROUP_START_{k}": str(bound) for k, bound in enumerate(bounds) if count <= UNROLLED},
            "LAYERS": str(count), "GROUPS": str(len(channels)), "GROUP_STARTS": ", ".join(map(str, bounds)),
            "GROUP_CHANNELS": ", ".join(str(self.groups[n] % self.channels) for n in channels),
            **({"SINGLE": "1"} if most == 1 else {"MOST": str(most)} if several and most <= FEW_LAYERS else
               {"AT_ONCE": str(at_once)} if several else {}),
            "LIGHTS": str(self.lights), "CHANNELS": str(self.channels), "BLOCKS": str(self.each),
            **({"SPREAD": "1"} if self.spread else {}), **({"ENVIRONMENT": "1"} if self.environment else {}),
        }


@dataclass(frozen=True)
class Tilts:
    """By what light changes where a normal is not quite the texel's."""

    normal: moderngl.Texture  # of the texels: shading normal
    lamps: moderngl.Texture  # (lights, layers) place of each light and 1, or the direction to it and 0
    deviation: float = 1.0  # standard deviation of a tilt, in radians for a relative noise of 1

    def textures(self) -> dict[str, moderngl.Texture]:
        """As solve/observations.glsl calls them."""
        return {"u_texel_normal": self.normal, "u_lamps": self.lamps}


class Source(Protocol):
    """Something that fills an atlas."""

    size: tuple[int, int]  # width and height of the maps
    layers: Layers
    camera_slack: float  # how much albedo may differ between groups, relative
    shared_error: float  # relative: the least noise of an observation, and what neighbouring texels share of it
    model_error: float  # relative, of the forward model: the floor of core.models.evidence
    least_gain: float  # of core.models.choose
    misfit: float  # relative error of an observation that residuals do not show: a texel's err alike
    extent: float  # width of the maps in UV squares
    stride: int  # of these texels along the map's own: more than 1 where others lie between
    position: moderngl.Texture  # of the texels: world xyz, coverage
    tilts: Tilts | None  # None: normals are known exactly
    principled_table: moderngl.Texture

    def gather(self, atlas: ObservationAtlas, tile: Tile, colour: bool) -> Iterator[None]:
        """Fill the atlas with a tile's observations; ``colour``: with those of R, G and B."""
        ...


class ObservationAtlas:
    """The texture that holds the observations of one tile."""

    def __init__(self, device: Device, source: Source, tile: tuple[int, int] | None = None) -> None:
        """``tile``: its width and height (else TILE), less where the maps or the device's textures are smaller."""
        self.device = device
        self.layers = layers = source.layers
        rows, (width, height) = layers.blocks, source.size
        narrow = device.is_software and len(layers.groups) > UNROLLED and rows <= NARROW_BLOCKS
        tile = tile or (min(TILE[0], NARROW) if narrow else TILE[0], TILE[1])
        self.tile = (min(tile[0], width), max(1, min(tile[1], height, ATLAS_ROWS // rows)))
        self.texture = device.texture(self.tile[0], self.tile[1] * rows)
        self.target = device.framebuffer([self.texture])
        self.uniforms = {"u_tile_height": self.tile[1]}

    def block(self, number: int) -> tuple[int, int, int, int]:
        """Viewport of a block."""
        w, h = self.tile
        return 0, number * h, w, h

    def work(self) -> F32:
        """(height,) about how many observations each row of texels holds, and one more for each texel."""
        width, height = self.tile
        inputs = Inputs({"u_observations": self.texture}, self.uniforms, {
            "LAYERS": str(len(self.layers.groups)), "BLOCKS": str(self.layers.each), "CELL": str(CELL)})
        with self.device.scope():
            counts = self.device.texture(-(-width // CELL), -(-height // CELL), 1)
            with self.device.target([counts]) as target:
                self.device.draw("solve/work.frag", target, inputs)
            rows = self.device.read(counts)[..., 0].sum(axis=1) / np.float32(CELL)
        return np.repeat(rows, CELL)[:height]

    def release(self) -> None:
        """Free the texture."""
        self.target.release()
        self.texture.release()


def tiles(atlas: ObservationAtlas, covered: Bool) -> list[Tile]:
    """First texel of each tile that has covered texels."""
    (w, h), (height, width) = atlas.tile, covered.shape
    return [(x, y) for y in range(0, height, h) for x in range(0, width, w) if covered[y:y + h, x:x + w].any()]


class TexelSurface(Protocol):
    """Where texels lie: two textures, as of `GBufferMaps`."""

    @property
    def position(self) -> moderngl.Texture:
        """World xyz, coverage."""
        ...

    @property
    def normal(self) -> moderngl.Texture:
        """Shading normal, material slot."""
        ...


class CameraSource:
    """Texels matched to the pixels of the cameras that see them."""

    def __init__(
        self, device: Device, grid: TexelSurface, observations: Observations, extent: float = 1.0, misfit: float = 0.0,
        stride: int = 1,
    ) -> None:
        self.device, self.grid, self.observations = device, grid, observations
        channels = observations.channels
        groups = tuple(i * channels + channel for i, camera in enumerate(observations.cameras)
                       for channel in range(channels) for _ in camera.views)
        lights = max(len(v.lobes) for c in observations.cameras for v in c.views) // channels
        around = any(view.nodes is not None for camera in observations.cameras for view in camera.views)
        self.layers = Layers(groups, lights, channels, spread=True, environment=around)
        self.size = grid.position.size
        # Where each camera has one view, as under a carried flash or one environment, the scatter between cameras is
        # measured: as noise (docs/decisions/0056).
        alone = len(set(groups)) == len(groups)
        self.camera_slack = 0.0 if alone else CAMERA_SLACK
        curved = any(view.view.shoulder != 1 for camera in observations.cameras for view in camera.views)
        self.shared_error = CURVE_ERROR if curved else ENVIRONMENT_ERROR if around else SHARED_ERROR
        self.model_error = MODEL_ERROR
        self.least_gain = LEAST_GAIN
        self.misfit = misfit
        self.extent = extent
        self.stride = stride
        self.position = grid.position
        several = len(set(groups)) < len(groups)  # views of some camera: tilts explain how they differ
        self.tilts: Tilts | None = None
        if lights and several:
            self.tilts = Tilts(grid.normal, _lamps(device, self.layers, observations))
        self.principled_table = observations.principled_table

    def gather(self, atlas: ObservationAtlas, tile: Tile, colour: bool) -> Iterator[None]:
        """Match the tile's texels to each camera's pixels and copy what those observe."""
        device = self.device
        with device.scope():
            match = device.texture(*atlas.tile)
            match_target = device.framebuffer([match])
            layer = 0
            for camera in self.observations.cameras:
                device.draw("observe/match.frag", match_target, Inputs({
                    "u_texel_position": self.grid.position, "u_texel_normal": self.grid.normal,
                    "u_position": camera.maps.position, "u_normal": camera.maps.normal,
                }, {**camera.uniforms, **camera.projection.uniforms, "u_tile": tile, "u_reach": REACH}, camera.defines))
                for channel in range(self.layers.channels):
                    for view in camera.views:
                        self._copy(atlas, match, layer, view, channel, colour)
                        layer += 1
                device.budget.finish()
                yield

    def _copy(
        self, atlas: ObservationAtlas, match: moderngl.Texture, layer: int, view: ObservedView, channel: int,
        colour: bool,
    ) -> None:
        """One layer: what the matched pixels of one view observe."""
        channels, lights = self.layers.channels, self.layers.lights
        block = layer * self.layers.each
        textures = {"u_match": match, "u_colour": view.colour}
        tint = view.tint[channel] if channels > 1 else 1.0
        for offset, wanted in enumerate((channel if channels > 1 else -1, 3)):
            if wanted < 3 or colour:
                place = atlas.block(block + offset)
                self.device.draw("observe/gather_colour.frag", atlas.target, Inputs(
                    textures, {"u_channel": wanted, "u_row": place[1], "u_tint": tint},
                    {"EDGE_QUALITY": str(EDGE_QUALITY)}), viewport=place)
        for n in range(lights):
            place = atlas.block(block + 2 + n)
            index = n * channels + channel
            if index < len(view.lobes):
                self.device.draw("observe/gather_lobe.frag", atlas.target, Inputs(
                    {"u_match": match, "u_lobe": view.lobes[index]}, {"u_row": place[1]}), viewport=place)
            else:
                atlas.target.clear(viewport=place)
        for n in range(2 * NODE_ROWS if self.layers.environment else 0):
            self._copy_nodes(atlas, match, block + 2 + lights + n, view, (channel if channels > 1 else -1, n))

    def _copy_nodes(
        self, atlas: ObservationAtlas, match: moderngl.Texture, block: int, view: ObservedView, part: tuple[int, int],
    ) -> None:
        """A block of nodes; ``part``: the channel, and which of the layer's."""
        place, (channel, n) = atlas.block(block), part
        if view.nodes is None:
            dark = float(np.log(LEAST))
            atlas.target.clear(dark, dark, dark, dark, viewport=place)
            return
        self.device.draw("observe/gather_nodes.frag", atlas.target, Inputs({"u_match": match, "u_nodes": view.nodes}, {
            "u_row": place[1], "u_node_row": n % NODE_ROWS, "u_channel": channel if n < NODE_ROWS else 3,
            "u_size": (view.nodes.width // NODE_COLUMNS, view.nodes.height // NODE_ROWS)}), viewport=place)


def _lamps(device: Device, layers: Layers, observations: Observations) -> moderngl.Texture:
    """As of `Tilts`."""
    rows = np.zeros((len(layers.groups), layers.lights, 4), np.float32)
    views = [view.view for camera in observations.cameras for _ in range(observations.channels)
             for view in camera.views]
    for layer, view in enumerate(views):
        for n, light in enumerate(view.lights):
            column = light.matrix[:3, 2] if light.kind == "SUN" else light.matrix[:3, 3]
            rows[layer, n] = *column, light.kind != "SUN"
    return device.texture(layers.lights, len(layers.groups), data=rows)


@dataclass(frozen=True)
class ObservedTexels:
    """K observations of each of (h, w) texels, row 0 at the bottom."""

    rgb: F32  # (h, w, K, 3) radiance / irradiance, 1/sr
    quality: F32  # (h, w, K) 0 (not observed) to 1
    cos_v: F32  # (h, w, K)
    lobes: F32  # (h, w, K, lights, 4) as the last blocks of the atlas
    groups: tuple[int, ...]  # (K) ascending, which camera
    # Where models are to be judged by what left-out lamps show:
    irradiance: F32 | None = None  # (h, w, K) without shadows, in any unit
    lamps: tuple[int, ...] = ()  # (K) which set of lamps shone


class ArraySource:
    """Observations from arrays: for benchmarks, tests, and other people's renderers."""

    def __init__(self, device: Device, texels: ObservedTexels, table: F32) -> None:
        """``table``: core.tables.principled_table()."""
        self.texels = texels
        rgb, quality, cos_v, lobes = texels.rgb, texels.quality, texels.cos_v, texels.lobes
        h, w = quality.shape[:2]
        self.size = (w, h)
        self.layers = Layers(texels.groups, lobes.shape[3], 1, spread=bool(np.any(lobes[..., 1])))
        self.camera_slack = 0.0  # texels are observed where they are
        self.shared_error = 0.0  # and each for itself
        self.model_error = 1e-4  # float32
        self.least_gain = 0.0
        self.misfit = 0.0
        self.extent = 1.0
        self.stride = 1
        self.position = device.texture(w, h, 4, np.ones((h, w, 4), np.float32))
        self.tilts: Tilts | None = None
        self.principled_table = device.texture(table.shape[1], table.shape[0], table.shape[2], table)
        flags = np.where(quality > 0, 0.5 * 0.999, 0.0)
        first = np.stack([rgb.mean(axis=3), quality, cos_v, flags], axis=3)
        second = np.concatenate([rgb, np.zeros_like(rgb[..., :1])], axis=3)
        blocks = np.concatenate([first[:, :, :, None], second[:, :, :, None], lobes], axis=3)
        self.blocks = np.ascontiguousarray(np.moveaxis(blocks, (2, 3), (0, 1)), np.float32).reshape(-1, h, w, 4)
        self._filled: tuple[ObservationAtlas, Tile] | None = None

    def gather(self, atlas: ObservationAtlas, tile: Tile, colour: bool) -> Iterator[None]:
        """Upload a tile; nothing to do where the atlas holds it already."""
        if self._filled is not None and self._filled[0] is atlas and self._filled[1] == tile:
            return
        (x, y), (w, h) = tile, atlas.tile
        data = np.zeros((len(self.blocks), h, w, 4), np.float32)
        part = self.blocks[:, y:y + h, x:x + w]
        data[:, :part.shape[1], :part.shape[2]] = part
        atlas.texture.write(data.tobytes())
        self._filled = atlas, tile
        yield

    def release(self) -> None:
        """Free the textures."""
        self.position.release()
        self.principled_table.release()
