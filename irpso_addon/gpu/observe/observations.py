"""Views -> observations: at every pixel of a camera, reflected radiance per irradiance and how far to trust it.

The pixel is the unit of observation, with its own geometry: a texel is later matched to the pixel
that shows it.  Interpolating colours at the texel's own geometry instead doubles the roughness error.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial

import moderngl
import numpy as np
from numpy.typing import NDArray

from ...core.data import F32, Bool, Bounced, Camera, Light, RadianceImage, SceneData, View
from ...core.job import Progress
from ...core.reporting import estimates
from ...core.shading import lights as light_model
from ...core.shading.tables import principled_table
from ..device.context import Device
from ..gbuffer.gbuffer import MeshBuffer, Occluders, SurfaceMaps, clip_matrix, column_major, draw_pixel_grid
from ..gbuffer.solve_mask import SolveMask
from .indirect_light import Smoother
from .visibility import SHADOW_SIZE, SOFT_ANGLE, LightVisibility

EDGE_WEIGHT = 0.03  # of an observation at an edge of shadow or silhouette, beside 1 for a good one
EDGE_QUALITY = 0.25  # of a good pixel's: below it lies an edge of shadow or silhouette
DARK_SHARE = 0.02  # radiance below this share of the typical one is as good as noise
LIGHT_POINTS = 16  # sample points on an emitter that is not a point, for the spread of half vectors
MARGIN = 6  # pixels around the object in which its outline may be looked for
BLACK = np.float32(1e-6)  # of the brightest: no lit pixel is darker, so that its irradiance is radiance / f
HALF_MOST = 60_000.0  # half floats end at 65504
READERS = 2  # images read ahead of the one that is looked at
ReadImage = Callable[[View], RadianceImage]
F16 = NDArray[np.float16]
Reference = tuple[F16, float, float]  # as ObservedView.reference, .scale and .clipped


@dataclass
class ObservedView:
    """One view at its camera's pixels."""

    view: View
    colour: moderngl.Texture  # RGBA32F: radiance / irradiance (1/sr), quality
    lobes: list[moderngl.Texture]  # per light, per channel: sin2h, spread, cos_l, factor
    tint: tuple[float, float, float]  # power of the view's lights per channel, mean 1
    reference: F16  # (h, w, 4) the picture in the camera's window: radiance / scale (NaN: not usable), coverage
    scale: float
    clipped: float  # share of the object's pixels that the picture has clipped


@dataclass
class ObservedCamera:
    """A camera's pixel grid with the views taken through it."""

    camera: Camera
    maps: SurfaceMaps
    clip: bytes  # world to clip space
    uniforms: dict[str, object]
    window: tuple[int, int, int, int]  # x, y, width, height of the pixels that show the object, and MARGIN
    views: list[ObservedView] = field(default_factory=list)

    @property
    def viewpoint(self) -> dict[str, object]:
        """The uniforms that give the direction to the camera."""
        return {k: self.uniforms[k] for k in ("u_camera_position", "u_camera_forward", "u_orthographic")}

    def release(self) -> None:
        """Free the textures."""
        self.maps.release()
        for view in self.views:
            for texture in (view.colour, *view.lobes):
                texture.release()


@dataclass(frozen=True)
class Observations:
    """All cameras, and what was noticed on the way."""

    cameras: list[ObservedCamera]
    channels: int  # 1: lights are white enough that the mean of RGB tells all; 3: each channel by itself
    level: float  # typical radiance of the views (median over pixels that show the surface)
    skipped: tuple[tuple[str, str], ...]  # (view, why)
    warnings: tuple[str, ...]
    principled_table: moderngl.Texture

    def release(self) -> None:
        """Free the textures."""
        for camera in self.cameras:
            camera.release()
        self.principled_table.release()


def camera_uniforms(camera: Camera, height: int, footprint: float) -> dict[str, object]:
    """What include/pixel.glsl needs to know of a camera."""
    return {
        "u_camera_position": tuple(camera.position), "u_camera_forward": tuple(camera.forward),
        "u_orthographic": camera.orthographic,
        "u_pixel_width": 2.0 / (abs(float(camera.projection[1, 1])) * height), "u_footprint": footprint,
    }


