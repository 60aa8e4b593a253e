"""Views -> observations: at every pixel of a camera, reflected radiance per irradiance and how far to trust it.

The pixel is the unit of observation, with its own geometry: a texel is later matched to the pixel
that shows it.  Interpolating colours at the texel's own geometry instead doubles the roughness error.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import moderngl
import numpy as np
from numpy.typing import NDArray

from ...core.data import F32, OPAQUE, SOLID, Bool, Bounced, Camera, RadianceImage, SceneData, View
from ...core.images.read_ahead import ReadAhead
from ...core.job import Progress
from ...core.observation_quality import useless
from ...core.projection import lens_axes
from ...core.shading import environment as environment_model
from ...core.shading.tables import principled_table
from ..device.context import Device, Inputs
from ..gbuffer.gbuffer import GBufferMaps, MeshBuffer, Occluders, draw_pixel_grid
from ..gbuffer.projection import Projection, lens_uniforms, projection_of
from ..gbuffer.seams import mark_seams
from ..gbuffer.solve_mask import SolveMask
from .ambient_light import AmbientShadows, Pair, is_ambient, with_ambient
from .environment_light import EnvironmentLight, LitByEnvironment
from .indirect_light import Smoother
from .picture_memory import channels_needed, mean_radiance
from .view_drawing import ViewDrawer, draw_pixels
from .visibility import SHADOW_SIZE, LightVisibility

EDGE_QUALITY = 0.25  # of a good pixel's: below it lies an edge of shadow or silhouette
MARGIN = 6  # pixels around the object in which its outline may be looked for
BLACK = np.float32(1e-6)  # of the brightest: no lit pixel is nearer to 0, so that its irradiance is radiance / f
HALF_MOST = 60_000.0  # half floats end at 65504
ReadImage = Callable[[View], RadianceImage]
F16 = NDArray[np.float16]
EnvironmentKey = tuple[str, float, tuple[str, ...]]
Colour = tuple[float, float, float]
Reference = tuple[F16, float, float]  # as ObservedView.reference, .scale and .clipped


class LitMaps(dict[tuple[str, str, tuple[int, int]], moderngl.Texture]):
    """Which pixels lights reach: by light, and camera with the size of its picture."""

    def release(self) -> None:
        """Forget them all."""
        for texture in self.values():
            texture.release()
        self.clear()


@dataclass
class ObservedView:
    """One view at its camera's pixels."""

    view: View
    # RGBA32F: radiance / irradiance (1/sr), quality.  Without quality: at least so much, of a clipped pixel; else 0.
    colour: moderngl.Texture
    lobes: list[moderngl.Texture]  # per light, per channel: sin2h, radius2, cos_l, factor
    tint: tuple[float, float, float]  # power of the view's lights per channel, mean 1
    reference: F16  # (h, w, 4) the picture in the camera's window: radiance / scale (NaN: not usable), coverage
    scale: float
    clipped: float  # share of the object's pixels that the picture has clipped
    nodes: moderngl.Texture | None = None  # of the view's environment, as of EnvironmentLight; views may share it

    @property
    def objects(self) -> tuple[moderngl.Texture | None, ...]:
        """All that is on the device."""
        return (self.colour, *self.lobes, self.nodes)


@dataclass
class ObservedCamera:
    """A camera's pixel grid with the views taken through it."""

    camera: Camera
    maps: GBufferMaps
    projection: Projection
    uniforms: dict[str, object]
    window: tuple[int, int, int, int]  # x, y, width, height of the pixels that show the object, and MARGIN
    views: list[ObservedView] = field(default_factory=list)

    @property
    def viewpoint(self) -> dict[str, object]:
        """The uniforms that give the direction to the camera."""
        return {k: self.uniforms[k] for k in ("u_camera_position", "u_camera_forward", "u_orthographic")}

    @property
    def defines(self) -> dict[str, str]:
        """Of the programs that have ``uniforms``."""
        return self.projection.defines

    @property
    def objects(self) -> tuple[moderngl.Texture | moderngl.Buffer | None, ...]:
        """All that is on the device."""
        return (*self.maps.objects, *(texture for view in self.views for texture in view.objects))


