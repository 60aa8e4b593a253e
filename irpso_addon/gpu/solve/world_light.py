"""Worlds as they light a sample of texels under other turns, shadows included."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...core.calibration.world_sample import Around, WorldSample
from ...core.data import F32, F64, Bool, Environment, SceneData
from ...core.job import Progress, Steps
from ...core.shading import environment as model
from ..device.context import Device
from ..gbuffer.gbuffer import GBufferMaps, MeshBuffer, Occluders
from ..observe.environment_light import LitByEnvironment, node_places
from ..observe.observation_atlas import CameraSource
from ..observe.visibility import LightVisibility
from .calibration_sample import sampled, views_of

DIRECTIONS = 128  # that stand for an environment: 256 turn worlds no better, ...
FEWEST = 32  # ... nor fewer of each where there are many: the errors of their shadows average out
ALL = 768  # of all environments, as far as FEWEST allows
WIDTH = 32  # texels: of the grid that holds the sample
Key = tuple[str, float]


@dataclass
class SampleTexels:
    """The sample's texels that a camera sees, as if they were its pixels."""

    maps: GBufferMaps
    uniforms: dict[str, object]
    defines: dict[str, str]


def directions_each(environments: int) -> int:
    """How many directions stand for each of so many environments while worlds are judged."""
    return max(min(DIRECTIONS, ALL // max(environments, 1)), FEWEST)


def sample_grids(device: Device, surface: tuple[F32, F32, F32], some: Bool) -> GBufferMaps:
    """Some of (T, 4) texels each, as of GBufferMaps, side by side in grids that have room for all.

    Pixels that run together are then all to be lit, and grids of all cameras have one size, so one program.
    """
    height = -(-len(some) // WIDTH)
    grids = np.zeros((3, height * WIDTH, 4), np.float32)
    grids[:, :some.sum()] = [values[some] for values in surface]
    position, normal, facet = (device.texture(WIDTH, height, 4, of.reshape(height, WIDTH, 4)) for of in grids)
    return GBufferMaps(position, normal, facet)


class WorldLight:
    """Of one sample; textures belong to the scope."""

    def __init__(
        self, device: Device, source: CameraSource, mesh: MeshBuffer, scene: SceneData, surface: tuple[F32, F32, F32],
        seen: Bool,
    ) -> None:
        """``surface``: (T, 4) each, as of GBufferMaps; ``seen``: (T, cameras) by which camera."""
        self.device, self.seen = device, seen
        self.cameras = [SampleTexels(
            sample_grids(device, surface, own), {**camera.uniforms, "u_footprint": 0.0}, camera.defines)
            for camera, own in zip(source.observations.cameras, seen.T, strict=True)]
        self.visibility = LightVisibility(device, mesh, Occluders(device, scene.casters), 1)
        views, of_layer = views_of(source)
        self.layers = [views[place].environment for place in of_layer]  # of each layer
        self.groups = [divmod(group, source.layers.channels) for group in source.layers.groups]  # camera, channel
        self.grey = source.layers.channels == 1
        found = {each.world: each for each in self.layers if each is not None}
        self.keys: list[Key] = list(found)
        self.environments: list[Environment] = list(found.values())
        count = directions_each(len(found))
        self.directions = {each.world: model.directions(each, count) for each in self.environments}
        self._kept: dict[tuple[Key, float], dict[int, tuple[F32, F32]]] = {}

    def __call__(self, turns: F64) -> Steps[Around]:
        """As of `LightAt`."""
        for key, turn in zip(self.keys, turns, strict=True):
            if (key, float(turn)) not in self._kept:
                for _ in self._draw(key, float(turn)):
                    yield Progress(0.0, "calibrate", f"light of {key[0]}")
        shape = len(self.seen), len(self.layers), 3 if self.grey else 1
        around = Around(np.zeros(shape), np.zeros((*shape[:2], 2, model.NODES)))
        for v, (environment, (camera, channel)) in enumerate(zip(self.layers, self.groups, strict=True)):
            if environment is None:
                continue
            turn = float(turns[self.keys.index(environment.world)])
            irradiance, nodes = self._kept[environment.world, turn][camera]
            around.irradiance[:, v] = irradiance if self.grey else irradiance[:, channel:channel + 1]
            sent = nodes[..., :3].mean(-1) if self.grey else nodes[..., channel]
            around.nodes[:, v, 0] = np.log(np.maximum(sent, model.LEAST))
            around.nodes[:, v, 1] = nodes[..., 3]
        return around

    def _draw(self, key: Key, turn: float) -> Iterator[None]:
        """The light of one environment, turned by so much, at the cameras that have it."""
        device, kept = self.device, {}
        with device.scope():
            lit = LitByEnvironment(device, self.visibility, self.directions[key].turned(turn))
            for _ in lit.draw_shadows():
                yield
            chosen = {camera for environment, (camera, _) in zip(self.layers, self.groups, strict=True)
                      if environment is not None and environment.world == key}
            for camera in chosen:
                for made in lit.light(self.cameras[camera]):
                    if made is None:
                        continue
                    own = self.seen[:, camera]
                    irradiance = np.zeros((len(own), 3), np.float32)
                    nodes = np.zeros((len(own), model.NODES, 4), np.float32)
                    irradiance[own] = device.read(made.irradiance).reshape(-1, 4)[:own.sum(), :3]
                    nodes[own] = np.stack([device.read(made.nodes, place).reshape(-1, 4)[:own.sum()]
                                           for place in node_places(*made.irradiance.size)], 1)
                    kept[camera] = irradiance, nodes
                yield
        self._kept[key, turn] = kept


def world_sample(
    source: CameraSource, maps: GBufferMaps, texels: Bool, seed: int, scene: SceneData, mesh: MeshBuffer,
) -> Steps[tuple[WorldSample, WorldLight]]:
    """Texels from all over the object, and the light on them; textures belong to the scope.

    ``maps``: of the grid of texels; ``texels``: (h, w) those to choose from.
    """
    rig, surface = sampled(source, texels, seed, scene.scale_known, facet=maps.facet)
    cameras = range(len(source.observations.cameras))
    seen = np.stack([(rig.texels.quality[:, rig.texels.camera == n] > 0).any(1) for n in cameras], -1)
    light = WorldLight(source.device, source, mesh, scene, surface, seen)
    given = yield from light(np.zeros(len(light.keys)))
    key = [-1 if each is None else light.keys.index(each.world) for each in light.layers]
    lamps = any(view.lights for view in scene.views)
    return WorldSample(rig, tuple(light.keys), np.array(key, np.int32), lamps, given), light
