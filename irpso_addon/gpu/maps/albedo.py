"""Roughness and observations -> base colour: the texture whose footprint averages are what pixels show.

Iterative back-projection (Irani and Peleg 1991): a pixel sees the mean of the texture over its
footprint, so cameras at different distances and angles together know more than any one of them.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import moderngl
import numpy as np

from ...core.data import F32
from ...core.errors import Cancelled
from ...core.job import Progress
from ...core.shading.lights import light_uniforms
from ..device.context import Device, Inputs
from ..device.occupied_cells import OccupiedCells
from ..gbuffer.gbuffer import GBufferMaps
from ..observe.observations import Observations, ObservedCamera, ObservedView
from ..observe.view_drawing import channel_masks
from ..solve.live_readback import base_color
from .fill import Filler

ITERATIONS = 6  # more sharpens noise: without any, ten are no better
COARSE_ITERATIONS, COARSE = 5, 1.15  # where so many pixels and more show a texel, there is little to sharpen
PASSES_MAX = 120  # camera passes in all: with many cameras each iteration takes a share of them
SHARP = 5  # steps after which the texture is worth a look: at first it is blurred
STARTS = 2  # steps from black: the first finds which texels pixels show, the second what these are
BEYOND = 0.01  # what a pixel that does not see a texel's UV island alone counts beside one that does
STEP_SLACK = 0.1  # of 1, the weight of a good pixel seen head on: holds back texels seen at a grazing angle
ROBUST_PASSES = 4
VIEWS_AT_ONCE = 4  # in one draw: their two textures each and eight more are what every GL 3.3 driver offers
METALS_AT_ONCE = 2  # of metals three each, and nine more
COATED_AT_ONCE = 3  # a coat is one more texture
ROUGH_AT_ONCE = 2  # of a rough diffuse three each, and nine more; of one beside a metal four each
WEIGHTED_AT_ONCE = 2  # where views count by their light, that is one more texture of each, and another one
TYPICAL = 10.0  # irradiance over the typical radiance: of a surface of base colour 0.3
OUTLIER = 0.05  # relative error at which a view loses half its weight in a pixel's albedo

Textures = Mapping[str, moderngl.Texture | None]
Shown = tuple[moderngl.Texture, moderngl.Texture]  # weighted albedo sum and weight per pixel, RGB each
Source = tuple[ObservedCamera, moderngl.Texture, moderngl.Texture]  # a camera with these


@dataclass(frozen=True)
class Gloss:
    """The specular part of the reflectance on the texel grid, holes filled."""

    lobes: moderngl.Texture  # roughness1, roughness2, weight of lobe 1
    level: moderngl.Texture | None = None  # Specular IOR Level; None: 0.5
    metallic: moderngl.Texture | None = None  # None: 0
    coat: moderngl.Texture | None = None  # weight, roughness, and as ``by_light``; None: no coat
    rough: moderngl.Texture | None = None  # Diffuse Roughness; None: 0
    # Power of the irradiance by which views count, in the third channel; None: 0
    by_light: moderngl.Texture | None = None
    beckmann: bool = False


class AlbedoSolver:
    """Base colour on the texel grid."""

    def __init__(
        self, device: Device, grid: GBufferMaps, observations: Observations, gloss: Gloss, around: F32 | None = None,
    ) -> None:
        """``around``: base colour of coarse cells, see `Filler`."""
        self.device, self.grid, self.observations = device, grid, observations
        self.known = {"u_lobes": gloss.lobes, **({"u_level": gloss.level} if gloss.level else {}),
                      **({"u_metallic": gloss.metallic} if gloss.metallic else {}),
                      **({"u_coat": gloss.coat} if gloss.coat else {}),
                      **({"u_rough": gloss.rough} if gloss.rough else {})}
        self.metal, self.rough = gloss.metallic is not None, gloss.rough is not None
        # With a texture of its own beside a metal, a rough diffuse, and a coat, a draw would have seventeen.  OpenGL
        # promises sixteen, so that the coat's has it, too.
        self.by_light = gloss.by_light
        self.by_light_inputs = {} if gloss.coat or not gloss.by_light else {"u_by_light": gloss.by_light}
        self.at_once = 1 if self.metal and self.rough else min(
            METALS_AT_ONCE if self.metal else VIEWS_AT_ONCE, COATED_AT_ONCE if gloss.coat else VIEWS_AT_ONCE,
            ROUGH_AT_ONCE if self.rough else VIEWS_AT_ONCE)
        if self.by_light:
            self.at_once = 1 if self.by_base else WEIGHTED_AT_ONCE
        pairs = device.read(gloss.lobes)
        one = bool((pairs[..., 0] == pairs[..., 1]).all())
        self.defines = {name: "1" for name, true in (
            ("SPECULAR", gloss.level is not None), ("METALLIC", self.metal), ("COAT", gloss.coat is not None),
            ("ROUGH_DIFFUSE", self.rough), ("BY_LIGHT", self.by_light is not None),
            ("NDF_BECKMANN", gloss.beckmann), ("ONE_LOBE", one)) if true}
        self.around = around
        self.cancelled = False
        self.pixels_per_texel = 1.0  # area; known after a solve

    def take(
        self, lobes: moderngl.Texture, level: moderngl.Texture | None, metallic: moderngl.Texture | None,
    ) -> None:
        """From here on views are predicted from these, instead of what the solver was made with, which it frees."""
        for name, texture in (("u_lobes", lobes), ("u_level", level), ("u_metallic", metallic)):
            if texture is not None:
                self.known[name].release()
                self.known[name] = texture

    def solve(self, iterations: int = ITERATIONS) -> Generator[Progress, None, moderngl.Texture]:
        """Returns RGBA32F: linear base colour, and how far pixels showed the texel (1: wholly)."""
        with self.device.scope() as owned:
            sources = yield from self._pixel_albedos()
            canvas = _Canvas(self.device, self.grid, sources, self.around)
            yield from self._back_project(canvas, 0 if self.cancelled else iterations)
            self.pixels_per_texel = canvas.pixels_per_texel()
            owned.hand_over(canvas.texture)
            return canvas.texture

    def _pixel_albedos(self) -> Generator[Progress, None, list[Source]]:
        """Of every camera; when stopped too, because there is no base colour without."""
        for texture in self.known.values():
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        cameras = self.observations.cameras
        sources: list[Source] = []
        for i, camera in enumerate(cameras):
            sources.append((camera, *self._pixel_albedo(camera)))
            try:
                yield Progress(0.3 * (i + 1) / len(cameras), "maps", "albedo per pixel")
            except Cancelled:
                self.cancelled = True
        for texture in self.known.values():
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return sources

    def _back_project(self, canvas: _Canvas, iterations: int) -> Generator[Progress, None, None]:
        """From all cameras, then from a share of them at a time; canvas.texture is the result."""
        device, cameras = self.device, self.observations.cameras
        subsets = max(1, -(-iterations * len(cameras) // PASSES_MAX))
        i, steps = 0, iterations + STARTS if iterations else 1
        while i < steps:
            # A step from black is the weighted mean of what the cameras show.
            chosen = [c for c in range(len(cameras)) if i < STARTS or c % subsets == i % subsets]
            for share in canvas.step(chosen, i):
                whole = share == 1
                if whole:
                    device.budget.finish()
                    if i == 0 and canvas.pixels_per_texel() > COARSE:
                        steps = min(steps, COARSE_ITERATIONS + STARTS)
                try:
                    yield Progress(0.3 + 0.7 * (i + share) / steps, "maps", "base colour",
                                   partial(base_color, device, canvas.texture) if whole and i + 1 >= SHARP else None)
                except Cancelled:  # a less sharp texture, but a whole one
                    self.cancelled = True
                if self.cancelled and i > 0:  # without the first step there is none
                    break
            i += 1
            if self.cancelled:
                break
        canvas.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)

    def _pixel_albedo(self, camera: ObservedCamera) -> Shown:
        """Weighted albedo sum and weight of each pixel over the camera's views."""
        device = self.device
        with device.scope() as owned:
            specular = [self.specular(camera, view) for view in camera.views]
            light = [self._light(camera, view) for view in camera.views] if self.by_light else []
            shown, spare = self._pair(camera), self._pair(camera)
            before: Shown | None = None
            for _ in range(ROBUST_PASSES):
                with device.target(shown, clear=True) as target, device.adding():
                    for n in range(0, len(specular), self.at_once):
                        group = slice(n, n + self.at_once)
                        device.draw("maps/albedo_pixel.frag", target,
                                    self._inputs(camera, camera.views[group], specular[group], light[group], before),
                                    cells=camera.maps.cells)
                before, shown, spare = shown, spare, shown
            assert before is not None
            owned.hand_over(*before)
            return before

    def _inputs(
        self, camera: ObservedCamera, views: list[ObservedView], specular: list[list[moderngl.Texture]],
        light: list[moderngl.Texture], before: Shown | None,
    ) -> Inputs:
        """Of a draw that adds some views to a camera's albedo; ``before``: what the last pass found."""
        tints = [view.tint for view in views]
        return Inputs({
            **self.looked_up(camera), "u_before": before[0] if before else None,
            "u_before_weight": before[1] if before else None,
            "u_colour": tuple(view.colour for view in views), "u_specular": tuple(parts[0] for parts in specular),
            **({"u_metal": tuple(parts[1] for parts in specular)} if self.metal else {}),
            **({"u_more": tuple(parts[-1] for parts in specular)} if self.rough else {}),
            **({"u_light": tuple(light), **self.by_light_inputs} if self.by_light else {}),
        }, {**camera.viewpoint, "u_first_pass": before is None, "u_outlier": OUTLIER,
            "u_tint": tints if len(tints) > 1 else tints[0]}, {**self.defines, "VIEWS": str(len(views))})

    def _light(self, camera: ObservedCamera, view: ObservedView) -> moderngl.Texture:
        """Irradiance of the view's lamps at each pixel, without shadows, over a typical one."""
        width, height = camera.maps.position.size
        result = self.device.texture(width, height, 1)
        typical = TYPICAL * (self.observations.level or 1.0)  # 0 where more than half of the pixels are dark
        maps = {"u_position": camera.maps.position, "u_normal": camera.maps.normal}
        with self.device.target([result], clear=True) as target, self.device.adding():
            for lamp in view.view.lights:
                power = float(np.mean(lamp.power)) / typical
                self.device.draw("maps/albedo_light.frag", target, Inputs(
                    maps, {**light_uniforms(lamp), "u_power": power}), cells=camera.maps.cells)
        return result

    def looked_up(self, camera: ObservedCamera) -> Textures:
        """What every draw over the camera's pixels looks up."""
        return {"u_position": camera.maps.position, "u_normal": camera.maps.normal, "u_uv": camera.maps.uv,
                **self.known, "u_principled_table": self.observations.principled_table}

    @property
    def by_base(self) -> bool:
        """Whether more than the diffuse of all views alike depends on base colour."""
        return self.metal or self.rough

    def _pair(self, camera: ObservedCamera) -> Shown:
        """Two textures of the camera's size."""
        return self.device.texture(*camera.maps.position.size), self.device.texture(*camera.maps.position.size)

    def specular(
        self, camera: ObservedCamera, view: ObservedView, base: moderngl.Texture | None = None,
    ) -> list[moderngl.Texture]:
        """Specular radiance per irradiance of the view's lights at each pixel, 1/sr.

        Of metals in two textures, which the base colour is to go into, or in one, where ``base`` gives that at pixels.
        One more, the last, is what a rough diffuse adds to a smooth one: see maps/albedo_specular.frag.
        """
        device, grid = self.device, self.looked_up(camera)
        masks = channel_masks(self.observations.channels)
        shown = {"u_shown": base} if self.by_base and base is not None else {}
        defines = {**self.defines, **({"SHOWN": "1"} if shown else {})}
        count = 1 + (self.metal and not shown) + self.rough
        parts = [device.texture(*camera.maps.position.size) for _ in range(count)]
        with device.target(parts, clear=True) as target, device.adding():
            for n, lobe in enumerate(view.lobes):
                device.draw("maps/albedo_specular.frag", target, Inputs(
                    {**grid, **shown, "u_lobe": lobe}, {**camera.viewpoint, "u_channel": masks[n % len(masks)]},
                    defines), cells=camera.maps.cells)
            if view.nodes is not None:
                device.draw("maps/albedo_environment.frag", target, Inputs(
                    {**grid, **shown, "u_nodes": view.nodes}, camera.viewpoint, defines), cells=camera.maps.cells)
        return parts


