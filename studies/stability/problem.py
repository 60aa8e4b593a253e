"""Texel problems that are not as the solver believes: the patch of studies/bench, and all that can be wrong with it.

What is so and what the solver believes are two ``Geometry``; a ``Trial`` says how they differ, and what happens to the
pictures between lamp and file.  Radiance is in units of a white Lambertian patch head-on below a lamp: 1 is white.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from irpso_addon.core.data import F32, F64, Bool
from irpso_addon.core.observation_quality import DARK_SHARE, MIN_COS_L, MIN_COS_V
from irpso_addon.core.shading import brdf
from tests.support.texel_problem import BUMP, LAMP_DISTANCE, PATCH_RADIUS, Estimate, lamp_positions, smooth_map

from .material import GGX, reflected
from .spoil import Pictures, develop, shifted

CAMERA_DISTANCE, CAMERA_ANGLE = 5.0, 25.0  # half widths of the patch; degrees from the patch's normal
GLOSS = 0.5  # roughness with which light from all around is reflected
SUB_TEXELS, SUB_LAMPS = 4, 16  # across a texel; points on a lamp with a size
GAUSS = (-0.5 / np.sqrt(3.0), 0.5 / np.sqrt(3.0))  # two-point rule over a texel's width


@dataclass(frozen=True)
class Trial:
    """What makes a problem.  The defaults are what every axis starts from."""

    views: int = 12
    cameras: int = 3  # the views are shared out among them
    size: int = 32
    noise: float = 0.002  # relative standard deviation, of each channel by itself, as renderers make it
    shot: float = 0.0  # standard deviation of white; below it goes by the root
    read: float = 0.0  # standard deviation of everything, in units of white
    roughness: float | None = None  # about so much everywhere; None: .13 to .70
    albedo: float | None = None  # about so much everywhere; None: .08 to .75
    border: float = 0.0  # width of spots of roughness .25 and .5, and of base colour, in texels; 0: smooth maps
    coverage: float | None = None  # tan(theta_h) / alpha of each texel's best view; roughness .1 to .3
    grazing: float = CAMERA_ANGLE  # degrees between the cameras and the patch's normal
    depth: str = "float"  # of the files: float, half, 16, 12, 10 (linear), 8 (sRGB)
    tone: float = 1.0  # the file holds radiance to this power and is believed linear
    clip: float = np.inf  # in units of white
    masked: bool = True  # clipped pixels are left out
    shadows: float = 0.0  # share of observations that are a shadow taken for lit
    doubled: float = 0.0  # share of observations with the highlight twice
    blobs: bool = False  # these lie together
    bounce: float = 0.0  # irradiance by way of other surfaces, in units of a lamp's
    normal: float = 0.0  # degrees, RMS, by which believed normals are off
    shift: float = 0.0  # texels by which each camera is off, in a direction of its own
    moved: float = 0.0  # each lamp, in any direction, in units of its distance
    moved_one: float = 0.0  # one lamp, likewise
    gain: float = 0.0  # relative standard deviation of the lamps' intensities
    radius: float = 0.0  # of lamps believed points, in units of their distance
    footprint: float = 0.0  # spread of the half vector's angle over a texel, in units of alpha
    known: bool = True  # and the solver knows it
    beckmann: float = 0.0  # share of Beckmann's distribution in the lobe
    fresnel: str = "1.5"  # IOR, "Schlick", or "metal"
    diffuse: float = 0.0  # share of a diffuse that is not Lambert's: light enters and leaves through a surface
    tail: float = GGX  # exponent of generalised Trowbridge-Reitz: the smaller, the longer the lobe's tail
    metallic: float = 0.0
    coat: float = 0.0  # weight of a sharp clear lobe above it all
    colour: float = 0.0  # of the lamps: 0 white, 1 one channel without light
    seed: int = 0


@dataclass(frozen=True)
class Geometry:
    """Where things are."""

    place: F64  # (h, w, 3)
    normal: F64  # (h, w, 3)
    cameras: F64  # (C, 3)
    lamps: F64  # (K, 3), or (K, h, w, 3) where each texel has its own
    power: F64  # (K, 3) of R, G and B


@dataclass(frozen=True)
class Problem:
    """What a solver gets, and the truth."""

    trial: Trial
    rgb: F32  # (h, w, K, 3) radiance / irradiance, 1/sr
    quality: F32  # (h, w, K) 0: not observed
    cos_v: F32  # (h, w, K)
    lobes: F32  # (h, w, K, 1, 4) sin2h, spread, cos_l, F / (2 cos_l cos_v)
    groups: tuple[int, ...]  # camera of each view
    radiance: F32  # (h, w, K, 3) as the files have it; NaN where clipped and left out
    irradiance: F32  # (h, w, K, 3) believed, in units of white
    unlit: Bool  # (h, w, K) seen, and below the horizon of the lamp that is believed
    clipped: F64  # (K,) share of a view's texels
    believed: Geometry
    truth: Estimate

    @property
    def tint(self) -> F64:
        """Of the lamps, (K, 3), mean 1."""
        return self.believed.power / self.believed.power.mean(1, keepdims=True)

    @property
    def channels(self) -> int:
        """3 where the lamps are coloured so strongly that each channel counts by itself (observations.py)."""
        return 3 if bool(np.any(self.tint.min(1) < 0.25 * self.tint.max(1))) else 1


@dataclass(frozen=True)
class Angles:
    """Of one view at every texel, (h, w)."""

    cos_l: F64
    cos_v: F64
    cos_vh: F64
    sin2h: F64
    reach: F64  # irradiance of a lamp of power 1 where it stands upright

    @property
    def seen(self) -> Bool:
        """Above the horizons."""
        return np.asarray((self.cos_l > 0) & (self.cos_v > 0))


def make(trial: Trial) -> Problem:
    """The problem of a trial; the same trial gives the same numbers, and the seed alone decides the truth."""
    shape, errors, accidents = (np.random.default_rng([stream, trial.seed]) for stream in (1, 2, 3))
    truth = _truth(trial, shape)
    true, believed = _geometries(trial, truth, shape, errors)
    groups = tuple(sorted(k % trial.cameras for k in range(trial.views)))
    directions = errors.uniform(0, 2 * np.pi, trial.cameras)
    width = _texel_widths(trial, truth)
    parts = []
    for k, camera in enumerate(groups):
        turn = trial.shift * np.array([np.cos(directions[camera]), np.sin(directions[camera])])
        parts.append([shifted(part, turn) for part in _picture(trial, truth, true, k, camera, width)])
    diffuse, specular = (np.stack([p[i] for p in parts], 2) for i in range(2))
    cos_l, cos_v = _beliefs(trial, truth, believed, groups)[:2]
    lit = (cos_l > MIN_COS_L) & (cos_v > MIN_COS_V)
    radiance, good, clipped = develop(trial, Pictures(diffuse, specular, truth.base, lit), accidents)
    return _observed(trial, truth, believed, groups, np.where(good[..., None], radiance, np.nan), clipped)


def observed_again(problem: Problem, believed: Geometry, radiance: F64, ambient: float) -> Problem:
    """The problem under another geometry, with radiance (h, w, K, 3) as other files have it.

    ``ambient``: irradiance by light from all around.
    """
    return _observed(problem.trial, problem.truth, believed, problem.groups, radiance, problem.clipped, ambient)


def _observed(
    trial: Trial, truth: Estimate, believed: Geometry, groups: tuple[int, ...], radiance: F64, clipped: F64,
    ambient: float = 0.0,
) -> Problem:
    cos_l, cos_v, irradiance, lobes = _beliefs(trial, truth, believed, groups)
    lit, good = (cos_l > MIN_COS_L) & (cos_v > MIN_COS_V), np.isfinite(radiance[..., 0])
    level = float(np.median(radiance[lit & good].mean(-1))) if (lit & good).any() else 1.0
    typical = irradiance.mean(-1)
    quality = np.where(lit & good, cos_v * typical / (typical + DARK_SHARE * level), 0.0) ** 2
    gloss = brdf.principled_energy(GLOSS, np.clip(cos_v, MIN_COS_V, 1.0))[..., 1] / np.pi
    f = (radiance - ambient * gloss[..., None]) / np.maximum(irradiance + ambient, 1e-9)
    lobes[..., 3] *= typical / np.maximum(typical + ambient, 1e-9)
    return Problem(
        trial, _f32(np.where((quality > 0)[..., None], f, 0.0)), _f32(quality), _f32(np.maximum(cos_v, 1e-3)),
        _f32(lobes[..., None, :]), groups, _f32(radiance), _f32(irradiance), (cos_l <= 0) & (cos_v > MIN_COS_V),
        clipped, believed, truth)


def _beliefs(
    trial: Trial, truth: Estimate, believed: Geometry, groups: tuple[int, ...],
) -> tuple[F64, F64, F64, F64]:
    """`_belief` of all views: (h, w, K), (h, w, K), (h, w, K, 3), (h, w, K, 4)."""
    width = _texel_widths(trial, truth)
    views = [_belief(trial, believed, k, camera, width) for k, camera in enumerate(groups)]
    cos_l, cos_v, irradiance, lobes = (np.stack([view[i] for view in views], 2) for i in range(4))
    return cos_l, cos_v, irradiance, lobes


def angles(geometry: Geometry, k: int, camera: int, normal: F64) -> Angles:
    """Of view k; ``normal`` (..., 3) may have more axes before those of the texels."""
    to_light, to_view = geometry.lamps[k] - geometry.place, geometry.cameras[camera] - geometry.place
    distance = np.sqrt(_dot(to_light, to_light))
    light, view = to_light / distance[..., None], _unit(to_view)
    half = _unit(light + view)
    off = _cross(normal, half)
    return Angles(_dot(normal, light), _dot(normal, view), _dot(view, half), _dot(off, off),
                  (LAMP_DISTANCE / distance) ** 2)


def _truth(trial: Trial, rng: np.random.Generator) -> Estimate:
    n = trial.size
    base = np.stack([smooth_map(n, rng, 0.08, 0.75, 12.0) for _ in range(3)], -1)
    if trial.albedo is not None:
        spare = min(trial.albedo, 1 - trial.albedo, 0.1)
        base = trial.albedo + spare * (base - 0.415) / 0.335
    if trial.fresnel == "metal":
        base = np.zeros_like(base)
    low, high = (0.1, 0.3) if trial.coverage is not None else (0.13, 0.70)
    if trial.roughness is not None:
        low, high = 0.92 * trial.roughness, min(1.08 * trial.roughness, 1.0)
    rough = smooth_map(n, rng, max(low, 0.05), high)
    if trial.border:
        spots = smooth_map(n, rng, 0, 1, trial.border)
        inside = spots > np.median(spots)
        rough = np.where(inside, 0.5, 0.25)
        base = np.where(inside[..., None], 0.35, 1.0) * base
    return Estimate(base, rough)


def _geometries(
    trial: Trial, truth: Estimate, rng: np.random.Generator, errors: np.random.Generator,
) -> tuple[Geometry, Geometry]:
    """What is so, and what the solver believes."""
    n = trial.size
    at = (np.arange(n) + 0.5) / n * 2 - 1
    u, v = np.meshgrid(at, at)
    place = np.stack([u, v, np.sqrt(PATCH_RADIUS**2 - u * u - v * v) - PATCH_RADIUS], -1)
    normal = _tilted(place + np.array([0, 0, PATCH_RADIUS]), BUMP * _slopes(n, rng, 16.0))
    tilt, azimuth = np.radians(trial.grazing), 2 * np.pi * np.arange(trial.cameras) / max(trial.cameras, 1) + 0.3
    cameras = CAMERA_DISTANCE * np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth),
                                          np.full(trial.cameras, np.cos(tilt))], -1)
    order = sorted(range(trial.views), key=lambda k: (k % trial.cameras, k))
    lamps = lamp_positions(trial.views)[order]
    if trial.coverage is not None:
        groups = sorted(k % trial.cameras for k in range(trial.views))
        lamps = _lamps_beside_peaks(trial.coverage, truth.roughness**2, place, normal, cameras[groups], rng)
    hue = np.arange(trial.views) % 3
    power = np.where(np.arange(3) == hue[:, None], 1.0, 1.0 - trial.colour)
    believed = Geometry(place, normal, cameras, lamps, power)
    off = errors.standard_normal((trial.views, 3))
    off *= LAMP_DISTANCE / np.linalg.norm(off, axis=1, keepdims=True)
    one = (np.arange(trial.views) == errors.integers(trial.views))[:, None]
    moves = trial.moved * off + trial.moved_one * one * off
    off_slopes = np.tan(np.radians(trial.normal)) / np.sqrt(2.0) * _slopes(n, errors, 4.0)
    gains = np.maximum(1 + trial.gain * errors.standard_normal((trial.views, 1)), 0.1)
    return Geometry(place, _tilted(normal, off_slopes), cameras, lamps + moves.reshape(-1, *[1] * (lamps.ndim - 2), 3),
                    power * gains), believed


def _lamps_beside_peaks(
    coverage: float, alpha: F64, place: F64, normal: F64, cameras: F64, rng: np.random.Generator,
) -> F64:
    """Lamps of each texel's own, (K, h, w, 3), whose half vectors lie from coverage alpha outwards."""
    along = _unit(np.cross(normal, np.array([0.0, 1.0, 0.3])))
    across = np.cross(normal, along)
    start = rng.uniform(0, 2 * np.pi, alpha.shape)
    lamps = []
    rank = rng.permutation(len(cameras))
    for k, camera in enumerate(cameras):
        turn = start + k * np.pi * (3 - np.sqrt(5))
        slope = alpha * (coverage + 0.2 * rank[k])
        half = _unit(normal + slope[..., None] * (np.cos(turn)[..., None] * along + np.sin(turn)[..., None] * across))
        view = _unit(camera - place)
        lamps.append(place + LAMP_DISTANCE * (2 * (view * half).sum(-1, keepdims=True) * half - view))
    return np.stack(lamps)


