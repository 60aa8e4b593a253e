"""Roughness and observations -> base colour: the texture whose footprint averages are what pixels show.

Iterative back-projection (Irani and Peleg 1991): a pixel sees the mean of the texture over its
footprint, so cameras at different distances and angles together know more than any one of them.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from functools import partial

import moderngl

from ...core.data import F32
from ...core.errors import Cancelled
from ...core.job import Progress
from ..device.context import Device
from ..device.occupied_cells import OccupiedCells
from ..gbuffer.gbuffer import GBufferMaps
from ..observe.observations import Observations, ObservedCamera, ObservedView
from ..observe.view_drawing import channel_masks
from ..solve.live_readback import base_color
from .fill import Filler

ITERATIONS = 20  # more sharpens noise
COARSE_ITERATIONS, COARSE = 5, 1.15  # where so many pixels and more show a texel, there is little to sharpen
PASSES_MAX = 120  # camera passes in all: with many cameras each iteration takes a share of them
SHARP = 4  # iterations after which the texture is worth a look: at first it is blurred
STEP_SLACK = 0.1  # of 1, the weight of a good pixel seen head on: holds back texels seen at a grazing angle
ROBUST_PASSES = 4
VIEWS_AT_ONCE = 4  # in one draw: their two textures each and eight more are what every GL 3.3 driver offers
OUTLIER = 0.05  # relative error at which a view loses half its weight in a pixel's albedo

Textures = Mapping[str, moderngl.Texture | None]
Shown = tuple[moderngl.Texture, moderngl.Texture]  # weighted albedo sum and weight per pixel, RGB each
Source = tuple[ObservedCamera, moderngl.Texture, moderngl.Texture]  # a camera with these


class AlbedoSolver:
    """Base colour on the texel grid."""

    def __init__(
        self, device: Device, grid: GBufferMaps, observations: Observations, lobes: moderngl.Texture,
        level: moderngl.Texture | None = None, beckmann: bool = False, around: F32 | None = None,
    ) -> None:
        """On the texel grid, holes filled: ``lobes`` roughness1, roughness2, weight; ``level`` Specular IOR Level.

        Without a level it is 0.5.  ``around``: base colour of coarse cells, see `Filler`.
        """
        self.device, self.grid, self.observations = device, grid, observations
        self.known = {"u_lobes": lobes, **({"u_level": level} if level else {})}
        pairs = device.read(lobes)
        one = bool((pairs[..., 0] == pairs[..., 1]).all())
        self.defines = {name: "1" for name, true in (
            ("SPECULAR", level is not None), ("NDF_BECKMANN", beckmann), ("ONE_LOBE", one)) if true}
        self.around = around
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
        canvas = _Canvas(device, self.grid, [(c, *s) for c, s in zip(cameras, shown, strict=True)],
                         self.around)
        subsets = max(1, -(-iterations * len(cameras) // PASSES_MAX))
        i = 0
        while i <= iterations:
            # The first step starts from black: it is the weighted mean of what the cameras show.
            canvas.step([c for c in range(len(cameras)) if i == 0 or c % subsets == i % subsets], first=i == 0)
            device.budget.finish()
            if i == 0 and canvas.pixels_per_texel() > COARSE:
                iterations = min(iterations, COARSE_ITERATIONS)
            i += 1
            try:
                yield Progress(0.3 + 0.7 * i / (iterations + 1), "maps", "base colour",
                               partial(base_color, device, canvas.texture) if i >= SHARP else None)
            except Cancelled:  # a less sharp texture, but a whole one
                self.cancelled = True
                break
        for pair in shown:
            release(pair)
        return canvas.release()

    def _pixel_albedo(self, camera: ObservedCamera) -> Shown:
        """Weighted albedo sum and weight of each pixel over the camera's views."""
        device = self.device
        grid = self.looked_up(camera)
        specular = [self.specular(camera, view) for view in camera.views]
        groups = [slice(n, n + VIEWS_AT_ONCE) for n in range(0, len(specular), VIEWS_AT_ONCE)]
        before: Shown | None = None
        for _ in range(ROBUST_PASSES):
            shown = self._shown(camera)
            target = device.framebuffer(shown)
            with device.adding():
                for group in groups:
                    views = camera.views[group]
                    tints = [view.tint for view in views]
                    device.draw("maps/albedo_pixel.frag", target, textures={
                        **grid, "u_before": before[0] if before else None,
                        "u_before_weight": before[1] if before else None,
                        "u_colour": tuple(view.colour for view in views), "u_specular": tuple(specular[group]),
                    }, uniforms={**camera.viewpoint, "u_first_pass": before is None, "u_outlier": OUTLIER,
                                 "u_tint": tints if len(tints) > 1 else tints[0]},
                        defines={**self.defines, "VIEWS": str(len(views))}, cells=camera.maps.cells)
            target.release()
            release(before)
            before = shown
        for texture in specular:
            texture.release()
        return shown

    def looked_up(self, camera: ObservedCamera) -> Textures:
        """What every draw over the camera's pixels looks up."""
        return {"u_position": camera.maps.position, "u_normal": camera.maps.normal, "u_uv": camera.maps.uv,
                **self.known, "u_principled_table": self.observations.principled_table}

    def _shown(self, camera: ObservedCamera) -> Shown:
        """Two empty textures of the camera's size."""
        pair = self.device.texture(*camera.maps.position.size), self.device.texture(*camera.maps.position.size)
        target = self.device.framebuffer(pair)
        target.clear()
        target.release()
        return pair

    def specular(self, camera: ObservedCamera, view: ObservedView) -> moderngl.Texture:
        """Specular radiance per irradiance of the view's lights at each pixel, 1/sr."""
        device, grid = self.device, self.looked_up(camera)
        masks = channel_masks(self.observations.channels)
        specular = device.texture(*camera.maps.position.size)
        target = device.framebuffer([specular])
        target.clear()
        with device.adding():
            for n, lobe in enumerate(view.lobes):
                device.draw("maps/albedo_specular.frag", target, textures={**grid, "u_lobe": lobe},
                            uniforms={**camera.viewpoint, "u_channel": masks[n % len(masks)]},
                            defines=self.defines, cells=camera.maps.cells)
        target.release()
        return specular


