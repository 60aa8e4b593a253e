"""Method `paper`: a particle swarm per texel as Nagano, Collins, Chen and Nakano published it (docs/paper.md).

"GPU-Based Inverse Rendering With Multi-Objective Particle Swarm Optimization".  Each pass moves one
particle of every texel's swarm (shaders/solve/paper_move.kernel).  A swarm's state lies in float32 textures; a
pass reads those of the moving particle and writes spare ones, which then change places with them.
"""

from __future__ import annotations

import math
import random
import time
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import moderngl
import numpy as np

from ...core.data import F32
from ...core.errors import BadInput, Cancelled
from ...core.job import Progress
from ...core.live_maps import Live
from ...core.params import SolveSettings
from ..device.context import Device, Inputs
from ..observe.observation_atlas import TILE, ObservationAtlas, Source, Tile
from . import live_readback

LOBES = {"one-lobe": 1, "two-lobe": 2}
HALO = 4  # half windows beyond a tile's inner part that move along with it: its neighbours, and theirs


@dataclass(frozen=True)
class Limits:
    """What keeps a swarm together: nothing of it is in the paper, without it equation (2) diverges."""

    constriction: float = 0.7298  # factor of the new velocity; 1: none
    velocity: float = 0.3  # the most that a number may change in a pass; the box is 1 wide
    bounded: bool = True  # positions stay in their box, lobes in order


def limits_for(c1: float, c2: float) -> Limits:
    """Those for given pulls: Clerc and Kennedy 2002, eq. 14, for phi = c1 + c2; 0.7298 at the default and below it."""
    phi = max(c1 + c2, 4.1)
    return Limits(constriction=2.0 / abs(2.0 - phi - math.sqrt(phi * phi - 4.0 * phi)))


@dataclass(frozen=True)
class PaperMaps:
    """What the swarms found, on the texel grid; released by the caller."""

    best: moderngl.Texture  # base colour R, G, B; roughness1
    more: moderngl.Texture  # roughness2, weight of lobe 1, mean squared relative error, evaluations (0: no swarm)
    evaluations: int  # of the fitness, over all texels and tiles