def observe(
    device: Device, scene: SceneData, mesh: MeshBuffer, read_image: ReadImage,
    bounced: Mapping[int, Bounced] | None = None, part: SolveMask | None = None, shadow_size: int = SHADOW_SIZE,
    level: float | None = None,
) -> Generator[Progress, None, Observations]:
    """Draw every camera's maps, every light's shadow, and turn each reference into observations.

    ``bounced``: indirect light, by the view's place in the scene.  ``part``: what alone is looked at.
    ``shadow_size``: texels of a shadow map on a side.  ``level``: typical radiance of the views, where that is known
    from before; then no view is skipped, so that observations are laid out alike wherever one looks.
    """
    occluders = Occluders(device, scene.occluders)
    table = principled_table()
    table_texture = device.texture(table.shape[1], table.shape[0], table.shape[2], table)
    images: dict[int, moderngl.Texture] = {}
    references: dict[int, Reference] = {}
    cameras: list[ObservedCamera] = []
    covered: list[Bool] = []
    members: list[list[int]] = []
    levels: list[F32] = []
    warnings: list[str] = []
    skipped: list[tuple[str, str]] = []
    keys: dict[tuple[str, int, int], int] = {}
    for n, (view, image) in enumerate(zip(scene.views, _read_ahead(read_image, scene.views), strict=True)):
        warnings += [w for w in image.warnings if w not in warnings]
        h, w = image.rgb.shape[:2]
        key = (view.camera.name, w, h)
        if key not in keys:
            keys[key] = len(cameras)
            maps = draw_pixel_grid(device, mesh, occluders, view.camera, w, h, scene.pixel_filter)
            maps = part.pixels(device, maps) if part else maps
            clip = clip_matrix(view.camera, [scene.mesh.positions, scene.occluders])
            covered.append(device.read(maps.position)[..., 3] > 0.5)
            cameras.append(ObservedCamera(view.camera, maps, column_major(clip),
                                          camera_uniforms(view.camera, h, scene.pixel_filter), _window(covered[-1])))
            members.append([])
        shown = covered[keys[key]]
        good = shown & image.valid & (image.coverage > 0.5)
        if not good.any() and level is None:
            what = "object" if part is None or part.whole else "part to solve"
            skipped.append((view.image.name, f"no usable pixel shows the {what}: check camera, mask and clipping"))
            continue
        if level is None:
            levels.append(np.median(image.rgb[good].mean(axis=1))[None])
        quality = np.where(image.valid, np.where(image.coverage > 0.5, image.coverage, 0.0), 0.0)
        rgb = np.maximum(image.rgb, BLACK * image.rgb.max())
        packed = np.concatenate([rgb, quality[..., None]], axis=2)
        images[n] = device.texture(w, h, 4, packed)
        looked = shown & (image.coverage > 0.5)
        clipped = float(np.mean(~image.valid[looked])) if looked.any() else 0.0
        references[n] = _reference(packed, image.coverage, cameras[keys[key]].window, clipped)
        members[keys[key]].append(n)
        yield Progress(0.5 * (n + 1) / len(scene.views), "observe", f"reading {view.image.name}")
    if level is None:
        level = float(np.median(np.concatenate(levels))) if levels else 1.0
    channels = channels_needed(scene.views)
    visibility = LightVisibility(device, mesh, occluders, shadow_size)
    lit: dict[tuple[str, int], moderngl.Texture] = {}
    by_name = {light.name: light for view in scene.views for light in view.lights}
    used = [[any(light.name == name for n in group for light in scene.views[n].lights) for group in members]
            for name in by_name]
    for i, (name, light) in enumerate(by_name.items()):
        chosen = [c for c, wanted in enumerate(used[i]) if wanted]
        found: list[moderngl.Texture] = []
        for found in visibility.lit_maps(light, [cameras[c].maps for c in chosen]):  # noqa: B007  # the last is whole
            yield Progress(0.5 + 0.3 * i / len(by_name), "observe", f"shadows of {name}")
        lit.update({(name, c): texture for c, texture in zip(chosen, found, strict=True)})
    visibility.release()
    for c, group in enumerate(members):
        rim = _rim(device, cameras[c])
        pixels = partial(camera_uniforms, footprint=0.0)
        with Smoother(device, mesh, occluders, cameras[c].camera, cameras[c].maps, pixels) as smoother:
            for n in group:
                view = scene.views[n]
                shadows = [lit[light.name, c] for light in view.lights]
                indirect = smoother.smooth(bounced[n]) if bounced else None
                observed = _observe_view(
                    device, cameras[c], rim, view, images[n], references[n], shadows, level, channels, indirect)
                cameras[c].views.append(observed)
                for texture in (images.pop(n), *(indirect or ())):
                    texture.release()
                yield Progress(0.8 + 0.2 * n / len(scene.views), "observe", view.image.name)
        rim.release()
    for texture in lit.values():
        texture.release()
    for camera in cameras:
        if not camera.views:
            camera.release()
    occluders.release()
    useful = [camera for camera in cameras if camera.views]
    return Observations(useful, channels, level, tuple(skipped), tuple(warnings), table_texture)


