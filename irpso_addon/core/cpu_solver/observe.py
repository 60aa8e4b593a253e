"""What the views say of points of the mesh, by rays: observations of core/cpu_solver/solver.py.

A point takes the pixel of each camera that shows it, and the surface where the ray through that pixel's centre meets
it: the pixel's colour belongs to its own geometry.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np

from ..data import F32, F64, OPAQUE, Bool, Camera, Light, RadianceImage, SceneData, View
from ..job import Progress
from ..observation_quality import DARK_SHARE, EDGE_WEIGHT, MIN_COS_L, MIN_COS_V, useless
from ..projection import pixel_widths, pixels_of, rays_of
from ..shading import brdf
from ..shading.lights import light_irradiance, light_sample
from ..vectors import dot, length
from .rasterise import SurfacePoints, places
from .rays import Index, Rays

EMITTER_POINTS = 16  # on a lamp that is not as good as a point
POINT_ANGLE = 0.004  # radians: extent over distance up to which it is one
EDGE_RANGE = 0.02  # of the share of a lamp's light that arrives, among neighbours; and of all light, what is in doubt
VIEW_BYTES, LAMP_BYTES = 100, 40  # of a point: for each view, and for each point on its lamps
NO_LIGHT = 1e-3  # share of the mean irradiance below which a channel is not lit
TILT = 0.05  # tangent of a tilt of a normal, ...
LEFT = (1 - TILT * np.sqrt(MIN_COS_L**-2 - 1)) / np.hypot(1, TILT)  # ... which leaves that of a point at MIN_COS_L
ReadImage = Callable[[View], RadianceImage]


@dataclass(frozen=True)
class Seen:
    """One view at S points; zero weight where it says nothing."""

    f: F64  # (S, 3) radiance / irradiance, 1/sr
    quality: F64  # (S, 3) squared: 1 for a good observation seen head on
    camera: int  # whose pixels: those of one camera share cos_v
    cos_v: F64  # (S,)
    sin2h: F32  # (S, K) for each of the lamps' points
    cos_l: F32  # (S, K)
    factor: F32  # (S, K, 1 or 3) F / (2 cos_l cos_v) * its share of the irradiance, by channel where they differ


@dataclass(frozen=True)
class Shown:
    """What a camera's pixels show of S points."""

    pixel: Index  # (S, 2) x, y
    seen: Bool  # (S,)
    at: SurfacePoints  # (S, ...) where the pixel's ray meets the mesh
    towards: F64  # (S, 3) unit, to the camera
    cos_v: F64  # (S,)


@dataclass(frozen=True)
class _Picture:
    """What the pixels of a view hold that show S points."""

    view: View
    frame: tuple[str, int, int]  # the camera, width and height of its picture
    rgb: F64  # (S, 3) radiance
    coverage: F32  # (S,) 0: shows nothing of the point


def observe(
    scene: SceneData, points: SurfacePoints, neighbours: Index, read_image: ReadImage,
) -> Generator[Progress, None, tuple[list[Seen], list[View], list[tuple[str, str]], list[str]]]:
    """What each view says, the views that do, those left out and why, and warnings.

    neighbours: (S, 8) of each point among the points, itself where there is none.
    """
    rays = Rays(np.concatenate([scene.mesh.positions, scene.occluders]))
    casters = Rays(np.concatenate([scene.mesh.positions, scene.casters])) if len(scene.unseen) else rays
    shown: dict[tuple[str, int, int], Shown] = {}
    lit: dict[tuple[str, tuple[str, int, int]], F64] = {}
    pictures: list[_Picture] = []
    skipped, warnings = [], []
    for i, view in enumerate(scene.views):
        image = read_image(view)
        warnings += [w for w in image.warnings if w not in warnings]
        h, w = image.rgb.shape[:2]
        key = view.camera.name, w, h
        if key not in shown:
            shown[key] = _shown(scene, rays, points, view.camera, w, h)
        x, y = shown[key].pixel.T
        valid = shown[key].seen & image.valid[y, x] & (image.coverage[y, x] > 0.5)
        if not valid.any():
            skipped.append((view.image.name, f"no usable pixel shows '{scene.mesh.name}'; check camera, mask and "
                            "clipping"))
            continue
        if why := useless(image.rgb[y, x][valid], image.coverage[y, x][valid]):
            skipped.append((view.image.name, why))
            continue
        pictures.append(_Picture(view, key, image.rgb[y, x].astype(np.float64),
                                 np.where(valid, image.coverage[y, x], 0)))
        yield Progress(0.5 * (i + 1) / len(scene.views), "observe", f"reading {view.image.name}")
    levels = [max(float(np.median(p.rgb[p.coverage > 0].mean(-1))), 0.0) for p in pictures]
    level = float(np.median(levels)) if pictures else 1.0
    observed = []
    for i, picture in enumerate(pictures):
        key, lights = picture.frame, picture.view.lights
        for light in lights:
            if (light.name, key) not in lit:
                lit[light.name, key] = _lit(casters, light, shown[key])
        lighting = _lighting(lights, [lit[light.name, key] for light in lights], shown[key], neighbours)
        observed.append(_seen(picture, shown[key], lighting, level, list(shown).index(key)))
        yield Progress(0.5 + 0.5 * (i + 1) / len(pictures), "observe", f"light of {picture.view.image.name}")
    return observed, [picture.view for picture in pictures], skipped, warnings


