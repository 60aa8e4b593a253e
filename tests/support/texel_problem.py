"""Texel problems of which everything is known: a bumpy patch under lamps in a cone, in float64 from brdf.py.

No scene and no renderer: each observation is the BRDF itself, so that what is measured is the solver alone.
A problem is made from its ``Spec`` and never stored; workers in other processes make their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from irpso_addon.core.data import F32, F64
from irpso_addon.core.shading import brdf

FAILED = 0.1  # an error of roughness above this is a failure
CONE = np.radians(60)  # half angle of the cone of lamps
LAMP_DISTANCE, PATCH_RADIUS = 4.0, 2.0  # in half widths of the patch
BUMP = 0.10  # slope of the bumps, standard deviation along one axis
LEAST_COSINE = 0.05  # of light and view; what is more grazing is not observed
CAMERAS = np.array([[0.0, 0.0, 5.0], [2.2, 0.6, 4.5], [-1.6, -1.8, 4.4]])


@dataclass(frozen=True)
class Spec:
    """What makes a problem."""

    model: str = "one-lobe"  # truth: lambert, one-lobe, two-lobe (GGX)
    views: int = 6  # K, one lamp each
    size: int = 128
    noise: float = 0.0  # relative standard deviation, of each channel by itself
    outliers: float = 0.0  # share of observations that are shadow or a doubled highlight
    borders: bool = False  # roughness of two values with sharp borders between, instead of smooth
    cameras: int = 1
    plane: bool = False  # flat, one orthographic camera above, roughness .3 to .7: the scene for other renderers
    seed: int = 0

    @property
    def title(self) -> str:
        """A line that names it."""
        parts = [self.model, f"K = {self.views}"]
        parts.append(f"{100 * self.noise:g} % noise" if self.noise else "no noise")
        if self.outliers:
            parts.append(f"{100 * self.outliers:g} % outliers")
        parts += ["sharp borders"] * self.borders + ["flat plane"] * self.plane
        return ", ".join(parts)


@dataclass(frozen=True)
class Estimate:
    """What a method says of each texel, (h, w, ...); the lobes in any order."""

    base: F64  # (h, w, 3)
    roughness: F64  # (h, w)
    roughness2: F64 | None = None
    weight: F64 | None = None  # of the lobe with ``roughness``

    def lobes(self) -> F64:
        """The two roughnesses, the smaller first, (h, w, 2)."""
        second = self.roughness if self.roughness2 is None else self.roughness2
        return np.sort(np.stack([self.roughness, second], -1), axis=-1)


@dataclass(frozen=True)
class Errors:
    """How far an estimate is from the truth."""

    albedo: float  # RMSE over texels and channels
    roughness: float  # mean absolute error; of the worse lobe where there are two
    failures: float  # share of texels whose roughness is off by more than FAILED


@dataclass(frozen=True)
class Problem:
    """Observations of a patch of texels, and the truth."""

    spec: Spec
    rgb: F32  # (h, w, K, 3) radiance / irradiance, 1/sr
    quality: F32  # (h, w, K) 1 observed, 0 not
    cos_v: F32  # (h, w, K)
    lobes: F32  # (h, w, K, 1, 4): sin2h, radius2 (0), cos_l, F / (2 cos_l cos_v)
    groups: tuple[int, ...]  # camera of each view; those of one camera follow one another
    truth: Estimate
    lamps: F64  # (K, 3) positions

    def roughness_error(self, found: Estimate) -> F64:
        """Absolute error of roughness, (h, w); the larger of the two lobes' where there are two."""
        return np.asarray(np.abs(found.lobes() - self.truth.lobes()).max(-1))

    def score(self, found: Estimate) -> Errors:
        """The errors of an estimate."""
        rough = self.roughness_error(found)
        rmse = float(np.sqrt(((found.base - self.truth.base) ** 2).mean()))
        return Errors(rmse, float(rough.mean()), float((rough > FAILED).mean()))


def make(spec: Spec) -> Problem:
    """The problem of a spec; the same spec gives the same numbers, and noise does not change the truth."""
    shape = np.random.default_rng(1000 + spec.seed)
    place, normal = _surface(spec, shape)
    truth = _truth(spec, shape)
    lamps = lamp_positions(spec.views)
    groups = tuple(sorted(k % spec.cameras for k in range(spec.views)))
    accidents = np.random.default_rng(2000 + spec.seed)
    rgb, quality, cosines, lobes = [], [], [], []
    for k in range(spec.views):
        light = _unit(lamps[k] - place)
        view = np.broadcast_to([0.0, 0.0, 1.0], place.shape) if spec.plane else _unit(CAMERAS[groups[k]] - place)
        half = _unit(light + view)
        cos_l, cos_v, cos_vh = ((a * b).sum(-1) for a, b in ((normal, light), (normal, view), (view, half)))
        seen = (cos_l > LEAST_COSINE) & (cos_v > LEAST_COSINE)
        cos_l, cos_v = (np.where(c > LEAST_COSINE, c, 0.5) for c in (cos_l, cos_v))
        sin2h = (np.cross(normal, half) ** 2).sum(-1)
        diffuse, specular = reflect(spec.model, truth, sin2h, cos_l, cos_v, cos_vh)
        value = _spoil(spec, accidents, diffuse, specular)
        rgb.append(np.where(seen[..., None], value, 0.0))
        quality.append(seen)
        cosines.append(cos_v)
        factor = brdf.F_dielectric(cos_vh) / (2 * cos_l * cos_v)
        lobes.append(np.stack([sin2h, np.zeros_like(sin2h), cos_l, factor], -1)[..., None, :])
    stacked = [np.stack(a, axis=2).astype(np.float32) for a in (rgb, quality, cosines, lobes)]
    return Problem(spec, stacked[0], stacked[1], stacked[2], stacked[3], groups, truth, lamps)