def _texel_widths(trial: Trial, truth: Estimate) -> F64 | None:
    """How far normals turn across each texel, as a slope (h, w); None: not at all."""
    if not trial.footprint:
        return None
    return np.asarray(trial.footprint * truth.roughness**2 * np.sqrt(6.0))  # two uniform numbers of variance 1/12


def _turned(normal: F64, width: F64, points: tuple[float, ...]) -> F64:
    """(points^2, h, w, 3): the normals at points of a texel, in units of its width."""
    grid = np.array([(a, b) for a in points for b in points])
    return np.stack([_tilted(normal, np.stack([a * width, b * width], -1)) for a, b in grid])


def _picture(trial: Trial, truth: Estimate, true: Geometry, k: int, camera: int, width: F64 | None) -> tuple[F64, F64]:
    """Radiance (h, w, 3) by the diffuse and by the specular part, without what goes wrong later."""
    normal = true.normal[None]
    if width is not None:
        normal = _turned(true.normal, width, tuple((np.arange(SUB_TEXELS) + 0.5) / SUB_TEXELS - 0.5))
    diffuse, specular = np.zeros((*truth.roughness.shape, 3)), np.zeros((*truth.roughness.shape, 3))
    lamps = _points_on(true, k, trial.radius)
    for lamp in lamps:
        at = angles(lamp, 0, camera, normal)
        lit = np.where(at.seen, at.cos_l, 0.0)
        white, lobe = reflected(trial, truth, at)
        share = (np.pi * at.reach * lit / len(lamps))[..., None]
        diffuse += truth.base * (share * white).mean(0) * true.power[k]
        specular += (share * lobe).mean(0) * true.power[k]
    return diffuse, specular