class _Canvas:
    """The texture while back-projections change it, and what they need besides."""

    def __init__(
        self, device: Device, grid: GBufferMaps, cameras: list[Source], around: F32 | None = None,
    ) -> None:
        self.device, self.grid, self.cameras = device, grid, cameras
        size = grid.position.size
        self.texture, self.next, self.update = (device.texture(*size) for _ in range(3))
        self._target = {t.glo: device.framebuffer([t]) for t in (self.texture, self.next, self.update)}
        self._target[self.texture.glo].clear()
        self._filler = Filler(device, size, around)
        self._residual: dict[tuple[int, int], moderngl.Texture] = {}  # by size
        for camera, _, _ in cameras:
            pixels = camera.maps.position.size
            if pixels not in self._residual:
                self._residual[pixels] = device.texture(*pixels)
                self._target[self._residual[pixels].glo] = device.framebuffer([self._residual[pixels]])
        self._seen: dict[int, OccupiedCells] = {}  # by camera: the texels that it shows

    def step(self, chosen: list[int], *, first: bool) -> None:
        """One back-projection from some cameras."""
        filled = self.texture if first else self._filler.fill(self.texture)
        filled.filter = (moderngl.LINEAR, moderngl.LINEAR)
        sum_target = self._target[self.update.glo]
        sum_target.clear()
        for n in chosen:
            residual = self._difference(n, filled)
            if n not in self._seen:
                target = self._target[self.next.glo]
                target.clear()
                self._carry_back(n, residual, target, self.grid.cells)
                self._seen[n] = OccupiedCells(self.device, self.next)
            with self.device.adding():
                self._carry_back(n, residual, sum_target, self._seen[n])
        self.device.draw("maps/albedo_update.frag", self._target[self.next.glo], textures={
            "u_texture": self.texture, "u_update": self.update}, uniforms={"u_slack": 0.0 if first else STEP_SLACK})
        self.texture, self.next = self.next, self.texture

    def pixels_per_texel(self) -> float:
        """How many pixels show a texel, by the squares that hold them; after the first step."""
        pixels = sum(camera.maps.cells.count for camera, _, _ in self.cameras if camera.maps.cells)
        return pixels / max(sum(cells.count for cells in self._seen.values()), 1)

    def _difference(self, n: int, filled: moderngl.Texture) -> moderngl.Texture:
        """How far the texture is from what each pixel of a camera shows."""
        camera, albedo, weight = self.cameras[n]
        residual = self._residual[albedo.size]
        target = self._target[residual.glo]
        target.clear()
        self.device.draw("maps/albedo_residual.frag", target, textures={
            "u_albedo": albedo, "u_weight": weight, "u_uv": camera.maps.uv, "u_uv_slope": camera.maps.uv_slope,
            "u_texture": filled,
        }, uniforms={"u_footprint": camera.uniforms["u_footprint"]}, cells=camera.maps.cells)
        return residual

    def _carry_back(
        self, n: int, residual: moderngl.Texture, target: moderngl.Framebuffer, cells: OccupiedCells | None,
    ) -> None:
        """A camera's residuals to the texels that it shows."""
        camera = self.cameras[n][0]
        self.device.draw("maps/albedo_backproject.frag", target, textures={
            "u_texel_position": self.grid.position, "u_texel_normal": self.grid.normal,
            "u_position": camera.maps.position, "u_normal": camera.maps.normal, "u_residual": residual,
        }, uniforms={**camera.uniforms, "u_clip": camera.clip}, cells=cells)

    def release(self) -> moderngl.Texture:
        """Free all but the texture, which is returned."""
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._filler.release()
        for target in self._target.values():
            target.release()
        for texture in (*self._residual.values(), self.next, self.update):
            texture.release()
        for cells in self._seen.values():
            cells.release()
        return self.texture


def release(pair: Shown | None) -> None:
    """Free both textures."""
    for texture in pair or ():
        texture.release()