class Swarms:
    """The swarms of one tile's texels."""

    def __init__(
        self, device: Device, source: Source, settings: SolveSettings, model: str, limits: Limits | None = None,
        tile: tuple[int, int] = TILE,
    ) -> None:
        if model not in LOBES:
            raise BadInput(f"method paper: searches the models {' and '.join(LOBES)}, not {model}; choose one of them")
        if settings.window % 2 == 0:
            raise BadInput(f"window: {settings.window} has no middle; choose an odd number of texels")
        self.device, self.source, self.settings, self.lobes = device, source, settings, LOBES[model]
        self.limits = limits or limits_for(settings.c1, settings.c2)
        self.atlas = ObservationAtlas(device, source, tile)
        w, h = self.atlas.tile
        layers = source.layers
        self.blocks = len(set(layers.groups)) + len(layers.groups) * (1 + layers.lights)  # of paper_prepare.kernel
        self.facts = device.texture(w, h * self.blocks)
        self._particles = [[device.texture(w, h) for _ in range(3 + self.lobes)] for _ in range(settings.particles + 1)]
        self._bests = [[device.texture(w, h) for _ in range(2)] for _ in range(2)]
        self._targets: dict[tuple[int, int], moderngl.Framebuffer] = {}
        self._defines = {**layers.defines(), "LOBES": str(self.lobes)}
        if self.lobes == 2 and settings.ndf == "beckmann":
            self._defines["NDF_BECKMANN"] = "1"
        self.tile: Tile = (0, 0)
        self.passes = 0
        self._forget()

    def _forget(self) -> None:
        self._place = list(range(self.settings.particles))  # in _particles, of each particle
        self._spare = self.settings.particles
        self._now = 0  # in _bests
        self._order = random.Random(self.settings.seed)
        self.passes = 0

    def gather(self, tile: Tile) -> Iterator[None]:
        """Take the tile's observations and put every particle in its first place."""
        self._forget()
        self.tile = tile
        for textures in self._bests:  # first: somebody may look while observations are gathered
            with self.device.target(textures, clear=True):
                pass
        yield from self.source.gather(self.atlas, tile, True)
        w, h = self.atlas.tile
        with self.device.target([self.facts]) as target:
            for block in range(self.blocks):
                self.device.kernel("solve/paper_prepare.kernel", target, Inputs({
                    "u_texel_position": self.source.position, "u_observations": self.atlas.texture,
                }, {
                    **self.atlas.uniforms, "u_tile": tile, "u_group_slack": 0.0, "u_block": block,
                    "u_first": (-tile[0], block * h - tile[1]),
                }, {**self._defines, "COLOUR": "1"}), (0, block * h, w, h))
        for particle in range(self.settings.particles):
            self._move(particle, 0)
        self.device.budget.finish()
        yield

    def step(self) -> None:
        """One pass: a random particle, the same in all texels."""
        self.passes += 1
        self._move(int(self._order.random() * self.settings.particles), self.passes)

    def _move(self, particle: int, number: int) -> None:
        settings, textures = self.settings, self._particles[self._place[particle]]
        best, more = self._bests[self._now]
        inputs = {"u_facts": self.facts, "u_principled_table": self.source.principled_table, "u_best": best,
                  "u_best_more": more, "u_position": textures[0], "u_velocity": textures[1], "u_own": textures[2],
                  "u_own_more": textures[3]}
        if self.lobes == 2:
            inputs["u_tail"] = textures[4]
        uniforms: dict[str, Any] = {"u_particle": particle, "u_pass": number}
        if number == 0:  # the rest stays as it is until the next tile
            uniforms |= {
                "u_tile": self.tile, "u_tile_height": self.atlas.tile[1], "u_seed": settings.seed,
                "u_pull": (settings.c1, settings.c2, settings.c3), "u_reach": settings.window // 2,
                "u_done": settings.threshold**2, "u_constriction": self.limits.constriction,
                "u_velocity_max": self.limits.velocity, "u_bounded": self.limits.bounded,
            }
        w, h = (min(a, b - c) for a, b, c in zip(self.atlas.tile, self.source.size, self.tile, strict=True))
        self.device.kernel("solve/paper_move.kernel", self._target(), Inputs(inputs, uniforms, self._defines),
                           (0, 0, w, h))
        self._place[particle], self._spare = self._spare, self._place[particle]
        self._now = 1 - self._now

    def _target(self) -> moderngl.Framebuffer:
        key = self._spare, self._now
        if key not in self._targets:
            self._targets[key] = self.device.framebuffer([*self._bests[1 - self._now], *self._particles[self._spare]])
        return self._targets[key]

    @property
    def best(self) -> tuple[moderngl.Texture, moderngl.Texture]:
        """The texels' bests, as in PaperMaps; the next pass overwrites neither of these two."""
        best, more = self._bests[self._now]
        return best, more

    def rest(self) -> bool:
        """Whether every swarm is below the threshold."""
        more = self.device.read(self.best[1])
        return bool((more[more[..., 3] > 0, 2] <= np.float32(self.settings.threshold**2)).all())

    def positions(self) -> F32:
        """(m, h, w, 4 or 6): base colour, roughness1, and with two lobes roughness2 and weight of every particle."""
        particles = []
        for place in self._place:
            textures = self._particles[place]
            head = self.device.read(textures[0])
            tail = self.device.read(textures[4])[..., :2] if self.lobes == 2 else head[..., :0]
            particles.append(np.concatenate([head, tail], axis=-1))
        return np.stack(particles)

    def release(self) -> None:
        """Free the state."""
        for target in self._targets.values():
            target.release()
        for texture in (self.facts, *(t for group in (*self._particles, *self._bests) for t in group)):
            texture.release()
        self.atlas.release()