def _points_on(true: Geometry, k: int, radius: float) -> list[Geometry]:
    """The lamp of view k, as one point or as points over a disc, each as a geometry's only lamp."""
    lamp = true.lamps[k]
    if not radius:
        return [Geometry(true.place, true.normal, true.cameras, lamp[None], true.power)]
    i = np.arange(SUB_LAMPS) + 0.5
    ring, turn = radius * LAMP_DISTANCE * np.sqrt(i / SUB_LAMPS), i * np.pi * (3 - np.sqrt(5))
    along = _unit(np.cross(lamp, np.array([0.31, 0.95, 0.0])))
    across = np.cross(_unit(lamp), along)
    return [Geometry(true.place, true.normal, true.cameras, (lamp + a * along + b * across)[None], true.power)
            for a, b in zip(ring * np.cos(turn), ring * np.sin(turn), strict=True)]


def _belief(trial: Trial, believed: Geometry, k: int, camera: int, width: F64 | None) -> tuple[F64, F64, F64, F64]:
    """Of view k as the solver has it: cos_l, cos_v, irradiance (h, w, 3), lobe (h, w, 4)."""
    normal = believed.normal[None] if width is None or not trial.known else _turned(believed.normal, width, GAUSS)
    at = angles(believed, k, camera, normal)
    weight = np.maximum(at.cos_l, 1e-6)
    total = weight.sum(0)
    mean = (weight * at.sin2h).sum(0) / total
    spread = np.sqrt(np.maximum((weight * at.sin2h**2).sum(0) / total - mean**2, 0.0)) if len(normal) > 1 else 0 * mean
    cos_l, cos_v = (weight * at.cos_l).sum(0) / total, at.cos_v.mean(0)
    safe_l, safe_v = np.maximum(cos_l, MIN_COS_L), np.maximum(cos_v, MIN_COS_V)
    factor = brdf.F_dielectric(np.clip(at.cos_vh, 0, 1)) / (2 * safe_l * safe_v)
    lit = np.maximum(at.cos_l, 0.0).mean(0)
    irradiance = np.pi * (at.reach * lit)[..., None] * believed.power[k]
    return cos_l, cos_v, irradiance, np.stack([mean, spread, safe_l, factor * np.ones_like(mean)], -1)


def _f32(values: F64) -> F32:
    return np.asarray(values, np.float32)


def _slopes(size: int, rng: np.random.Generator, texels: float) -> F64:
    """Slopes (h, w, 2) of a bumpy field, each of standard deviation 1."""
    v, u = np.gradient(smooth_map(size, rng, -1, 1, texels))
    return np.stack([-u / u.std(), -v / v.std()], -1)


def _tilted(normal: F64, slopes: F64) -> F64:
    """Unit normals turned by slopes along x and y."""
    return _unit(_unit(normal) + np.concatenate([slopes, np.zeros_like(slopes[..., :1])], -1))


def _unit(v: F64) -> F64:
    return np.asarray(v / np.sqrt(_dot(v, v))[..., None])


def _dot(a: F64, b: F64) -> F64:
    """Over the last axis; by hand, as numpy is slow along axes of three."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def _cross(a: F64, b: F64) -> F64:
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)