class _Canvas:
    """The texture while back-projections change it, and what they need besides; all belongs to the scope."""

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
        # By camera: the texels that it shows, and which pixels show them.
        self._seen: dict[int, tuple[OccupiedCells, moderngl.Texture]] = {}

    def step(self, chosen: list[int], number: int) -> Iterator[float]:
        """One back-projection from some cameras; the share that is done, after each, and 1.

        Left before its end it changes nothing.
        """
        beyond, start = {"u_beyond": BEYOND if number else 1.0}, {"u_from_black": number < STARTS}
        filled = self._filler.fill(self.texture) if number >= STARTS else self.texture
        filled.filter = (moderngl.LINEAR, moderngl.LINEAR)
        sum_target = self._target[self.update.glo]
        sum_target.clear()
        for done, n in enumerate(chosen):
            residual = self._difference(n, filled, {**beyond, **start})
            if n not in self._seen:
                self._seen[n] = self._found(n, residual, beyond)
            cells, shown = self._seen[n]
            with self.device.adding():
                self._carry_back(n, residual, sum_target, cells, beyond, shown)
            yield (done + 0.5) / len(chosen)
        self.device.draw("maps/albedo_update.frag", self._target[self.next.glo], Inputs({
            "u_texture": self.texture, "u_update": self.update},
            {**start, "u_slack": 0.0 if number < STARTS else STEP_SLACK}))
        self.texture, self.next = self.next, self.texture
        yield 1.0

    def pixels_per_texel(self) -> float:
        """How many pixels show a texel, by the squares that hold them; after the first step."""
        pixels = sum(camera.maps.cells.count for camera, _, _ in self.cameras if camera.maps.cells)
        return pixels / max(sum(cells.count for cells, _ in self._seen.values()), 1)

    def _difference(self, n: int, filled: moderngl.Texture, uniforms: Mapping[str, object]) -> moderngl.Texture:
        """How far the texture is from what each pixel of a camera shows."""
        camera, albedo, weight = self.cameras[n]
        residual = self._residual[albedo.size]
        target = self._target[residual.glo]
        target.clear()
        self.device.draw("maps/albedo_residual.frag", target, Inputs({
            "u_albedo": albedo, "u_weight": weight, "u_uv": camera.maps.uv, "u_uv_slope": camera.maps.uv_slope,
            "u_texture": filled, "u_position": camera.maps.position, "u_normal": camera.maps.normal,
        }, {**camera.uniforms, **camera.projection.uniforms, **uniforms}, camera.defines),
            cells=camera.maps.cells)
        return residual

    def _found(
        self, n: int, residual: moderngl.Texture, uniforms: Mapping[str, object],
    ) -> tuple[OccupiedCells, moderngl.Texture]:
        """The texels that a camera shows, and which of its pixels show each."""
        shown = self.device.texture(self.next.width, self.next.height, 1, dtype="f1")
        with self.device.target([self.next, shown], clear=True) as target:
            self._carry_back(n, residual, target, self.grid.cells, uniforms)
        return OccupiedCells(self.device, self.next), shown

    def _carry_back(
        self, n: int, residual: moderngl.Texture, target: moderngl.Framebuffer, cells: OccupiedCells | None,
        uniforms: Mapping[str, object], shown: moderngl.Texture | None = None,
    ) -> None:
        """A camera's residuals to the texels that it shows.  ``shown``: by which pixels; None: that is to be found."""
        camera = self.cameras[n][0]
        maps = {"u_position": camera.maps.position, "u_normal": camera.maps.normal, "u_uv": camera.maps.uv,
                "u_uv_slope": camera.maps.uv_slope}
        self.device.draw("maps/albedo_backproject.frag", target, Inputs({
            "u_texel_position": self.grid.position, "u_texel_normal": self.grid.normal, "u_residual": residual,
            **(maps if shown is None else {"u_shown": shown}),
        }, {**camera.uniforms, **camera.projection.uniforms, **uniforms},
            {**camera.defines, **({"FINDING": "1"} if shown is None else {})}), cells=cells)
