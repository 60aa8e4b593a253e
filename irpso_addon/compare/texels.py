"""Views at the texels and at their own pixels, as arrays: what `irpso compare` judges methods by."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..core.data import F32, I32, Bool, RadianceImage, SceneData, View
from ..core.evaluation.prediction import Pixels, PlaceView
from ..core.job import Progress
from ..core.shading.emitters import around_irradiance
from ..core.shading.environment import COUNT, LEAST
from ..core.shading.lights import light_irradiance
from ..gpu.device import thread
from ..gpu.device.context import Device
from ..gpu.gbuffer.gbuffer import MeshBuffer
from ..gpu.gbuffer.texel_grid import draw_texels
from ..gpu.observe.environment_light import node_places
from ..gpu.observe.observation_atlas import CameraSource, Layers, ObservationAtlas, tiles
from ..gpu.observe.observations import EDGE_QUALITY, ObservedCamera, ObservedView, observe

MOST = 10_000  # pixels of a view whose irradiance is found
Result = TypeVar("Result")


@dataclass(frozen=True)
class Grid:
    """The texel grid of a map."""

    covered: Bool  # (n, n)
    slots: I32  # (n, n) material slot; -1 where not covered


def observe_texels(
    scene: SceneData, size: int, read_image: Callable[[View], RadianceImage],
    digest: Callable[[Bool, list[PlaceView]], Result],
) -> Generator[Progress, None, tuple[Grid, list[Result]]]:
    """Runs on the GL thread.  The grid, and what ``digest`` makes of each of its tiles.

    It is given the tile's covered texels (n, n) and the scene's views there, in the order of the cameras.
    """
    device = thread.device()
    with device.scope():
        grid = draw_texels(device, scene.mesh, size)
        observations = yield from observe(device, scene, grid.mesh, read_image)
        source = CameraSource(device, grid.maps, observations)
        atlas = ObservationAtlas(device, source)
        covered, parts = grid.coverage, []
        width, height = atlas.tile
        for x, y in tiles(atlas, covered):
            for _ in source.gather(atlas, (x, y), True):
                yield Progress(1.0, "observe")
            inside = np.zeros_like(covered)
            inside[y:y + height, x:x + width] = covered[y:y + height, x:x + width]
            blocks = device.read(atlas.texture).reshape(source.layers.blocks, height, width, 4)
            part = inside[y:y + height, x:x + width]
            here = blocks[:, :part.shape[0], :part.shape[1]][:, part]
            parts.append(digest(inside, _views(here, source.layers)))
        return Grid(covered, grid.slots), parts


def observe_pixels(
    scene: SceneData, read_image: Callable[[View], RadianceImage],
) -> Generator[Progress, None, list[tuple[Pixels, list[PlaceView]]]]:
    """Runs on the GL thread.  For each camera its pixels that show the object, and its views there."""
    device = thread.device()
    with device.scope():
        observations = yield from observe(device, scene, MeshBuffer(device, scene.mesh), read_image)
        return [_camera(device, camera, scene.pixel_filter) for camera in observations.cameras]


def _camera(device: Device, camera: ObservedCamera, footprint: float) -> tuple[Pixels, list[PlaceView]]:
    """One camera's pixels and views."""
    maps = camera.maps
    assert maps.uv is not None and maps.uv_slope is not None
    position = device.read(maps.position)
    inside = position[..., 3] > 0.5
    position, normal = position[inside, :3], device.read(maps.normal)[inside, :3]
    towards = camera.camera.position - position
    towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    if camera.camera.orthographic:
        towards = np.broadcast_to(-camera.camera.forward, towards.shape)
    cos_v = (towards * normal).sum(-1).astype(np.float32)
    pixels = Pixels(device.read(maps.uv)[inside], device.read(maps.uv_slope)[inside], footprint)
    views = []
    for view in camera.views:
        colour = device.read(view.colour)[inside]
        edge = colour[:, 3] < EDGE_QUALITY * cos_v**2  # a good pixel has cos_v^2
        good = (colour[:, :3] >= 0) & ~edge[:, None]  # a channel without light is negative
        none = np.zeros((len(cos_v), 0, 4), np.float32)
        lobes = np.stack([device.read(lobe)[inside] for lobe in view.lobes], 1) if view.lobes else none
        channels = max(len(view.lobes) // max(len(view.view.lights), 1), 1)
        lobes = lobes.reshape(len(lobes), -1, channels, 4).swapaxes(1, 2)  # (P, channels, L, 4)
        views.append(PlaceView(
            rgb=np.where(good, colour[:, :3], 0), weight=(good * colour[:, 3:]).astype(np.float32), cos_v=cos_v,
            lobes=np.broadcast_to(lobes, (len(lobes), 3, *lobes.shape[2:])),
            irradiance=_irradiance(view.view, position, normal), nodes=_nodes(device, view, inside)))
    return pixels, views


def _nodes(device: Device, view: ObservedView, inside: Bool) -> F32 | None:
    """(P, 3, 2, NODES) of the view's environment at its pixels."""
    if view.nodes is None:
        return None
    height, width = inside.shape
    parts = np.stack([device.read(view.nodes, place)[inside] for place in node_places(width, height)], -1)  # (P, 4, K)
    logs = np.log(np.maximum(parts[:, :3], np.float32(LEAST)))
    return np.stack([logs, np.broadcast_to(parts[:, 3:], logs.shape)], 2)


def _irradiance(view: View, position: F32, normal: F32) -> F32:
    """(P, 3) at some of the places, NaN at the others: that of a wide lamp takes time."""
    some = np.unique(np.linspace(0, max(len(position) - 1, 0), min(len(position), MOST)).astype(int))
    result = np.full((len(position), 3), np.nan, np.float32)
    result[some] = sum((light_irradiance(light, position[some], normal[some])[:, None] * light.power
                        for light in view.lights), np.zeros((len(some), 3)))
    if view.environment is not None:
        result[some] += around_irradiance(view.environment, position[some], normal[some], COUNT)
    return result


def _views(blocks: F32, layers: Layers) -> list[PlaceView]:
    """Blocks (B, T, 4) of an atlas as views.  Where channels are layers of their own, three layers are one view."""
    per_layer = blocks.reshape(len(layers.groups), layers.each, *blocks.shape[1:])
    if layers.channels == 1:
        return [_view([layer] * 3, layers) for layer in per_layer]
    views = []
    groups = np.array(layers.groups)
    for camera in range(int(groups.max()) // 3 + 1):
        channels = [per_layer[groups == 3 * camera + channel] for channel in range(3)]
        views += [_view(list(three), layers) for three in zip(*channels, strict=True)]
    return views


def _view(channels: list[F32], layers: Layers) -> PlaceView:
    """One view from its layer (blocks, T, 4) for each of R, G and B."""
    first = np.stack([layer[0] for layer in channels])  # (3, T, 4): f, quality, cos_v, flags
    edge = np.floor(first[..., 3]).astype(int) % 2 == 1
    lobes = np.stack([layer[2:2 + layers.lights] for layer in channels])  # (3, L, T, 4)
    nodes = None
    if layers.environment:
        held = np.stack([layer[2 + layers.lights:] for layer in channels])  # (3, blocks, T, 4)
        nodes = np.moveaxis(held, 2, 0).reshape(held.shape[2], 3, 2, -1)
    return PlaceView(
        rgb=channels[0][1, :, :3].copy(), weight=np.where(edge, 0, first[..., 1]).T.astype(np.float32),
        cos_v=first[..., 2].max(0), lobes=np.moveaxis(lobes, 2, 0).copy(), nodes=nodes)