def _shown(scene: SceneData, rays: Rays, points: SurfacePoints, camera: Camera, width: int, height: int) -> Shown:
    """The pixels that show points, and what their rays meet."""
    size = np.array([width, height])
    at = pixels_of(camera, points.position, (width, height))
    inside = (at >= 0).all(-1) & (at < size).all(-1)  # NaN is not
    if camera.orthographic:
        inside &= (points.position - camera.position) @ camera.forward > 0
    pixel = np.floor(np.where(inside[:, None], at, 0)).astype(np.int64)
    once, back = np.unique(pixel[:, 1] * width + pixel[:, 0], return_inverse=True)
    origin, direction = rays_of(camera, np.stack([once % width, once // width], -1) + 0.5, (width, height))
    known = np.isfinite(direction).all(-1, keepdims=True)
    direction = np.where(known, direction, camera.forward)
    hit = rays.nearest(origin, direction)
    mine = known[:, 0] & (hit.triangle >= 0) & (hit.triangle < len(scene.mesh.positions))
    met = places(scene.mesh, np.where(mine, hit.triangle, 0), hit.weights)
    towards = -direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    cos_v = (towards * met.normal).sum(-1)
    metres = pixel_widths(camera, points.position, height)
    near = np.linalg.norm(met.position[back] - points.position, axis=-1) < 2 * metres / np.maximum(cos_v[back], 0.15)
    same = (met.normal[back] * points.normal).sum(-1) > 0.5
    faces = (towards[back] * points.normal).sum(-1) > 0  # else the point lies behind what the pixel shows
    seen = inside & mine[back] & near & same & faces & (cos_v[back] > MIN_COS_V)
    at_points = SurfacePoints(met.position[back], met.normal[back], met.lifted[back])
    return Shown(pixel, seen, at_points, towards[back], np.where(seen, cos_v[back], 1.0))


def memory(scene: SceneData, points: int) -> int:
    """Bytes that the observations of so many points take while they are gathered: up to twice what they are then."""
    middle = scene.mesh.positions.reshape(-1, 3).mean(0, np.float64, keepdims=True)
    lamps = sum(_points_of(light, middle) for view in scene.views for light in view.lights)
    return points * (VIEW_BYTES * len(scene.views) + LAMP_BYTES * lamps)


def _points_of(light: Light, P: F64) -> int:
    """How many points stand for a lamp."""
    distance = max(float(np.linalg.norm(light.matrix[:3, 3] - P.mean(0))), 1e-9)
    if light.kind == "SUN":
        extent = light.radius
    elif light.kind == "AREA":
        extent = 0.5 * float((np.array(light.size) * np.linalg.norm(light.matrix[:3, :2], axis=0)).max()) / distance
    else:
        extent = light.radius / distance
    return 1 if extent <= POINT_ANGLE else EMITTER_POINTS


def _lit(rays: Rays, light: Light, shown: Shown) -> F64:
    """(S, K) 1 where a point of the lamp is seen from where the pixels look, 0 where not."""
    count = _points_of(light, shown.at.position)
    arrives = np.ones((len(shown.seen), count))
    if light.cast_shadow:
        for k in range(count):
            start = shown.at.lifted
            toward, _ = light_sample(light, start, k, count)
            asked = shown.seen & ((toward * shown.at.normal).sum(-1) > 0)
            arrives[asked, k] = ~rays.blocked(start[asked], toward[asked], endless=light.kind == "SUN")
    return arrives


@dataclass(frozen=True)
class _Lighting:
    """What the K points of a view's lamps send to S points."""

    irradiance: F64  # (S, 3)
    edge: Bool  # (S,) at an edge of shadow or silhouette, or the terminator of lamps that matter there
    powers: F64  # (K, 3) of the lamp of each point
    sin2h: F64  # (S, K)
    cos_l: F64  # (S, K)
    factor: F64  # (S, K) F / (2 cos_l cos_v) * irradiance by a lamp of power 1


def _is_low(light: Light, at: SurfacePoints) -> Bool:
    """(S,) at the terminator: the lamp's middle is below the horizon, or the light changes as a point's at MIN_COS_L.

    With a tilt of the normal; twin of is_sensitive in shaders/include/observed.glsl.
    """
    middle, _ = light_sample(light, at.position, 0, 1)
    middle /= length(middle)[..., None]
    cosine = dot(middle, at.normal)
    across = middle - cosine[..., None] * at.normal
    away = at.normal - TILT * across / np.maximum(length(across), 1e-9)[..., None]
    away /= length(away)[..., None]
    here, tilted = (light_irradiance(light, at.position, normal) for normal in (at.normal, away))
    return np.asarray((cosine < 0) | ((cosine < MIN_COS_L) & (tilted < LEFT * here)))


def _lighting(lights: Sequence[Light], lit: list[F64], shown: Shown, neighbours: Index) -> _Lighting:
    """lit: of each lamp, `_lit`."""
    at, edge = shown.at, (shown.seen[:, None] != shown.seen[neighbours]).any(-1)
    sin2h, cos_l, powers, factor = [], [], [], []
    irradiance, doubt = np.zeros((len(shown.seen), 3)), np.zeros(len(shown.seen))
    for light, arrives in zip(lights, lit, strict=True):
        count = arrives.shape[1]
        toward, weight = light_sample(light, at.position[:, None], np.arange(count)[None], count)
        angles = brdf.angles(toward / np.linalg.norm(toward, axis=-1, keepdims=True), shown.towards[:, None],
                             at.normal[:, None])
        sent = weight * np.where(angles.seen, angles.cos_l, 0)
        whole = light_irradiance(light, at.position, at.normal)  # the points' sum is all but the same
        sent *= (whole / np.maximum(sent.sum(-1), 1e-300))[:, None]
        share = (sent * arrives).sum(-1) / np.maximum(whole, 1e-300)
        beside = np.ptp(share[neighbours], axis=-1)
        beside = np.where(_is_low(light, at), 1.0, np.where(beside > EDGE_RANGE, beside, 0.0))
        doubt += light.power.mean() * np.maximum(whole, 0) * beside
        irradiance += light.power * (sent * arrives).sum(-1, keepdims=True)
        sin2h.append(angles.sin2h)
        cos_l.append(np.clip(angles.cos_l, 1e-3, 1))
        factor.append(sent * arrives * brdf.F_dielectric(angles.cos_vh) / (2 * cos_l[-1] * shown.cos_v[:, None]))
        powers.append(np.repeat(light.power[None], count, 0))
    edge |= doubt > EDGE_RANGE * irradiance.mean(-1)
    return _Lighting(irradiance, edge, *(np.concatenate(parts, axis) for parts, axis in (
        (powers, 0), (sin2h, -1), (cos_l, -1), (factor, -1))))


def _seen(picture: _Picture, shown: Shown, lighting: _Lighting, level: float, camera: int) -> Seen:
    """The view's observations: what each lamp's points send, and what the picture shows of it.

    level: typical radiance.
    """
    irradiance, powers = lighting.irradiance, lighting.powers
    edge = lighting.edge | (picture.coverage < OPAQUE)
    mean = irradiance.mean(-1)
    good = (picture.coverage > 0) & (mean > 0)
    each = irradiance > NO_LIGHT * np.maximum(mean, 1e-300)[:, None]
    quality = shown.cos_v * mean / (mean + DARK_SHARE * level) * np.where(edge, EDGE_WEIGHT, 1.0)
    tints = powers / np.maximum(powers.sum(-1, keepdims=True), 1e-300)
    if np.allclose(tints, tints[0], atol=1e-6):  # whatever the colour, each lamp's share is the same in all channels
        powers, below = powers.mean(-1, keepdims=True), mean[:, None]
    else:
        below = irradiance
    shares = lighting.factor[..., None] * powers / np.maximum(below, 1e-300)[:, None]
    return Seen(
        f=np.where(each, picture.rgb / np.maximum(irradiance, 1e-300), 0.0),
        quality=np.where(each & good[:, None], quality[:, None] ** 2, 0.0), camera=camera, cos_v=shown.cos_v,
        sin2h=lighting.sin2h.astype(np.float32), cos_l=lighting.cos_l.astype(np.float32),
        factor=shares.astype(np.float32))
