"""Worlds as they light a sample of texels under other turns, or under other normals, shadows included."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.calibration.world_sample import Around, WorldSample
from ...core.data import F32, F64, Bool, Environment, SceneData, View
from ...core.job import Progress, Steps
from ...core.normals.tilt_sample import TiltedWorlds
from ...core.shading import environment as model
from ...core.shading.lights import light_basis
from ..device.context import Device
from ..gbuffer.gbuffer import GBufferMaps, MeshBuffer, Occluders
from ..observe.environment_light import LitByEnvironment, node_places
from ..observe.observation_atlas import CameraSource
from ..observe.visibility import LightVisibility
from .calibration_sample import sampled, views_of

DIRECTIONS = 128  # that stand for an environment: 256 turn worlds no better, ...
FEWEST = 32  # ... nor fewer of each where there are many: the errors of their shadows average out
MOST = 6  # environments with so many directions each, as far as FEWEST allows
TILTED = 64  # directions where normals tilt: twice as many say the same tilts
MOST_TILTED = 64  # environments there: shadow maps of each take 8 MB
WIDTH = 32  # texels: of the grid that holds the sample
TILT = 0.1  # radians: for slopes
Key = tuple[str, float]
Light = dict[int, tuple[F32, F32]]  # of one environment, by camera: (T, 3) irradiance, (T, NODES, 4) of its lobe


@dataclass
class SampleTexels:
    """The sample's texels that a camera sees, as if they were its pixels."""

    maps: GBufferMaps
    uniforms: dict[str, object]
    defines: dict[str, str]