@dataclass(frozen=True)
class Observations:
    """All cameras, and what was noticed on the way."""

    cameras: list[ObservedCamera]
    channels: int  # 1: lights are white enough that the mean of RGB tells all; 3: each channel by itself
    level: float  # typical radiance of the views (median over pixels that show the surface)
    skipped: tuple[tuple[str, str], ...]  # (view, why)
    warnings: tuple[str, ...]
    principled_table: moderngl.Texture

    @property
    def objects(self) -> tuple[moderngl.Texture | moderngl.Buffer | None, ...]:
        """All that is on the device."""
        return (self.principled_table, *(made for camera in self.cameras for made in camera.objects))

    def release(self) -> None:
        """Free them, where no scope does."""
        self._release(*self.objects)

    def release_views(self) -> None:
        """Free all but what the cameras see of the mesh, which another observation may take over."""
        self._release(self.principled_table, *(made for camera in self.cameras for view in camera.views
                                               for made in view.objects))

    def _release(self, *objects: moderngl.Texture | moderngl.Buffer | None) -> None:
        for made in objects:
            if made is not None:
                made.release()


def camera_uniforms(camera: Camera, height: int, footprint: float) -> dict[str, object]:
    """What include/pixel.glsl needs to know of a camera; `lens_defines` says whether it has a lens."""
    lens = {} if camera.lens is None else lens_uniforms(camera.lens, lens_axes(camera))
    return {
        **lens, "u_camera_position": tuple(camera.position), "u_camera_forward": tuple(camera.forward),
        "u_orthographic": camera.orthographic,
        "u_pixel_width": 2.0 / (abs(float(camera.projection[1, 1])) * height), "u_footprint": footprint,
    }


@dataclass(frozen=True)
class ObserveOptions:
    """How a scene is observed, where that is not the usual way."""

    bounced: Mapping[int, Bounced] | None = None  # indirect light, by the view's place in the scene
    mask: SolveMask | None = None  # what alone is looked at
    shadow_size: int = SHADOW_SIZE  # texels of a shadow map on a side, at most
    # Typical radiance of the views, where it is known from before; then no view is skipped, so that observations are
    # laid out alike wherever one looks.
    level: float | None = None
    directions: int = environment_model.COUNT  # that stand for an environment
    ambient: AmbientShadows | None = None  # as far as they are drawn
    drawn: Sequence[ObservedCamera] = ()  # by an earlier observation of the same mesh; they are taken over
    lit: LitMaps | None = None  # by the same lamps on the same positions: taken over; what is missing is added


WHOLE = ObserveOptions()


def observe(
    device: Device, scene: SceneData, mesh: MeshBuffer, read_image: ReadImage, limits: ObserveOptions = WHOLE,
) -> Generator[Progress, None, Observations]:
    """Draw every camera's maps, every light's shadow, and turn each reference into observations."""
    with device.scope() as owned:
        observer = _Observer(device, scene, mesh, limits)
        yield from observer.read(read_image)
        yield from observer.light()
        yield from observer.light_from_around()
        yield from observer.ambient_light()
        yield from observer.divide()
        observations = observer.observations()
        owned.hand_over(*observations.objects, *(limits.lit or {}).values())
        return observations