class PaperSwarm:
    """All texels of a source, tile by tile.  Tiles overlap, so that a texel's neighbours always move with it."""

    def __init__(
        self, device: Device, source: Source, settings: SolveSettings, model: str, tile: tuple[int, int] = TILE,
    ) -> None:
        self.device, self.source, self.settings = device, source, settings
        self.swarms = Swarms(device, source, settings, model, tile=tile)
        self.cancelled = False

    def solve(self) -> Generator[Progress, None, PaperMaps]:
        """Run every tile's passes.  When stopped, the tile at hand gives what it has and later ones have no swarm."""
        device, swarms = self.device, self.swarms
        best, more = (device.texture(*self.source.size) for _ in range(2))
        tiles = self._tiles()
        with device.target([best, more], clear=True) as target:
            for i, (tile, inner) in enumerate(tiles):
                for part in self._run(tile):
                    try:
                        yield Progress(
                            (i + part) / len(tiles), "solve",
                            f"tile {i + 1} of {len(tiles)}, pass {swarms.passes} of {self.settings.iterations}",
                            partial(self._look, (best, more), tile, inner))
                    except Cancelled:
                        self.cancelled = True
                bests = dict(zip(("u_best", "u_more"), swarms.best, strict=True))
                device.kernel("solve/paper_keep.kernel", target, Inputs(bests, {"u_tile": tile}), inner)
                if self.cancelled:
                    break
        return PaperMaps(best, more, int(device.read(more)[..., 3].sum(dtype=np.float64)))

    def _look(
        self, done: tuple[moderngl.Texture, moderngl.Texture], tile: Tile, inner: tuple[int, int, int, int],
    ) -> Live:
        """The tiles that are done, and the one at hand."""
        maps = [self.device.read(texture).copy() for texture in done]
        x, y, w, h = inner
        for whole, texture in zip(maps, self.swarms.best, strict=True):
            left, low = x - tile[0], y - tile[1]
            whole[y:y + h, x:x + w] = self.device.read(texture)[low:low + h, left:left + w]
        return live_readback.swarm(*maps)

    def _run(self, tile: Tile) -> Iterator[float]:
        """One tile's passes, in slices; yields the share done."""
        swarms, count = self.swarms, self.settings.iterations
        for _ in swarms.gather(tile):
            yield 0.0
        slice_passes = 1
        while swarms.passes < count and not self.cancelled:
            start = time.perf_counter()
            for _ in range(min(slice_passes, count - swarms.passes)):
                swarms.step()
            self.device.budget.finish()
            pace = self.device.settings.slice / 1000 / max(time.perf_counter() - start, 1e-6)
            slice_passes = max(int(slice_passes * min(max(pace, 0.25), 4.0)), 1)
            yield swarms.passes / count
            if self.settings.threshold > 0 and swarms.rest():
                return

    def _tiles(self) -> list[tuple[Tile, tuple[int, int, int, int]]]:
        """(first texel, region that it solves) of each tile with covered texels there."""
        covered = self.device.read(self.source.position)[..., 3] > 0.5
        halo = HALO * (self.settings.window // 2) if self.settings.c3 > 0 else 0
        across, along = (spans(length, tile, halo)
                         for length, tile in zip(self.source.size, self.swarms.atlas.tile, strict=True))
        return [((x, y), (left, low, right - left, high - low)) for y, low, high in along for x, left, right in across
                if covered[low:high, left:right].any()]

    def release(self) -> None:
        """Free the swarms; the maps of the solution stay."""
        self.swarms.release()


def spans(length: int, tile: int, halo: int) -> list[tuple[int, int, int]]:
    """Tiles of one axis: (first texel, first and end of what it solves).  They overlap by two halos, where they can."""
    halo = min(halo, tile // 4)
    starts = [0]
    while starts[-1] + tile < length:
        starts.append(starts[-1] + tile - 2 * halo)
    borders = [0, *(start + halo for start in starts[1:]), length]
    return [(start, borders[i], borders[i + 1]) for i, start in enumerate(starts)]
