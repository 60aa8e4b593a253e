"""Observations -> roughness per texel: gather, search, share with neighbours, polish.

The search of a texel is one draw of one fused kernel (shaders/solve/).  Tiles bound the memory of
the gathered observations and the time of a draw.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass

import moderngl
import numpy as np

from ..core.errors import Cancelled
from ..core.job import Progress
from ..core.params import SolveSettings
from .context import Device
from .observe import Observations
from .surface import SurfaceMaps

TILE_WIDTH = 512
TILE_HEIGHT = 128
SLICE_SECONDS = 0.015  # of GPU time between two chances to do something else
FIRST_ROWS = 16  # of a tile in the first draw of a kernel, before its speed is known
ATLAS_ROWS = 16384  # texture height that every GL 3.3 driver offers in practice
REACH = 1.0  # texels: a pixel that shows a place so far from the texel counts half
MAX_OBSERVATIONS = 64  # of a texel; the local arrays of the kernel
NOISE_FLOOR = 1e-4  # relative: float32 and the forward model's own error
NOISE_LEVELS = 4  # noise is averaged over 16 x 16 texels
FIRST_SLACK = 300.0  # between-camera variance of albedo in units of the noise's, before the noise is known
CAMERA_SLACK = 0.05  # relative: how much the albedo of two cameras' pixels may differ over one texel
PRIOR_CUT = 15.0  # an edge in the map costs no more than this, in nats
POOL_GAIN = 0.3  # of 1: neighbours' errors are alike (shared pixels, model error), four say less than four times one
METHODS = {  # what each method's kernel does at a texel
    "refined": {"u_particles": 8, "u_race_steps": 3, "u_final_steps": 8},
    "swarm": {"u_iterations": 25},
}
ROUGHNESS_SLOPE = 3.0  # expected change of roughness across the UV square: a cell may differ so much from its parent


@dataclass(frozen=True)
class RoughnessMaps:
    """What the search found, on the texel grid; released by the caller."""

    roughness: moderngl.Texture  # roughness, standard error, relative residual, solved
    detail: moderngl.Texture  # good observations, residual, residual without lobe, confidence


@dataclass(frozen=True)
class _Layers:
    """The observations a texel is offered: cameras in turn, their channels in turn, their views in turn."""

    observations: Observations

    @property
    def count(self) -> int:
        return self.observations.channels * sum(len(c.views) for c in self.observations.cameras)

    @property
    def groups(self) -> list[int]:
        """Camera and channel of each layer."""
        channels = self.observations.channels
        return [i * channels + channel for i, c in enumerate(self.observations.cameras)
                for channel in range(channels) for _ in c.views]

    @property
    def lights(self) -> int:
        """Lobes per view, the most that any view has."""
        return max(len(v.lobes) for c in self.observations.cameras for v in c.views) // self.observations.channels

    def defines(self) -> dict[str, str]:
        return {"LAYERS": str(self.count), "MAX_OBS": str(min(self.count, MAX_OBSERVATIONS)),
                "LIGHTS": str(self.lights)}


class Solver:
    """Roughness of every texel of a G-buffer."""

    def __init__(self, device: Device, grid: SurfaceMaps, observations: Observations, settings: SolveSettings) -> None:
        self.device, self.grid, self.observations, self.settings = device, grid, observations, settings
        self.size = grid.position.width
        self.cancelled = False
        self.layers = _Layers(observations)
        self.bands: dict[str, int] = {}
        rows = self.layers.count * (1 + self.layers.lights)
        self.tile = (min(TILE_WIDTH, self.size), max(1, min(TILE_HEIGHT, self.size, ATLAS_ROWS // rows)))
        self.atlas = device.texture(self.tile[0], self.tile[1] * rows)
        self.atlas_target = device.framebuffer([self.atlas])
        self.match = device.texture(*self.tile)
        self.match_target = device.framebuffer([self.match])
        self.covered = device.read(grid.position)[..., 3] > 0.5
        self.uniforms = {"u_group": tuple(self.layers.groups) if self.layers.count > 1 else 0,
                         "u_group_slack": FIRST_SLACK, "u_tile_height": self.tile[1]}

    def tiles(self) -> Iterator[tuple[int, int]]:
        """First texel of each tile that has covered texels."""
        w, h = self.tile
        for y in range(0, self.size, h):
            for x in range(0, self.size, w):
                if self.covered[y:y + h, x:x + w].any():
                    yield x, y

    def solve(self) -> Generator[Progress, None, RoughnessMaps]:
        """Search every texel alone, pool what texels say, and polish each under its neighbours' prior."""
        device, size = self.device, self.size
        valleys, support = self._pair()
        tables = tuple(device.texture(size, size) for _ in range(8))
        search = self.framebuffer([valleys, support])
        table_target = self.framebuffer(tables)
        tiles = list(self.tiles())
        knobs = {"u_seed": self.settings.seed, **METHODS[self.settings.method]}
        self.uniforms["u_group_slack"] = FIRST_SLACK
        done = yield from self._over(tiles, (0.0, 0.5), f"solve/{self.settings.method}.frag", search, {}, knobs)
        tiles = tiles[:done]  # fewer when stopped: these are finished, the rest is filled from them
        found = {"u_valleys": valleys, "u_support": support, "u_noise": self._noise(valleys, support)}
        floor = {"u_noise_floor": NOISE_FLOOR, "u_noise_unknown": CAMERA_SLACK**2}
        yield from self._over(tiles, (0.5, 0.75), "solve/table.frag", table_target, found, floor)
        estimate, prior = self._share(tables)
        for target in (search, table_target):
            target.release()
        for texture in tables:
            texture.release()
        roughness, detail = self._pair()
        polish = self.framebuffer([roughness, detail])
        yield from self._over(tiles, (0.75, 1.0), "solve/polish.frag", polish,
                              {**found, "u_estimate": estimate, "u_prior": prior},
                              {**floor, "u_prior_cut": PRIOR_CUT, "u_steps": 4})
        polish.release()
        for texture in (*found.values(), estimate, prior):
            texture.release()
        return RoughnessMaps(roughness, detail)

    def _over(
        self, tiles: list[tuple[int, int]], span: tuple[float, float], fragment: str, target: moderngl.Framebuffer,
        textures: dict[str, moderngl.Texture], uniforms: Mapping[str, float | int],
    ) -> Generator[Progress, None, int]:
        """Run one kernel over tiles; returns how many were done, fewer when the first kernel is stopped.

        A later kernel goes on to its end over the tiles that the first one did.
        """
        stoppable = span[0] == 0.0
        for i, tile in enumerate(tiles):
            for step in (self._gather(tile), self._run(fragment, target, tile, textures, uniforms)):
                for _ in step:
                    try:
                        part = (i + 1) / len(tiles)
                        yield Progress(span[0] + (span[1] - span[0]) * part, "solve", f"tile {i + 1} of {len(tiles)}")
                    except Cancelled:
                        self.cancelled = True
            if self.cancelled and stoppable:
                return i + 1
        return len(tiles)

    def _pair(self) -> tuple[moderngl.Texture, moderngl.Texture]:
        return self.device.texture(self.size, self.size), self.device.texture(self.size, self.size)

    def framebuffer(self, textures: list[moderngl.Texture] | tuple[moderngl.Texture, ...]) -> moderngl.Framebuffer:
        """A cleared framebuffer."""
        target = self.device.framebuffer(list(textures))
        target.clear()
        return target

    def _gather(self, tile: tuple[int, int]) -> Iterator[None]:
        """Fill the atlas with the observations of the tile's texels."""
        device, (w, h) = self.device, self.tile
        channels, lights = self.observations.channels, self.layers.lights
        layer = 0
        for camera in self.observations.cameras:
            device.draw("observe/match.frag", self.match_target, textures={
                "u_texel_position": self.grid.position, "u_texel_normal": self.grid.normal,
                "u_position": camera.maps.position, "u_normal": camera.maps.normal,
            }, uniforms={**camera.uniforms, "u_clip": camera.clip, "u_tile": tile, "u_reach": REACH})
            for channel in range(channels):
                for view in camera.views:
                    row = layer * (1 + lights) * h
                    device.draw("observe/gather_colour.frag", self.atlas_target,
                                textures={"u_match": self.match, "u_colour": view.colour},
                                uniforms={"u_channel": channel if channels > 1 else -1, "u_row": row,
                                          "u_tint": view.tint[channel] if channels > 1 else 1.0},
                                viewport=(0, row, w, h))
                    for n in range(lights):
                        row += h
                        index = n * channels + channel
                        if index < len(view.lobes):
                            device.draw("observe/gather_lobe.frag", self.atlas_target,
                                        textures={"u_match": self.match, "u_lobe": view.lobes[index]},
                                        uniforms={"u_row": row}, viewport=(0, row, w, h))
                        else:
                            self.atlas_target.clear(viewport=(0, row, w, h))
                    layer += 1
            device.ctx.finish()
            yield

    def _run(
        self, fragment: str, target: moderngl.Framebuffer, tile: tuple[int, int],
        textures: dict[str, moderngl.Texture], uniforms: Mapping[str, float | int],
    ) -> Iterator[None]:
        """One kernel over one tile, written in place into the whole maps.

        In bands of rows of about SLICE_SECONDS each, so that a window stays alive and no driver
        takes the GPU for hung.
        """
        x, y = tile
        w, end = min(self.tile[0], self.size - x), min(y + self.tile[1], self.size)
        while y < end:
            rows = min(self.bands.get(fragment, FIRST_ROWS), end - y)
            start = time.perf_counter()
            self.device.draw(fragment, target, textures={
                "u_texel_position": self.grid.position, "u_observations": self.atlas,
                "u_principled_table": self.observations.principled_table, **textures,
            }, uniforms={**self.uniforms, **uniforms, "u_tile": tile}, defines=self.layers.defines(),
                viewport=(x, y, w, rows))
            self.device.ctx.finish()
            took = time.perf_counter() - start
            fitting = int(rows * min(max(SLICE_SECONDS / max(took, 1e-6), 0.25), 2.0))
            self.bands[fragment] = min(max(fitting, 4), self.tile[1])
            y += rows
            yield

    def _noise(self, valleys: moderngl.Texture, support: moderngl.Texture) -> moderngl.Texture:
        """Log noise variance around each texel, at 1 / 2^NOISE_LEVELS of the size; sets the slack by its median."""
        device = self.device
        noise = device.texture(self.size, self.size)
        target = device.framebuffer([noise])
        device.draw("solve/noise.frag", target, textures={"u_valleys": valleys, "u_support": support}, uniforms={})
        target.release()
        for _ in range(NOISE_LEVELS):
            finer = noise
            noise = device.texture((finer.width + 1) // 2, (finer.height + 1) // 2)
            target = device.framebuffer([noise])
            device.draw("fill/down.frag", target, textures={"u_map": finer}, uniforms={})
            target.release()
            finer.release()
        values = device.read(noise)
        known = values[values[..., 3] > 0.1, 0]
        # With one view a camera nothing but the scatter between cameras tells: that is the noise then.
        variance = float(np.exp(np.median(known))) if len(known) else CAMERA_SLACK**2
        variance = max(variance, NOISE_FLOOR**2)
        self.uniforms["u_group_slack"] = float(np.clip(CAMERA_SLACK**2 / variance, 1.0, 1e5))
        return noise

    def _share(self, tables: tuple[moderngl.Texture, ...]) -> tuple[moderngl.Texture, moderngl.Texture]:
        """The pyramid: tables summed upwards, estimates handed downwards.  Returns (estimate, prior)."""
        device = self.device
        levels = [tables]
        while levels[-1][0].width > 8:
            below = levels[-1]
            half = (below[0].width + 1) // 2
            above = tuple(device.texture(half, half) for _ in range(8))
            target = device.framebuffer(list(above))
            device.draw("solve/pool.frag", target, textures={"u_table": below},
                        uniforms={"u_gain": POOL_GAIN})
            target.release()
            levels.append(above)
        parent: moderngl.Texture | None = None
        prior: moderngl.Texture | None = None
        for level in range(len(levels) - 1, -1, -1):
            table = levels[level]
            size = table[0].width
            estimate, given = device.texture(size, size), device.texture(size, size)
            target = device.framebuffer([estimate, given])
            device.draw("solve/descend.frag", target, textures={"u_table": table, "u_parent": parent}, uniforms={
                "u_top": parent is None, "u_step": ROUGHNESS_SLOPE / size, "u_prior_cut": PRIOR_CUT,
            })
            target.release()
            for texture in (parent, prior):
                if texture is not None:
                    texture.release()
            if level > 0:
                for texture in table:
                    texture.release()
            parent, prior = estimate, given
        assert parent is not None and prior is not None
        return parent, prior

    def release(self) -> None:
        """Free the tile's textures."""
        for thing in (self.atlas_target, self.match_target, self.atlas, self.match):
            thing.release()