def _read_ahead(read_image: ReadImage, views: Sequence[View]) -> Iterator[RadianceImage]:
    """The views' images in order, READERS of them read by other threads while one is used."""
    with ThreadPoolExecutor(READERS) as readers:
        waiting: deque[Future[RadianceImage]] = deque()
        try:
            for view in views:
                waiting.append(readers.submit(read_image, view))
                if len(waiting) > READERS:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:  # a bad image, or a stop: nobody waits for the rest
            for future in waiting:
                future.cancel()


def _observe_view(
    device: Device, camera: ObservedCamera, rim: moderngl.Texture, view: View, image: moderngl.Texture,
    reference: Reference, lit: list[moderngl.Texture], level: float, channels: int,
    indirect: tuple[moderngl.Texture, moderngl.Texture] | None = None,
) -> ObservedView:
    """``indirect``: irradiance and what highlights of it add to the picture."""
    draw = partial(_draw, device, camera.maps)
    common = {**camera.uniforms, "u_level": level, "u_edge_weight": EDGE_WEIGHT, "u_dark": DARK_SHARE}
    colour = device.texture(*image.size)
    if len(lit) == 1 and channels == 1 and indirect is None:
        lobes = [device.texture(*image.size)]
        draw("observe/view.frag", [colour, lobes[0]], {"u_image": image, "u_lit": lit[0], "u_rim": rim},
             {**common, **_lamp(view.lights[0])}, _lamp_defines(view.lights[0]))
    else:
        irradiance = device.texture(*image.size)
        with device.adding():
            for n, (light, shadow) in enumerate(zip(view.lights, lit, strict=True)):
                draw("observe/irradiance.frag", [irradiance], {"u_lit": shadow, "u_rim": rim},
                     {**common, **_lamp(light)}, _lamp_defines(light), clear=n == 0)
        bounced = {"u_bounced": indirect[0]} if indirect else {}
        glossy = {"u_glossy": indirect[1]} if indirect else {}
        defines = {"BOUNCED": "1"} if indirect else {}
        lobes = []
        for light, shadow in zip(view.lights, lit, strict=True):
            for mask in channel_masks(channels):
                lobes.append(device.texture(*image.size))
                draw("observe/lobe.frag", [lobes[-1]], {"u_lit": shadow, "u_irradiance": irradiance, **bounced},
                     {**common, **_lamp(light), "u_channel": mask}, _lamp_defines(light) | defines)
        draw("observe/colour.frag", [colour],
             {"u_image": image, "u_irradiance": irradiance, "u_rim": rim, **bounced, **glossy}, common, defines)
        irradiance.release()
    power = np.sum([light.power for light in view.lights], axis=0)
    tint = power / max(float(power.mean()), 1e-20)
    return ObservedView(view, colour, lobes, (float(tint[0]), float(tint[1]), float(tint[2])), *reference)