class _Observer:
    """The steps of `observe`, and what passes between them; lists are by camera, dicts by the view's place."""

    def __init__(self, device: Device, scene: SceneData, mesh: MeshBuffer, limits: ObserveOptions) -> None:
        self.device, self.scene, self.mesh, self.limits = device, scene, mesh, limits
        self.occluders, self.casters = Occluders(device, scene.occluders), Occluders(device, scene.casters)
        self.cameras: list[ObservedCamera] = []
        self.covered: list[Bool] = []  # pixels that show the object
        self.members: list[list[int]] = []  # places of the camera's views
        self.images: dict[int, moderngl.Texture] = {}
        self.references: dict[int, Reference] = {}
        self.lit = LitMaps() if limits.lit is None else limits.lit
        self.around: dict[tuple[EnvironmentKey, int], EnvironmentLight] = {}  # by environment and camera
        self.open: list[moderngl.Texture] = []  # irradiance by ambient light of radiance 1, where some view has any
        table = principled_table()
        self.table = device.texture(table.shape[1], table.shape[0], table.shape[2], table)
        self.levels: list[F32] = []
        self.warnings: list[str] = []
        self.skipped: list[tuple[str, str]] = []
        self._numbers: dict[tuple[str, int, int], int] = {}  # of cameras, by name and size of the picture
        self.channels = channels_needed(scene.views)

    @property
    def level(self) -> float:
        """Typical radiance of the views."""
        if self.limits.level is not None:
            return self.limits.level
        return float(np.median(np.concatenate(self.levels))) if self.levels else 1.0

    def read(self, read_image: ReadImage) -> Generator[Progress, None, None]:
        """Every view's reference onto the device, and what its camera sees."""
        views = self.scene.views
        with ReadAhead(read_image, views) as pictures:
            for n, view in enumerate(views):
                name = f"reading {view.image.name}"
                image = yield from pictures.next(Progress(0.5 * n / len(views), "observe", name))
                self.warnings += [w for w in image.warnings if w not in self.warnings]
                if self._take(n, view, image):
                    yield Progress(0.5 * (n + 1) / len(views), "observe", name)

    def _take(self, n: int, view: View, image: RadianceImage) -> bool:
        """Upload a reference; False where no pixel of it is usable."""
        c = self._camera(view.camera, *image.rgb.shape[1::-1])
        opaque = self.covered[c] & (image.coverage > SOLID)
        good = opaque & image.valid
        if view.environment is None and not any(light.power.max() > 0 for light in view.lights):
            self.skipped.append((view.image.name, "none of its lights has power; set their power"))
            return False
        if self.limits.level is None:
            if not good.any():
                name = f"'{self.scene.mesh.name}'"
                what = name if self.limits.mask is None or self.limits.mask.whole else f"the region of {name}"
                self.skipped.append((view.image.name, f"no usable pixel shows {what}; check camera, mask and clipping"))
                return False
            if why := useless(image.rgb[good], image.coverage[good]):
                self.skipped.append((view.image.name, why))
                return False
            brightness = np.median((image.rgb[..., 0] + image.rgb[..., 1] + image.rgb[..., 2])[good]) / np.float32(3)
            self.levels.append(np.maximum(brightness, np.float32(0))[None])
        shown = np.where(image.coverage < OPAQUE, image.coverage, np.float32(1))
        quality = np.where(image.valid & (image.coverage > SOLID), shown, 0.0)
        # Read noise may leave less than 0: that is data, because the fit is linear in it.
        known = image.rgb if image.valid.all() else np.where(image.valid[..., None], image.rgb, np.float32(0))
        floor = BLACK * max(known.max(), np.float32(0))
        packed = np.empty((*quality.shape, 4), np.float32)
        packed[..., :3], packed[..., 3] = np.where(np.abs(known) < floor, floor, known), quality
        clipped = float(np.mean(~image.valid[opaque])) if opaque.any() else 0.0
        self.references[n] = _reference(packed, image.coverage, self.cameras[c].window, clipped)
        bounds = ~image.valid & (image.coverage >= OPAQUE)  # what lies beside the object brightens no pixel there
        packed[quality <= 0] = 0
        packed[bounds, :3] = np.maximum(image.rgb[bounds], 0)
        height, width = quality.shape
        self.images[n] = self.device.texture(width, height, 4, packed)
        self.members[c].append(n)
        return True

    def _camera(self, camera: Camera, width: int, height: int) -> int:
        """The number of a camera with pictures of this size; drawn when it is first asked for."""
        key = camera.name, width, height
        if key not in self._numbers:
            self._numbers[key] = len(self.cameras)
            drawn = next((other for other in self.limits.drawn if other.camera is camera
                          and other.maps.position.size == (width, height)), None)
            drawn = self._drawn(camera, width, height) if drawn is None else replace(drawn, views=[])
            self.covered.append(self._covered(drawn.maps))
            self.cameras.append(drawn)
            self.members.append([])
        return self._numbers[key]

    def _drawn(self, camera: Camera, width: int, height: int) -> ObservedCamera:
        """What a camera sees."""
        footprint = self.scene.pixel_filter
        maps = draw_pixel_grid(self.device, self.mesh, self.occluders, camera, (width, height), footprint)
        mark_seams(self.device, self.mesh, self.occluders, camera, maps, footprint)
        maps = self.limits.mask.pixels(self.device, maps) if self.limits.mask else maps
        projection = projection_of(camera, [self.mesh.bundles, self.occluders.bundles])
        return ObservedCamera(camera, maps, projection, camera_uniforms(camera, height, footprint),
                              _window(self._covered(maps)))

    def _covered(self, maps: GBufferMaps) -> Bool:
        return np.asarray(self.device.read(maps.position)[..., 3] > 0.5)

    def light(self) -> Generator[Progress, None, None]:
        """Which pixels each light reaches."""
        views = self.scene.views
        by_name = {light.name: light for view in views for light in view.lights}
        missing: dict[str, list[int]] = {}
        for name in by_name:
            chosen = [c for c, group in enumerate(self.members) if self._lit_by(name, c) not in self.lit
                      and any(other.name == name for n in group for other in views[n].lights)]
            if chosen:
                missing[name] = chosen
        if not missing:
            return
        with self.device.scope() as owned:
            visibility = LightVisibility(self.device, self.mesh, self.casters, self.limits.shadow_size)
            for i, (name, chosen) in enumerate(missing.items()):
                lit: list[moderngl.Texture] = []
                pixels = max(_diameter(self.cameras[c], visibility) for c in chosen)
                for maps in visibility.lit_maps(by_name[name], [self.cameras[c].maps for c in chosen], pixels):
                    lit = maps  # the last is whole
                    yield Progress(0.5 + 0.3 * i / len(missing), "observe", f"shadows of {name}")
                self.lit.update({self._lit_by(name, c): texture for c, texture in zip(chosen, lit, strict=True)})
            owned.hand_over(*self.lit.values())

    def _lit_by(self, light: str, c: int) -> tuple[str, str, tuple[int, int]]:
        """The key of a light's shadows on a camera's pixels."""
        camera = self.cameras[c]
        return light, camera.camera.name, camera.maps.position.size

    def light_from_around(self) -> Generator[Progress, None, None]:
        """What each environment does on each camera's pixels."""
        views = self.scene.views
        environments = {view.environment.key: view.environment for view in views if view.environment is not None}
        if not environments:
            return
        with self.device.scope() as kept:
            visibility = LightVisibility(self.device, self.mesh, self.casters, 1)
            for i, (key, environment) in enumerate(environments.items()):
                lit_by = [{found.key for n in group if (found := views[n].environment) is not None}
                          for group in self.members]
                chosen = [c for c, keys in enumerate(lit_by) if key in keys]

                def told(share: float, i: int = i, name: str = environment.title) -> Progress:
                    return Progress(0.5 + 0.3 * (i + share) / len(environments), "observe", f"light of {name}")

                with self.device.scope() as passing:
                    lit = LitByEnvironment(self.device, visibility, environment_model.directions(
                        environment, self.limits.directions), environment.emitters)
                    for done in lit.draw_shadows():
                        yield told(0.4 * done)
                    for n, c in enumerate(chosen):
                        for made in lit.light(self.cameras[c]):
                            if made is not None:
                                self.around[key, c] = made
                                passing.hand_over(made.irradiance, made.nodes)
                            yield told(0.4 + 0.6 * n / len(chosen))
            kept.hand_over(*(texture for light in self.around.values() for texture in (light.irradiance, light.nodes)))

    def ambient_light(self) -> Generator[Progress, None, None]:
        """What of light from everywhere each camera's pixels see."""
        if not is_ambient(self.scene.views):
            return
        with self.device.scope() as kept:
            shadows = self.limits.ambient
            if shadows is None or shadows.lit is None:  # what is drawn here is gone with the scope
                shadows = AmbientShadows(self.device, self.mesh, self.scene.casters)
            for done in shadows.draw():
                yield Progress(0.8 * done, "observe", "ambient light")
            for camera in self.cameras:
                for made in shadows.drawn().irradiance(camera):
                    if made is not None:
                        self.open.append(made)
                    yield Progress(0.8, "observe", "ambient light")
            kept.hand_over(*self.open)

    def divide(self) -> Generator[Progress, None, None]:
        """Radiance over irradiance, and the lobes' geometry, of every view."""
        level = self.level
        for c, group in enumerate(self.members):
            camera = self.cameras[c]
            with self.device.scope() as owned:
                drawer = ViewDrawer(self.device, camera, _rim(self.device, camera), level, self.channels)
                smoother = Smoother(self.device, self.mesh, self.occluders, camera.camera, camera.maps,
                                    partial(camera_uniforms, footprint=0.0))
                ambient: dict[Colour, Pair] = {}
                for n in group:
                    camera.views.append(self._observed(n, c, drawer, smoother, ambient))
                    yield Progress(0.8 + 0.2 * n / len(self.scene.views), "observe", self.scene.views[n].image.name)
                owned.hand_over(*(texture for view in camera.views for texture in view.objects))

    def _observed(
        self, n: int, c: int, drawer: ViewDrawer, smoother: Smoother, ambient: dict[Colour, Pair],
    ) -> ObservedView:
        """What view ``n`` of camera ``c`` observes.  ``ambient``: such light alone, by its radiance."""
        view, bounced, passing = self.scene.views[n], self.limits.bounced, list[moderngl.Texture]()
        indirect = smoother.smooth(bounced[n]) if bounced else None
        passing += indirect or ()
        radiance = view.ambient_radiance
        if any(radiance):
            both = None if bounced else ambient.get(radiance)
            if both is None:
                both = with_ambient(self.device, self.cameras[c], self.open[c], self.table, radiance, indirect)
                if bounced:
                    passing += both
                else:
                    ambient[radiance] = both
            indirect = both
        shadows = [self.lit[self._lit_by(light.name, c)] for light in view.lights]
        around = self.around[view.environment.key, c] if view.environment is not None else None
        colour, lobes, nodes = drawer.draw(view.lights, self.images[n], shadows, indirect, around)
        for texture in (self.images.pop(n), *passing):
            texture.release()  # now: the next view's take their place
        return ObservedView(view, colour, lobes, _tint(view), *self.references[n], nodes)

    def observations(self) -> Observations:
        """Of the cameras that have views."""
        useful = [camera for camera in self.cameras if camera.views]
        return Observations(useful, self.channels, self.level, tuple(self.skipped), tuple(self.warnings), self.table)


