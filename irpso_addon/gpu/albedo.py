"""Roughness and observations -> base colour: the texture whose footprint averages are what pixels show.

Iterative back-projection (Irani and Peleg 1991): a pixel sees the mean of the texture over its
footprint, so cameras at different distances and angles together know more than any one of them.
"""

from __future__ import annotations

from collections.abc import Generator

import moderngl

from ..core.errors import Cancelled
from ..core.job import Progress
from .context import Device
from .fill import fill
from .observe import Observations, ObservedCamera, channel_masks
from .surface import SurfaceMaps

ITERATIONS = 20  # more sharpens noise
PASSES_MAX = 120  # camera passes in all: with many cameras each iteration takes a share of them
STEP_SLACK = 0.1  # of 1, the weight of a good pixel seen head on: holds back texels seen at a grazing angle
ROBUST_PASSES = 4
OUTLIER = 0.05  # relative error at which a view loses half its weight in a pixel's albedo

Shown = tuple[moderngl.Texture, moderngl.Texture]  # weighted albedo sum and weight per pixel, RGB each


class AlbedoSolver:
    """Base colour on the texel grid."""

    def __init__(
        self, device: Device, grid: SurfaceMaps, observations: Observations, lobes: moderngl.Texture,
        level: moderngl.Texture | None = None, beckmann: bool = False,
    ) -> None:
        """On the texel grid, holes filled: ``lobes`` roughness1, roughness2, weight; ``level`` Specular IOR Level.

        Without a level it is 0.5.
        """
        self.device, self.grid, self.observations = device, grid, observations
        self.known = {"u_lobes": lobes, **({"u_level": level} if level else {})}
        self.defines = {**({"SPECULAR": "1"} if level else {}), **({"NDF_BECKMANN": "1"} if beckmann else {})}
        self.size = grid.position.width
        self.cancelled = False

    def solve(self, iterations: int = ITERATIONS) -> Generator[Progress, None, moderngl.Texture]:
        """Returns RGBA32F: linear base colour, and how far pixels showed the texel (1: wholly)."""
        device = self.device
        for texture in self.known.values():
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        cameras = self.observations.cameras
        shown = []
        for i, camera in enumerate(cameras):
            shown.append(self._pixel_albedo(camera))
            try:
                yield Progress(0.3 * (i + 1) / len(cameras), "maps", "albedo per pixel")
            except Cancelled:
                self.cancelled, iterations = True, 0
        for texture in self.known.values():
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
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
            try:
                yield Progress(0.3 + 0.7 * (i + 1) / (iterations + 1), "maps", "base colour")
            except Cancelled:  # a less sharp texture, but a whole one
                self.cancelled = True
                break
        for pair in shown:
            release(pair)
        return texture

    def _pixel_albedo(self, camera: ObservedCamera) -> Shown:
        """Weighted albedo sum and weight of each pixel over the camera's views."""
        device = self.device
        size = camera.maps.position.size
        grid = {"u_position": camera.maps.position, "u_normal": camera.maps.normal, "u_uv": camera.maps.uv,
                **self.known, "u_principled_table": self.observations.principled_table}
        masks = channel_masks(self.observations.channels)
        specular = device.texture(*size)
        specular_target = device.framebuffer([specular])
        before: Shown | None = None
        for _ in range(ROBUST_PASSES):
            shown = (device.texture(*size), device.texture(*size))
            target = device.framebuffer(shown)
            target.clear()
            with device.adding():
                for view in camera.views:
                    specular_target.clear()
                    for n, lobe in enumerate(view.lobes):
                        device.draw("albedo/specular.frag", specular_target, textures={**grid, "u_lobe": lobe},
                                    uniforms={**camera.viewpoint, "u_channel": masks[n % len(masks)]},
                                    defines=self.defines)
                    device.draw("albedo/pixel.frag", target, textures={
                        **grid, "u_colour": view.colour, "u_specular": specular,
                        "u_before": before[0] if before else None, "u_before_weight": before[1] if before else None,
                    }, uniforms={**camera.viewpoint, "u_first_pass": before is None, "u_outlier": OUTLIER,
                                 "u_tint": view.tint}, defines=self.defines)
            target.release()
            release(before)
            before = shown
        specular_target.release()
        specular.release()
        return shown

    def _step(
        self, texture: moderngl.Texture, cameras: list[tuple[ObservedCamera, Shown]], *, first: bool
    ) -> moderngl.Texture:
        """One back-projection from some cameras; returns a new texture and frees the old one."""
        device = self.device
        filled = texture if first else fill(device, texture)
        filled.filter = (moderngl.LINEAR, moderngl.LINEAR)
        update = device.texture(self.size, self.size)
        update_target = device.framebuffer([update])
        update_target.clear()
        for camera, (albedo, weight) in cameras:
            residual = device.texture(*albedo.size)
            target = device.framebuffer([residual])
            device.draw("albedo/residual.frag", target, textures={
                "u_albedo": albedo, "u_weight": weight, "u_uv": camera.maps.uv, "u_uv_slope": camera.maps.uv_slope,
                "u_texture": filled,
            }, uniforms={"u_footprint": camera.uniforms["u_footprint"]})
            target.release()
            with device.adding():
                device.draw("albedo/backproject.frag", update_target, textures={
                    "u_texel_position": self.grid.position, "u_texel_normal": self.grid.normal,
                    "u_position": camera.maps.position, "u_normal": camera.maps.normal, "u_residual": residual,
                }, uniforms={**camera.uniforms, "u_clip": camera.clip})
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


def release(pair: Shown | None) -> None:
    """Free both textures."""
    for texture in pair or ():
        texture.release()
