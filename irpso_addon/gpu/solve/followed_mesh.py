"""The mesh that follows its refined normals, where pictures of different cameras then agree better."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import moderngl
import numpy as np

from ...core import log
from ...core.data import F32, I32, Bool, SceneData, View
from ...core.normals.follow_judge import CameraPair, judged
from ...core.normals.moved_mesh import MOST, moved
from ..device.context import Device, Inputs
from ..gbuffer.gbuffer import GBufferMaps, MeshBuffer, draw_texel_grid
from ..observe.observations import Observations, ObservedCamera, ObservedView
from .calibration_sample import cells_of
from .material_sample import SIDE, Squares, spread_squares

TEXELS, SHOWN = 65_536, 4_000_000  # at most; of them in all views
LEAST_COSINE = 0.25  # between normal and view
LEAST_QUALITY = 0.5  # of a good pixel's
DARKEST = 1e-5  # 1/sr


def may_follow(scene: SceneData) -> bool:
    """Whether the mesh is small enough, and some pictures by two cameras have the same light."""
    cameras: dict[object, set[str]] = {}
    for view in scene.views:
        cameras.setdefault(_light(view), set()).add(view.camera.name)
    return len(scene.mesh.positions) <= MOST and any(len(names) > 1 for names in cameras.values())


def followed(
    device: Device, observations: Observations, mesh: MeshBuffer, maps: GBufferMaps, texels: Bool, seed: int,
) -> F32 | None:
    """(T, 3, 3) positions of the mesh's triangles, in their order; None: it stays as it is given.

    ``maps``: of the texel grid; ``texels``: (h, w) those to look at.
    """
    assert mesh.offsets is not None
    positions = moved(mesh.mesh, mesh.offsets)
    if positions is None:
        return None
    count = sum(len(camera.views) for camera in observations.cameras)
    squares = spread_squares(texels, min(TEXELS, SHOWN // max(count, 1)) // SIDE**2, seed)
    with device.scope():
        after = MeshBuffer(device, replace(mesh.mesh, positions=positions))
        grids = maps, draw_texel_grid(device, after, len(texels))
        places = [squares.pack_texture(device, grid.position) for grid in grids]
        normal = squares.pack_texture(device, maps.normal)
        pairs = list(_pairs(device, observations, squares, places, normal))
    found = judged(pairs, cells_of(places[0][..., :3].reshape(-1, 3).astype(np.float64)))
    if found is not None:
        log.info("mesh", share=round(found.share, 3), error=round(found.error, 3))
    return positions if found is not None and found.pays else None


def _pairs(
    device: Device, observations: Observations, squares: Squares, places: list[F32], normal: F32,
) -> Iterator[CameraPair]:
    """Of pictures with the same light, each camera and the next."""
    height, width = squares.shape
    textures = [device.texture(width, height, data=values) for values in places]
    normals, shown = device.texture(width, height, data=normal), device.texture(width, height)
    by_light: dict[tuple[object, ...], list[list[F32]]] = {}
    for camera in observations.cameras:
        for view in camera.views:
            by_light.setdefault(_light(view.view), []).append([
                _shown(device, camera, view, (texture, normals), shown) for texture in textures])
    for pictures in by_light.values():
        ends = pictures[1:] + (pictures[:1] if len(pictures) > 2 else [])
        for one, other in zip(pictures, ends, strict=False):
            texels: I32 = np.flatnonzero(np.logical_and.reduce(
                [np.isfinite(values[0]) for values in (*one, *other)])).astype(np.int32)
            given, after = (a[:, texels] - b[:, texels] for a, b in zip(one, other, strict=True))
            yield CameraPair(texels, given, after)


def _light(view: View) -> tuple[object, ...]:
    """What two pictures with the same light have in common."""
    return tuple(light.name for light in view.lights), view.environment and view.environment.key


def _shown(
    device: Device, camera: ObservedCamera, view: ObservedView, places: tuple[moderngl.Texture, moderngl.Texture],
    target: moderngl.Texture,
) -> F32:
    """(3, N) logarithms of what a view shows at places, as of observe/between.frag; NaN where it shows none."""
    with device.target([target], clear=True) as drawn:
        device.draw("observe/between.frag", drawn, Inputs({
            "u_place": places[0], "u_place_normal": places[1], "u_position": camera.maps.position,
            "u_colour": view.colour,
        }, {**camera.uniforms, **camera.projection.uniforms},
            {**camera.defines, "LEAST_COSINE": str(LEAST_COSINE), "LEAST_QUALITY": str(LEAST_QUALITY)}))
    shown = device.read(target).reshape(-1, 4)
    logs: F32 = np.log(np.maximum(np.ascontiguousarray(shown[:, :3].T), np.float32(DARKEST)))
    logs[:, shown[:, 3] <= 0] = np.nan
    return logs