def _window(covered: Bool) -> tuple[int, int, int, int]:
    """x, y, width and height of what is covered, with a margin; a pixel where nothing is."""
    y, x = np.nonzero(covered)
    if not len(x):
        return 0, 0, 1, 1
    low = np.maximum([x.min() - MARGIN, y.min() - MARGIN], 0)
    high = np.minimum([x.max() + 1 + MARGIN, y.max() + 1 + MARGIN], covered.shape[::-1])
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _reference(packed: F32, coverage: F32, window: tuple[int, int, int, int], clipped: float) -> Reference:
    """The picture's part in a window; packed: (H, W, 4) radiance, quality."""
    x, y, w, h = window
    part = packed[y:y + h, x:x + w]
    scale = max(float(part[..., :3].max()) / HALF_MOST, 1e-20)
    rgb = np.where(part[..., 3:] > 0, part[..., :3] / np.float32(scale), np.nan)
    return np.concatenate([rgb, coverage[y:y + h, x:x + w, None]], axis=2).astype(np.float16), scale, clipped


def _rim(device: Device, camera: ObservedCamera) -> moderngl.Texture:
    """What surrounds each of a camera's pixels; half floats hold its whole numbers exactly."""
    rim = device.texture(camera.maps.position.width, camera.maps.position.height, 1, dtype="f2")
    _draw(device, camera.maps, "observe/rim.frag", [rim], {}, camera.uniforms)
    return rim


def _draw(
    device: Device, maps: SurfaceMaps, name: str, outputs: list[moderngl.Texture],
    textures: dict[str, moderngl.Texture], uniforms: dict[str, object], defines: dict[str, str] | None = None,
    clear: bool = True,
) -> None:
    """Draw a shader over a camera's pixels into new textures (or, not cleared, into what is there)."""
    target = device.framebuffer(outputs)
    if clear:
        target.clear()
    device.draw(name, target, textures={"u_position": maps.position, "u_normal": maps.normal, **textures},
                uniforms=uniforms, defines=defines, cells=maps.cells)
    target.release()


def _lamp(light: Light) -> dict[str, object]:
    """Uniforms of one light."""
    return {**light_model.light_uniforms(light), "u_power": tuple(light.power)}


def _lamp_defines(light: Light) -> dict[str, str]:
    """What the programs for this light are made for: software rasterisers compute branches that uniforms decide."""
    sharp = light.kind != "AREA" and light.radius == 0.0
    point = light.kind != "AREA" and light.radius <= SOFT_ANGLE * 0.1
    return {"LIGHT_KIND": str(light_model.KINDS.index(light.kind)), **({"LIGHT_SHARP": "1"} if sharp else {}),
            "LIGHT_POINTS": "1" if point else str(LIGHT_POINTS)}


def bytes_per_pixel(views: Sequence[View]) -> int:
    """GPU memory that all views take, for each pixel that one of them has."""
    lobes = sum(len(view.lights) for view in views) * channels_needed(views)
    return estimates.bytes_per_pixel(len(views), lobes, len({view.camera.name for view in views}))


def most_pixels(views: Sequence[View], memory: float) -> int:
    """Pixels of a picture up to which all views fit into ``memory`` GB together."""
    return int(memory * 1e9 / bytes_per_pixel(views))


def channel_masks(channels: int) -> list[tuple[float, float, float]]:
    """Which of R, G and B each channel sums."""
    return [(1.0, 1.0, 1.0)] if channels == 1 else [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]


def channels_needed(views: Sequence[View]) -> int:
    """1 while radiance / irradiance has the same specular part in R, G and B, else 3.

    It has with any one light, whatever its colour, and with several of one colour; but a channel
    with hardly any light holds mostly noise, so strong colours are treated apart as well.
    """
    for view in views:
        colours = [light.power / max(float(light.power.sum()), 1e-20) for light in view.lights]
        if any(np.abs(c - colours[0]).max() > 0.01 or c.min() < 0.25 * c.max() for c in colours):
            return 3
    return 1