def _diameter(camera: ObservedCamera, subject: LightVisibility) -> float:
    """Of the subject's sphere, in pixels at the depth of its centre."""
    pixel = camera.uniforms["u_pixel_width"]
    assert isinstance(pixel, float)
    if not camera.camera.orthographic:
        pixel *= max(float((subject.center - camera.camera.position) @ camera.camera.forward), 0.0)
    return 2.0 * subject.radius / max(pixel, 1e-12)


def _tint(view: View) -> tuple[float, float, float]:
    """Power of the lights per channel, mean 1."""
    power = np.sum([light.power for light in view.lights], axis=0) if view.lights else np.zeros(3)
    if view.environment is not None and not power.any():
        power = mean_radiance(view.environment)
    tint = power / max(float(power.mean()), 1e-20)
    return float(tint[0]), float(tint[1]), float(tint[2])


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
    scale = max(max(float(part[..., k].max()) for k in range(3)) / HALF_MOST, 1e-20)
    kept = part / np.float32(scale)
    kept[part[..., 3] <= 0] = np.nan
    kept[..., 3] = coverage[y:y + h, x:x + w]
    return kept.astype(np.float16), scale, clipped


def _rim(device: Device, camera: ObservedCamera) -> moderngl.Texture:
    """What surrounds each of a camera's pixels; half floats hold its whole numbers exactly."""
    rim = device.texture(camera.maps.position.width, camera.maps.position.height, 1, dtype="f2")
    draw_pixels(device, camera.maps, "observe/rim.frag", [rim],
                Inputs(uniforms=camera.uniforms, defines=camera.defines))
    return rim