def directions_each(environments: int, most: int = DIRECTIONS) -> int:
    """How many directions, at most so many, stand for each of so many environments while they are judged."""
    return max(min(most, MOST * most // max(environments, 1)), FEWEST)


def sample_grids(device: Device, surface: tuple[F32, F32, F32], some: Bool) -> GBufferMaps:
    """Some of (T, 4) texels each, as of GBufferMaps, side by side in grids that have room for all.

    Pixels that run together are then all to be lit, and grids of all cameras have one size, so one program.
    """
    height = 1 << (-(-len(some) // WIDTH) - 1).bit_length()  # decision 0044
    grids = np.zeros((3, height * WIDTH, 4), np.float32)
    grids[:, :some.sum()] = [values[some] for values in surface]
    position, normal, facet = (device.texture(WIDTH, height, 4, of.reshape(height, WIDTH, 4)) for of in grids)
    return GBufferMaps(position, normal, facet)


class Worlds:
    """The environments of all layers, and the directions that stand for them."""

    def __init__(self, source: CameraSource, mesh: MeshBuffer, scene: SceneData, stage: str, most: int) -> None:
        """``stage``: as of Progress.  ``most``: directions of an environment."""
        self.device, self.cameras, self.stage = source.device, source.observations.cameras, stage
        self.visibility = LightVisibility(self.device, mesh, Occluders(self.device, scene.casters), 1)
        views, of_layer = views_of(source)
        self.layers = [views[place].environment for place in of_layer]  # of each layer
        self.groups = [divmod(group, source.layers.channels) for group in source.layers.groups]  # camera, channel
        self.grey = source.layers.channels == 1
        found = {each.world: each for each in self.layers if each is not None}
        self.keys: list[Key] = list(found)
        self.environments: list[Environment] = list(found.values())
        count = directions_each(len(found), most)
        self.directions = {each.world: model.directions(each, count) for each in self.environments}

    def texels_of(self, surface: tuple[F32, F32, F32], seen: Bool) -> list[SampleTexels]:
        """Those that each camera sees.  ``surface``: (T, 4) each, as of GBufferMaps; ``seen``: (T, cameras)."""
        return [SampleTexels(sample_grids(self.device, surface, own), {**camera.uniforms, "u_footprint": 0.0},
                             camera.defines) for camera, own in zip(self.cameras, seen.T, strict=True)]

    def draw(self, key: Key, lit: LitByEnvironment, texels: list[SampleTexels], seen: Bool) -> Steps[Light]:
        """The light of one environment at the cameras that have it; ``texels``: as of `texels_of`."""
        device, kept = self.device, Light()
        chosen = {camera for environment, (camera, _) in zip(self.layers, self.groups, strict=True)
                  if environment is not None and environment.world == key}
        for camera in chosen:
            with device.scope():
                for made in lit.light(texels[camera]):
                    if made is None:
                        continue
                    own = seen[:, camera]
                    irradiance = np.zeros((len(own), 3), np.float32)
                    nodes = np.zeros((len(own), model.NODES, 4), np.float32)
                    irradiance[own] = device.read(made.irradiance).reshape(-1, 4)[:own.sum(), :3]
                    nodes[own] = np.stack([device.read(made.nodes, place).reshape(-1, 4)[:own.sum()]
                                           for place in node_places(*made.irradiance.size)], 1)
                    kept[camera] = irradiance, nodes
            yield Progress(0.0, self.stage, f"light of {key[0]}")
        return kept

    def around(self, texels: int, light: Callable[[Key], Light]) -> Around:
        """Of all layers, at so many texels; ``light``: of each environment, as of `draw`."""
        shape = texels, len(self.layers), 3 if self.grey else 1
        around = Around(np.zeros(shape), np.zeros((*shape[:2], 2, model.NODES)))
        for v, (environment, (camera, channel)) in enumerate(zip(self.layers, self.groups, strict=True)):
            if environment is None:
                continue
            irradiance, nodes = light(environment.world)[camera]
            around.irradiance[:, v] = irradiance if self.grey else irradiance[:, channel:channel + 1]
            sent = nodes[..., :3].mean(-1) if self.grey else nodes[..., channel]
            around.nodes[:, v, 0] = np.log(np.maximum(sent, model.LEAST))
            around.nodes[:, v, 1] = nodes[..., 3]
        return around


class WorldLight:
    """Of one sample; textures belong to the scope."""

    def __init__(self, worlds: Worlds, surface: tuple[F32, F32, F32], seen: Bool) -> None:
        """``surface``, ``seen``: as of `Worlds.texels_of`."""
        self.worlds, self.seen = worlds, seen
        self.texels = worlds.texels_of(surface, seen)
        self._kept: dict[tuple[Key, float], Light] = {}

    def __call__(self, turns: F64) -> Steps[Around]:
        """As of `LightAt`."""
        by = dict(zip(self.worlds.keys, map(float, turns), strict=True))
        for key, turn in by.items():
            if (key, turn) not in self._kept:
                self._kept[key, turn] = yield from self._draw(key, turn)
        return self.worlds.around(len(self.seen), lambda key: self._kept[key, by[key]])

    def _draw(self, key: Key, turn: float) -> Steps[Light]:
        """The light of one environment, turned by so much."""
        device = self.worlds.device
        with device.scope():
            lit = LitByEnvironment(device, self.worlds.visibility, self.worlds.directions[key].turned(turn))
            for _ in lit.draw_shadows():
                yield Progress(0.0, self.worlds.stage, f"light of {key[0]}")
            return (yield from self.worlds.draw(key, lit, self.texels, self.seen))


def too_many_to_tilt(views: Sequence[View]) -> str:
    """Why normals are not looked at under the views' worlds; "" where they are."""
    count = len({view.environment.world for view in views if view.environment is not None})
    return f"worlds with more than {MOST_TILTED} turns light the views" if count > MOST_TILTED else ""


class TiltedLight:
    """How the light of all worlds changes as normals tilt; shadow maps belong to the scope."""

    def __init__(self, source: CameraSource, mesh: MeshBuffer, scene: SceneData) -> None:
        self.worlds = Worlds(source, mesh, scene, "normals", TILTED)
        self.lit: dict[Key, LitByEnvironment] = {}

    def __call__(self, surface: tuple[F32, F32, F32], seen: Bool) -> Steps[TiltedWorlds]:
        """``surface``, ``seen``: as of `Worlds.texels_of`.  Other textures than shadow maps are freed."""
        worlds = self.worlds
        yield from self._draw_shadows()
        tilted, light = _tilted(surface), dict[Key, Light]()
        with worlds.device.scope():
            three = np.tile(seen, (3, 1))
            texels = worlds.texels_of(tilted, three)
            for key, lit in self.lit.items():
                light[key] = yield from worlds.draw(key, lit, texels, three)
        around = worlds.around(len(three), light.__getitem__)
        irradiance = np.log(np.maximum(around.irradiance.mean(-1), model.LEAST)).reshape(3, *seen.shape[:1], -1)
        lobe = around.nodes[:, :, 0].reshape(*irradiance.shape, -1) + irradiance[..., None]
        return TiltedWorlds(np.moveaxis(irradiance[1:] - irradiance[0], 0, -1) / TILT,
                            np.moveaxis(lobe[1:] - lobe[0], 0, -1) / TILT)

    def _draw_shadows(self) -> Steps[None]:
        """Once."""
        worlds = self.worlds
        for key in worlds.keys if not self.lit else ():
            self.lit[key] = LitByEnvironment(worlds.device, worlds.visibility, worlds.directions[key])
            for _ in self.lit[key].draw_shadows():
                yield Progress(0.0, worlds.stage, f"light of {key[0]}")


def _tilted(surface: tuple[F32, F32, F32]) -> tuple[F32, F32, F32]:
    """(3 T, 4) each: texels as they are given, tilted along A, and along B (as of `TiltSample`)."""
    position, normal, facet = (np.tile(each, (3, 1)) for each in surface)
    count = len(surface[0])
    for n, axis in enumerate(light_basis(surface[1][:, :3].astype(np.float64)), 1):
        some = slice(n * count, (n + 1) * count)
        turned = normal[some, :3] + TILT * axis
        normal[some, :3] = turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), model.LEAST)
    return position, normal, facet


def world_sample(
    source: CameraSource, maps: GBufferMaps, texels: Bool, seed: int, scene: SceneData, mesh: MeshBuffer,
) -> Steps[tuple[WorldSample, WorldLight]]:
    """Texels from all over the object, and the light on them; textures belong to the scope.

    ``maps``: of the grid of texels; ``texels``: (h, w) those to choose from.
    """
    rig, surface = sampled(source, texels, seed, scene.scale_known, facet=maps.facet)
    cameras = range(len(source.observations.cameras))
    seen = np.stack([(rig.texels.quality[:, rig.texels.camera == n] > 0).any(1) for n in cameras], -1)
    worlds = Worlds(source, mesh, scene, "calibrate", DIRECTIONS)
    light = WorldLight(worlds, surface, seen)
    given = yield from light(np.zeros(len(worlds.keys)))
    key = [-1 if each is None else worlds.keys.index(each.world) for each in worlds.layers]
    lamps = any(view.lights for view in scene.views)
    return WorldSample(rig, tuple(worlds.keys), np.array(key, np.int32), lamps, given), light
