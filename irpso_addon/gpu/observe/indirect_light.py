"""Indirect light from small, noisy pictures to a camera's pixels: smoothed along the surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import moderngl

from ...core.data import F32, Bounced, Camera
from ..device.context import Device, Inputs
from ..gbuffer.gbuffer import GBufferMaps, MeshBuffer, Occluders, draw_pixel_grid
from ..gbuffer.projection import column_major, lens_defines

MEAN, SHARE = (5, 2.0), (1, 0.6)  # reach and width, in small pixels: over noise, and to the camera's pixels
Pair = tuple[moderngl.Texture, moderngl.Texture]  # irradiance and glossy radiance, RGB


class Smoother:
    """For one camera; what its small pictures see of the surface is drawn once.  Used within a scope of the device."""

    def __init__(
        self, device: Device, mesh: MeshBuffer, occluders: Occluders, camera: Camera, maps: GBufferMaps,
        uniforms: Callable[[Camera, int], dict[str, object]],
    ) -> None:
        """``maps``: the camera's pixels; ``uniforms``: of include/pixel.glsl for a picture so many pixels high.

        The small pictures are of the whole frame where the camera is a part of another.  A pinhole camera renders
        them: of what a lens shows beyond that one's frame, the frame's rim tells.
        """
        self.device, self.maps, self.uniforms, self.camera = device, maps, uniforms, camera
        self._small = replace(camera.whole or camera, lens=None)
        self._draw_grid = partial(draw_pixel_grid, device, mesh, occluders, self._small, footprint=0.0)
        self._grids: dict[tuple[int, int], GBufferMaps] = {}

    def smooth(self, bounced: Bounced) -> Pair:
        """A picture's light at the camera's pixels."""
        height, width = bounced.irradiance.shape[:2]
        if (width, height) not in self._grids:
            self._grids[width, height] = self._draw_grid(size=(width, height))
        grid = self._grids[width, height]
        with self.device.scope() as scope:
            noisy = self._upload(bounced.irradiance), self._upload(bounced.glossy)
            smooth = self._mean(noisy, grid, grid, self._small, MEAN)
            light = self._mean(smooth, grid, self.maps, self.camera, SHARE)
            scope.hand_over(*light)
            return light

    def _mean(
        self, light: Pair, grid: GBufferMaps, maps: GBufferMaps, camera: Camera, width: tuple[int, float],
    ) -> Pair:
        """The light of the pixels of ``grid`` at those of ``maps``, which ``camera`` sees."""
        device = self.device
        mean = device.texture(*maps.position.size), device.texture(*maps.position.size)
        inputs = Inputs({
            "u_position": maps.position, "u_normal": maps.normal, "u_small_position": grid.position,
            "u_small_normal": grid.normal, "u_small_irradiance": light[0], "u_small_glossy": light[1],
        }, {**self.uniforms(camera, maps.position.height), "u_part": camera.part, "u_reach": width[0],
            "u_sigma": width[1], "u_small_clip": column_major(self._small.projection @ self._small.world_to_camera)},
            lens_defines(camera.lens))
        with device.target(mean, clear=True) as target:
            device.draw("observe/bounced.frag", target, inputs, cells=maps.cells)
        return mean

    def _upload(self, array: F32) -> moderngl.Texture:
        return self.device.texture(array.shape[1], array.shape[0], 3, array)