def reflect(model: str, truth: Estimate, sin2h: F64, cos_l: F64, cos_v: F64, cos_vh: F64) -> tuple[F64, F64]:
    """Diffuse (h, w, 3) and specular (h, w) part of the BRDF, 1/sr."""
    if model == "lambert":
        return truth.base / np.pi, np.zeros_like(sin2h)
    shares = [(truth.roughness, 1.0)]
    if truth.roughness2 is not None and truth.weight is not None:
        shares = [(truth.roughness, truth.weight), (truth.roughness2, 1 - truth.weight)]
    a = sum(share * brdf.diffuse_principled(r, cos_v) for r, share in shares)
    s = sum(share * brdf.specular_principled(r, sin2h, 0.0, cos_l, cos_v, cos_vh) for r, share in shares)
    return truth.base * a[..., None], s


def lamp_positions(count: int) -> F64:
    """Lamps spread evenly over a cone about +z (golden-angle spiral, equal areas)."""
    i = np.arange(count) + 0.5
    z = 1 - (1 - np.cos(CONE)) * i / count
    turn = i * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - z * z)
    return LAMP_DISTANCE * np.stack([ring * np.cos(turn), ring * np.sin(turn), z], -1)


def smooth_map(size: int, rng: np.random.Generator, low: float, high: float, texels: float = 20.0) -> F64:
    """A random map between low and high whose features are about so many texels wide."""
    noise = rng.standard_normal((size, size))
    wave = np.fft.fftfreq(size)
    damp = np.exp(-0.5 * (wave[:, None] ** 2 + wave[None] ** 2) * (1.65 * texels) ** 2)
    field = np.fft.ifft2(np.fft.fft2(noise) * damp).real
    field = (field - field.mean()) / field.std()
    return np.asarray(low + (high - low) * 0.5 * (1 + np.tanh(0.8 * field)))


def _surface(spec: Spec, rng: np.random.Generator) -> tuple[F64, F64]:
    """Position and unit normal of each texel, (h, w, 3)."""
    at = (np.arange(spec.size) + 0.5) / spec.size * 2 - 1
    u, v = np.meshgrid(at, at)
    if spec.plane:
        flat = np.zeros_like(u)
        return np.stack([u, v, flat], -1), np.stack([flat, flat, flat + 1], -1)
    place = np.stack([u, v, np.sqrt(PATCH_RADIUS**2 - u * u - v * v) - PATCH_RADIUS], -1)
    slope_v, slope_u = np.gradient(smooth_map(spec.size, rng, -1, 1, 16.0))
    scale = BUMP / slope_u.std()
    bumps = np.stack([-slope_u * scale, -slope_v * scale, np.zeros_like(u)], -1)
    return place, _unit(_unit(place + np.array([0, 0, PATCH_RADIUS])) + bumps)


def _truth(spec: Spec, rng: np.random.Generator) -> Estimate:
    """Base colour .08 to .75; roughness as the spec says."""
    n = spec.size
    base = np.stack([smooth_map(n, rng, 0.08, 0.75, 12.0) for _ in range(3)], -1)
    if spec.model == "two-lobe":
        first = smooth_map(n, rng, 0.13, 0.45)
        second = first + smooth_map(n, rng, 0.12, 0.40)
        return Estimate(base, first, second, smooth_map(n, rng, 0.25, 0.85))
    low, high = (0.3, 0.7) if spec.plane else (0.13, 0.70)
    rough = smooth_map(n, rng, low, high)
    if spec.borders:
        rough = np.where(rough > np.median(rough), 0.5, 0.25)
    return Estimate(base, rough)


def _spoil(spec: Spec, rng: np.random.Generator, diffuse: F64, specular: F64) -> F64:
    """The observed value (h, w, 3): outliers, then noise."""
    value = diffuse + specular[..., None]
    if spec.outliers:
        kind = rng.random(specular.shape)
        value = np.where((kind < spec.outliers / 2)[..., None], 0.05 * value, value)  # a shadow taken for lit
        mirrored = (kind >= spec.outliers / 2) & (kind < spec.outliers)
        value = np.where(mirrored[..., None], diffuse + 2 * specular[..., None], value)
    if spec.noise:
        value = value * (1 + spec.noise * rng.standard_normal(value.shape))
    return np.asarray(value)


def _unit(v: F64) -> F64:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))
