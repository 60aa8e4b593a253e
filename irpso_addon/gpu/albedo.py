"""Roughness and observations -> base colour: the texture whose footprint averages are what pixels show.

Iterative back-projection (Irani and Peleg 1991): a pixel sees the mean of the texture over its
footprint, so cameras at different distances and angles together know more than any one of them.
"""

from __future__ import annotations

from collections.abc import Generator

import moderngl

from ..core.job import Progress
from .context import Device
from .fill import fill
from .observe import ObservedCamera, Observations
from .surface import SurfaceMaps

ITERATIONS = 20  # more sharpens noise
PASSES_MAX = 120  # camera passes in all: with many cameras each iteration takes a share of them
STEP_SLACK = 0.1  # of 1, the weight of a good pixel seen head on: holds back texels seen at a grazing angle
ROBUST_PASSES = 4
OUTLIER = 0.05  # relative error at which a view loses half its weight in a pixel's albedo


class AlbedoSolver:
    """Base colour on the texel grid."""

    def __init__(self, device: Device, grid: SurfaceMaps, observations: Observations) -> None:
        self.device, self.grid, self.observations = device, grid, observations
        self.size = grid.position.width

    def solve(
        self, roughness: moderngl.Texture, lambert_slots: int, iterations: int = ITERATIONS
    ) -> Generator[Progress, None, moderngl.Texture]:
        """Roughness (R, holes filled) -> RGBA32F: linear base colour, 1 where a pixel showed the texel.

        ``lambert_slots``: bit s is set where material slot s has no specular lobe.
        """
        device = self.device
        roughness.filter = (moderngl.LINEAR, moderngl.LINEAR)
        cameras = self.observations.cameras
        shown = []
        for i, camera in enumerate(cameras):
            shown.append(self._pixel_albedo(camera, roughness, lambert_slots))
            yield Progress(0.3 * (i + 1) / len(cameras), "maps", "albedo per pixel")
        roughness.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture = device.texture(self.size, self.size)
        target = device.framebuffer([texture])
        target.clear()
        target.release()
        subsets = max(1, -(-iterations * len(cameras) // PASSES_MAX))
        for i in range(iterations + 1):
            # The first step starts from black: it is the weighted mean of what the cameras show.
            chosen = [c for c in range(len(cameras)) if i == 0 or c % subsets == i % subsets]
            texture = self._step(texture, [(cameras[c], shown[c]) for c in chosen], first=i == 0)
            device.ctx.finish()
            yield Progress(0.3 + 0.7 * (i + 1) / (iterations + 1), "maps", "base colour")
        for albedo in shown:
            albedo.release()
        return texture

    def _pixel_albedo(
        self, camera: ObservedCamera, roughness: moderngl.Texture, lambert_slots: int
    ) -> moderngl.Texture:
        device, ctx = self.device, self.device.ctx
        size = camera.maps.position.size
        specular = device.texture(*size, 1)
        specular_target = device.framebuffer([specular])
        grid = {"u_position": camera.maps.position, "u_normal": camera.maps.normal, "u_uv": camera.maps.uv,
                "u_roughness": roughness, "u_principled_table": self.observations.principled_table}
        before: moderngl.Texture | None = None
        for i in range(ROBUST_PASSES):
            albedo = device.texture(*size)
            target = device.framebuffer([albedo])
            target.clear()
            ctx.enable(moderngl.BLEND)
            ctx.blend_func, ctx.blend_equation = (moderngl.ONE, moderngl.ONE), moderngl.FUNC_ADD
            for view in camera.views:
                specular_target.clear()
                for lobe in view.lobes:
                    device.draw("albedo/specular.frag", specular_target, textures={**grid, "u_lobe": lobe},
                                uniforms=camera.viewpoint)
                device.draw("albedo/pixel.frag", target, textures={
                    **grid, "u_colour": view.colour, "u_specular": specular, "u_before": before,
                }, uniforms={**camera.viewpoint, "u_first_pass": before is None, "u_outlier": OUTLIER,
                             "u_lambert_slots": lambert_slots})
            ctx.disable(moderngl.BLEND)
            target.release()
            if before is not None:
                before.release()
            before = albedo
        specular_target.release()
        specular.release()
        return albedo

    def _step(
        self, texture: moderngl.Texture, cameras: list[tuple[ObservedCamera, moderngl.Texture]], *, first: bool
    ) -> moderngl.Texture:
        """One back-projection from some cameras; returns a new texture and frees the old one."""
        device, ctx = self.device, self.device.ctx
        filled = texture if first else fill(device, texture)
        filled.filter = (moderngl.LINEAR, moderngl.LINEAR)
        update = device.texture(self.size, self.size)
        update_target = device.framebuffer([update])
        update_target.clear()
        for camera, albedo in cameras:
            residual = device.texture(*albedo.size)
            target = device.framebuffer([residual])
            device.draw("albedo/residual.frag", target, textures={
                "u_albedo": albedo, "u_uv": camera.maps.uv, "u_uv_slope": camera.maps.uv_slope, "u_texture": filled,
            }, uniforms={"u_footprint": camera.uniforms["u_footprint"]})
            target.release()
            ctx.enable(moderngl.BLEND)
            ctx.blend_func, ctx.blend_equation = (moderngl.ONE, moderngl.ONE), moderngl.FUNC_ADD
            device.draw("albedo/backproject.frag", update_target, textures={
                "u_texel_position": self.grid.position, "u_texel_normal": self.grid.normal,
                "u_position": camera.maps.position, "u_residual": residual,
            }, uniforms={**camera.uniforms, "u_clip": camera.clip})
            ctx.disable(moderngl.BLEND)
            residual.release()
        update_target.release()
        result = device.texture(self.size, self.size)
        target = device.framebuffer([result])
        device.draw("albedo/update.frag", target, textures={"u_texture": texture, "u_update": update},
                    uniforms={"u_slack": 0.0 if first else STEP_SLACK})
        target.release()
        if filled is not texture:
            filled.release()
        update.release()
        texture.release()
        return result
