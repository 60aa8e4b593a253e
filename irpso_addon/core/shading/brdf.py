"""The reflectance models, as Cycles renders them: float64 twin of ``shaders/include/brdf.glsl``.

Principled BSDF (IOR 1.5, multiscatter GGX) at any Specular IOR Level, Metallic and Diffuse Roughness, under a coat, two
of them mixed, and the classic two-lobe Cook-Torrance with Beckmann's distribution.

Same names and arguments as there, vectorised over arrays that broadcast.  alpha = roughness^2, alpha2 = alpha^2;
cos_l, cos_v: N.L and N.V; cos_vh: V.H with H the half vector; sin2h: 1 - (N.H)^2, kept as such because
1 - cos^2 cancels in float32 near the peak.  Values are BRDFs in 1/sr, without the cosine of the incoming light.
The tests compare the two files function by function, and this one with Cycles' pixels.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..data import F64, Coat
from ..vectors import dot, length
from .tables import F0, FRESNEL_NODES, IOR, SIZE, SLICES, bilinear, bilinear_d, energy_nodes, principled_table

ArrayLike = float | NDArray[np.floating]  # every argument broadcasts

ROUGHNESS_MIN = 0.05  # the least that solvers look for
LEVEL_MIN = 1e-4  # Specular IOR Level below which slopes by level are those of this one
ALPHA2_MIN = 1e-8  # Beckmann: keeps float32 from overflow
COS2H_MIN = 1e-6  # Beckmann: D is 0 there at any roughness
ROUGH_LOST = 1e-6  # of white, that single scattering loses of a diffuse that is hardly rough


def D_ggx(alpha2: ArrayLike, sin2h: ArrayLike) -> F64:
    """Normal distribution, 1/sr.  Walter et al. 2007, "Microfacet Models for Refraction", eq. 33."""
    return D_ggx_disc(alpha2, sin2h, 0.0)


def D_ggx_disc(alpha2: ArrayLike, sin2h: ArrayLike, radius2: ArrayLike) -> F64:
    """Mean of D over a disc of half vectors: sin^2 of its middle to the normal, square of its radius (0: a point).

    The mean conserves energy however small the lobe is beside the disc.  D is the area that a stereographic projection
    makes of the plane's (sin theta_h to the left and ahead), so that a disc's share is that of a cap: a closed form.
    """
    a2 = np.asarray(alpha2, np.float64)
    inner = np.asarray(radius2 * (1 - a2))
    outside = a2 + (np.asarray(sin2h, np.float64) - radius2) * (1 - a2)
    root = np.sqrt(outside**2 + 4 * a2 * inner)
    far = outside > 0
    # Of two forms of one value the one that does not cancel: the first, but where discs hold the middle of the lobe.
    if far.all():
        return np.asarray(2 * a2 / (root * (root + outside)) / np.pi)
    by_far = 2 * a2 / (root * np.where(far, root + outside, 1.0))
    by_near = (root - outside) / (2 * np.where(far, 1.0, inner) * root)
    return np.asarray(np.where(far, by_far, by_near) / np.pi)


def D_ggx_disc_d(alpha2: ArrayLike, sin2h: ArrayLike, radius2: ArrayLike) -> tuple[F64, F64]:
    """(D_ggx_disc, its derivative by alpha2)."""
    a2 = np.asarray(alpha2, np.float64)
    inner = np.asarray(radius2 * (1 - a2))
    outside = a2 + (np.asarray(sin2h, np.float64) - radius2) * (1 - a2)
    root = np.sqrt(outside**2 + 4 * a2 * inner)
    d_outside = 1 - sin2h + np.asarray(radius2, np.float64)
    d_root = (outside * d_outside + 2 * radius2 * (1 - 2 * a2)) / root
    value = D_ggx_disc(a2, sin2h, radius2)
    far = outside > 0
    sums = np.where(far, root + outside, 1.0)
    by_far = 2 / (np.pi * root * sums) * (1 - a2 * (d_root / root + (d_root + d_outside) / sums))
    by_near = (value / np.where(far, 1.0, 1 - a2)
               + (outside * d_root / root - d_outside) / (2 * np.pi * np.where(far, 1.0, inner) * root))
    return value, np.where(far, by_far, by_near)


def lambda_root(alpha2: ArrayLike, tan2: ArrayLike) -> F64:
    """sqrt(1 + alpha2 tan2); 1 + Lambda_l + Lambda_v is the mean of the two roots.  Heitz 2014, eq. 72 and 99."""
    return np.sqrt(1 + np.asarray(alpha2, np.float64) * tan2)


def D_beckmann(alpha2: ArrayLike, sin2h: ArrayLike) -> F64:
    """Normal distribution exp(-tan^2 / alpha2) / (pi alpha2 cos^4), 1/sr.  Walter et al. 2007, eq. 25."""
    return D_beckmann_disc(alpha2, sin2h, 0.0)


def D_beckmann_disc(alpha2: ArrayLike, sin2h: ArrayLike, radius2: ArrayLike) -> F64:
    """Mean of D over a disc, as ``D_ggx_disc``, by the two points of sin^2 that have its mean and variance."""
    return D_beckmann_disc_d(alpha2, sin2h, radius2)[0]


def D_beckmann_disc_d(alpha2: ArrayLike, sin2h: ArrayLike, radius2: ArrayLike) -> tuple[F64, F64]:
    """(D_beckmann_disc, its derivative by alpha2)."""
    a2, s = np.maximum(np.asarray(alpha2, np.float64), ALPHA2_MIN), np.asarray(sin2h, np.float64)
    u = np.asarray(radius2, np.float64)
    high = s + u / 2 + np.sqrt(u * (s + u / 12))
    low = (s * s + u * u / 6) / np.maximum(high, 1e-30)
    value, derivative = np.zeros(np.broadcast_shapes(a2.shape, high.shape)), 0.0
    for point in (low, high):
        cos2 = np.maximum(1 - point, COS2H_MIN)
        x = point / (a2 * cos2)
        D = np.exp(-x) / (2 * np.pi * a2 * cos2 * cos2)
        value, derivative = value + D, derivative + D * (x - 1) / a2
    return value, np.asarray(derivative)


def lambda_root_beckmann(alpha2: ArrayLike, tan2: ArrayLike) -> F64:
    """1 + 2 Lambda, to be used as ``lambda_root``."""
    return lambda_root_beckmann_d(alpha2, tan2)[0]


def lambda_root_beckmann_d(alpha2: ArrayLike, tan2: ArrayLike) -> tuple[F64, F64]:
    """(lambda_root_beckmann, its derivative by alpha2)."""
    value, derivative = lambda_beckmann_d(alpha2, tan2)
    return 1 + 2 * value, 2 * derivative


def lambda_beckmann_d(alpha2: ArrayLike, tan2: ArrayLike) -> tuple[F64, F64]:
    """(Smith's Lambda, its derivative by alpha2), by the rational fit of Walter et al. 2007, sec. 5.2.

    The fit's G1 = n / d is Lambda = d / n - 1; it is 0 below alpha2 tan2 = 0.39, where Cycles cuts it.
    """
    t2 = np.asarray(tan2, np.float64)
    x = np.asarray(alpha2, np.float64) * t2
    a = 1 / np.sqrt(np.maximum(x, 0.39))
    above, below = 1 + a * (-1.259 + 0.396 * a), a * (3.535 + 2.181 * a)
    by_a = ((-1.259 + 0.792 * a) * below - above * (3.535 + 4.362 * a)) / below**2
    return np.where(x < 0.39, 0.0, above / below), np.where(x < 0.39, 0.0, -0.5 * a**3 * t2 * by_a)


def F_dielectric(cos_vh: ArrayLike) -> F64:
    """Unpolarised Fresnel reflectance at IOR 1.5.  Cook and Torrance 1982, "A Reflectance Model", sec. 5."""
    c = np.asarray(cos_vh, np.float64)
    g = np.sqrt(IOR * IOR - 1 + c * c)
    parallel = (c * (g + c) - 1) / (c * (g - c) + 1)
    return 0.5 * ((g - c) / (g + c)) ** 2 * (1 + parallel * parallel)


def F_level(cos_vh: ArrayLike, level: ArrayLike) -> F64:
    """Fresnel reflectance at the IOR of a Specular IOR Level (0..1); 0 at level 0, ``F_dielectric`` at 0.5."""
    return np.asarray(F_level_ratio(cos_vh, level) * F_dielectric(cos_vh))


def F_level_ratio(cos_vh: ArrayLike, level: ArrayLike) -> F64:
    """Fresnel reflectance at the IOR of ``level`` / that at IOR 1.5."""
    of = _LevelTerms.of(cos_vh, level)
    return 0.5 * (of.q * of.p) ** 2 * of.share * of.scale


def F_level_ratio_d(cos_vh: ArrayLike, level: ArrayLike) -> tuple[F64, F64]:
    """(F_level_ratio, its derivative by level)."""
    of = _LevelTerms.of(cos_vh, level)
    c, q, p = of.c, of.q, of.p
    # By g, over q p: the amplitude's 2 c / u^2 and parallel's 2 c (1 - c^2) / below^2.  dg/dlevel has 1/q.
    by_g = 2 * c * (of.share / of.u**2 + q * p * of.parallel * (1 - c * c) / of.below**2)
    d_level = by_g * p * 2 * F0 * (1 + q) / ((1 - q)**3 * of.g)
    return 0.5 * (q * p) ** 2 * of.share * of.scale, d_level * of.scale


class _LevelTerms(NamedTuple):
    """What `F_level_ratio` and its derivative are made of.

    q = sqrt(F0), F0 = 2 level 0.04 (Cycles' node), IOR = (1 + q) / (1 - q), so IOR^2 - 1 = 4 q / (1 - q)^2, and the
    perpendicular amplitude (g - c) / (g + c) is q p with p = 4 / ((1 - q) (g + c))^2, which does not cancel.
    """

    c: F64
    q: F64
    g: F64
    u: F64  # g + c
    p: F64
    below: F64  # of the parallel amplitude over the perpendicular one
    parallel: F64
    share: F64
    scale: F64

    @classmethod
    def of(cls, cos_vh: ArrayLike, level: ArrayLike) -> _LevelTerms:
        c = np.asarray(cos_vh, np.float64)
        q = np.sqrt(2 * F0 * np.asarray(level, np.float64))
        rest = 1 - q
        g = np.sqrt(np.maximum(4 * q / rest**2 + c * c, 1e-12))
        u = g + c
        p = 4 / (rest * u) ** 2
        below = c * q * p * u + 1
        parallel = (c * u - 1) / below
        return cls(c, q, g, u, p, below, parallel, 1 + parallel**2, 1 / F_dielectric(c))


@cache
def _table() -> F64:
    return principled_table()[:SIZE, :, :2].astype(np.float64)


def principled_energy(roughness: ArrayLike, cos_v: ArrayLike) -> F64:
    """(comp, A), shape (..., 2): gain of the specular lobe and dimming of the diffuse.  Kulla and Conty 2017."""
    return bilinear(_table(), np.asarray(roughness, np.float64), np.asarray(cos_v, np.float64))


def principled_energy_d(roughness: ArrayLike, cos_v: ArrayLike) -> tuple[F64, F64]:
    """(principled_energy, its derivative by roughness): the slope of the table's cell."""
    return bilinear_d(_table(), np.asarray(roughness, np.float64), np.asarray(cos_v, np.float64))


def principled_energy_level(roughness: ArrayLike, cos_v: ArrayLike, level: ArrayLike) -> F64:
    """(comp, A) at a Specular IOR Level 0..1; (1, 0) at level 0, ``principled_energy`` at 0.5."""
    return _LevelEnergy.of(roughness, cos_v, level).value()


def principled_energy_level_d(roughness: ArrayLike, cos_v: ArrayLike, level: ArrayLike) -> tuple[F64, F64, F64]:
    """(principled_energy_level, its derivative by roughness, by level), from Cycles' own nodes (``tables.py``).

    At level 0 comp and A start vertically, as its square and fourth root: below LEVEL_MIN the slope is LEVEL_MIN's.
    """
    of, level = _LevelEnergy.of(roughness, cos_v, level), np.asarray(level, np.float64)
    e1, mean, s, fms, f0 = of.e1, of.mean, of.s, of.fms, of.f0
    floor = np.maximum(level, LEVEL_MIN)
    q_floor = np.sqrt(2 * F0 * floor)
    s_by_level = of.s_by_z * (FRESNEL_NODES - 1) * np.sqrt(q_floor) / (4 * floor)
    fss_by_level = 10.17276 / (5.08638 - 3.08496 * q_floor) ** 2 * F0 / q_floor
    below = 1 - of.fss * (1 - mean)
    fms_by_mean, fms_by_level = of.fss * (1 - of.fss) / below**2, mean / below**2 * fss_by_level
    (d_e1, d_mean), d_s = np.moveaxis(of.d_lobe, -1, 0), of.d_s[..., 0] * (1 - of.t) + of.d_s[..., 1] * of.t
    lobe_by_r = d_e1 * (1 - fms) + fms_by_mean * d_mean * (1 - e1)
    by_r = np.stack([fms_by_mean * d_mean * (1 / e1 - 1) - fms * d_e1 / e1**2,
                     (1 - f0) * d_s * of.lobe() + of.fresnel() * lobe_by_r], -1)
    by_level = np.stack([fms_by_level * (1 / e1 - 1), (2 * F0 * (1 - s) + (1 - f0) * s_by_level) * of.lobe()
                         + of.fresnel() * fms_by_level * (1 - e1)], -1)
    return of.value(), by_r, by_level


class _LevelEnergy(NamedTuple):
    """What `principled_energy_level` and its derivatives are made of."""

    e1: F64
    mean: F64  # Eavg
    d_lobe: F64  # (..., 2) slopes of the two by roughness
    s: F64  # between Cycles' slices beside the level
    s_by_z: F64  # z (0..8) counts the slices
    d_s: F64  # (..., 2) slopes by roughness on the two
    t: F64  # how far the level is from the one to the other
    f0: F64
    fss: F64
    fms: F64

    @classmethod
    def of(cls, roughness: ArrayLike, cos_v: ArrayLike, level: ArrayLike) -> _LevelEnergy:
        r, c, level = (np.asarray(x, np.float64) for x in (roughness, cos_v, level))
        f0 = 2 * F0 * level
        q = np.sqrt(f0)
        z = (FRESNEL_NODES - 1) * np.sqrt(q)
        lobe, d_lobe = bilinear_d(_lobe_nodes(), r, c)
        k = np.minimum(z.astype(int), SLICES - 2)
        s, d_s = bilinear_d(_fresnel_nodes(), r, c, k)
        t = z - k
        # Kulla and Conty's (n - 1) / (4.08567 + 1.00071 n), n = (1 + q) / (1 - q).
        fss = 2 * q / (5.08638 - 3.08496 * q)
        mean = lobe[..., 1]
        return cls(lobe[..., 0], mean, d_lobe, s[..., 0] * (1 - t) + s[..., 1] * t, s[..., 1] - s[..., 0], d_s, t, f0,
                   fss, fss * mean / (1 - fss * (1 - mean)))

    def lobe(self) -> F64:
        """E1 comp."""
        return np.asarray(self.e1 + self.fms * (1 - self.e1))

    def fresnel(self) -> F64:
        """Mean reflectance of the lobe."""
        return np.asarray(self.f0 + (1 - self.f0) * self.s)

    def value(self) -> F64:
        """(comp, A)."""
        return np.stack([1 + self.fms * (1 / self.e1 - 1), self.fresnel() * self.lobe()], -1)


@cache
def _lobe_nodes() -> F64:
    """(E1, Eavg) on Cycles' nodes."""
    nodes = energy_nodes()
    return np.stack([nodes.albedo, np.broadcast_to(nodes.mean[:, None], nodes.albedo.shape)], -1)


@cache
def _fresnel_nodes() -> F64:
    """(SLICES - 1, n, n, 2): s on the two slices beside."""
    fresnel = energy_nodes().fresnel
    return np.stack([fresnel[:-1], fresnel[1:]], -1)


def metal_energy(roughness: ArrayLike, cos_v: ArrayLike) -> F64:
    """(E1, Eavg), shape (..., 2): albedo of the lobe without Fresnel at cos_v, and its mean over the hemisphere."""
    return metal_energy_d(roughness, cos_v)[0]


def metal_energy_d(roughness: ArrayLike, cos_v: ArrayLike) -> tuple[F64, F64]:
    """(metal_energy, its derivative by roughness)."""
    return bilinear_d(_lobe_nodes(), np.asarray(roughness, np.float64), np.asarray(cos_v, np.float64))


def metal_gain(base: ArrayLike, energy: F64) -> F64:
    """Gain of a metal's lobe by multiple scattering; ``energy``: (E1, Eavg) (..., 2), ``base``: (...)."""
    return metal_gain_d(base, energy, np.zeros(2))[0]


def metal_gain_d(base: ArrayLike, energy: F64, slope: F64) -> tuple[F64, F64, F64]:
    """(metal_gain, its derivative by roughness, by base colour); ``slope``: that of ``energy``.  Kulla and Conty 2017.

    Schlick's Fresnel reflectance about a base colour b has the mean b + (1 - b) / 21 over the hemisphere.
    """
    b = np.asarray(base, np.float64)
    e1, mean = energy[..., 0], energy[..., 1]
    fss = b + (1 - b) / 21
    below = 1 - fss * (1 - mean)
    fms, fms_by_mean = fss * mean / below, fss * (1 - fss) / below**2
    return (np.asarray(1 + fms * (1 / e1 - 1)),
            np.asarray(fms_by_mean * slope[..., 1] * (1 / e1 - 1) - fms * slope[..., 0] / e1**2),
            np.asarray(20 / 21 * mean / below**2 * (1 / e1 - 1)))


def F_schlick(cos_vh: ArrayLike) -> F64:
    """(1 - V.H)^5: a metal reflects b + (1 - b) of it.  Schlick 1994, "An Inexpensive BRDF Model", eq. 15."""
    return np.asarray((1 - np.asarray(cos_vh, np.float64)) ** 5)


def lobe_ggx(roughness: ArrayLike, sin2h: ArrayLike, radius2: ArrayLike, cos_l: ArrayLike, cos_v: ArrayLike) -> F64:
    """D / (4 cos_l cos_v (1 + Lambda_l + Lambda_v)): the lobe without Fresnel reflectance.  Heitz 2014, eq. 99."""
    a2 = np.asarray(roughness, np.float64) ** 4
    cl, cv = np.asarray(cos_l, np.float64), np.asarray(cos_v, np.float64)
    roots = lambda_root(a2, 1 / (cl * cl) - 1) + lambda_root(a2, 1 / (cv * cv) - 1)
    return np.asarray(D_ggx_disc(a2, sin2h, radius2) / (2 * cl * cv * roots))


def specular_principled(
    roughness: ArrayLike, sin2h: ArrayLike, radius2: ArrayLike, cos_l: ArrayLike, cos_v: ArrayLike, cos_vh: ArrayLike,
) -> F64:
    """D F comp / (4 cos_l cos_v (1 + Lambda_l + Lambda_v)).  Heitz 2014, eq. 99."""
    gain = principled_energy(roughness, cos_v)[..., 0]
    return np.asarray(lobe_ggx(roughness, sin2h, radius2, cos_l, cos_v) * F_dielectric(cos_vh) * gain)


def specular_beckmann(
    roughness: ArrayLike, sin2h: ArrayLike, radius2: ArrayLike, cos_l: ArrayLike, cos_v: ArrayLike, cos_vh: ArrayLike,
) -> F64:
    """D F / (4 cos_l cos_v (1 + Lambda_l + Lambda_v)) at IOR 1.5.  Walter et al. 2007, eq. 20; Heitz 2014, eq. 99."""
    a2 = np.asarray(roughness, np.float64) ** 4
    cl, cv = np.asarray(cos_l, np.float64), np.asarray(cos_v, np.float64)
    roots = lambda_root_beckmann(a2, 1 / (cl * cl) - 1) + lambda_root_beckmann(a2, 1 / (cv * cv) - 1)
    value: F64 = D_beckmann_disc(a2, sin2h, radius2) * F_dielectric(cos_vh) / (2 * cl * cv * roots)
    return value


def diffuse_principled(roughness: ArrayLike, cos_v: ArrayLike) -> F64:
    """(1 - A) / pi: what the layer above leaves to a white diffuse.  Depends on the view only, as in Cycles."""
    value: F64 = (1 - principled_energy(roughness, cos_v)[..., 1]) / np.pi
    return value


def diffuse_rough(base: ArrayLike, cos_l: ArrayLike, cos_v: ArrayLike, cos_lv: ArrayLike, roughness: float) -> F64:
    """1/sr, of base colour, (..., C), and cosines (...): the improved Oren-Nayar model with energy preservation.

    ``cos_lv``: between the directions to lamp and camera.  ``roughness``: Diffuse Roughness of the Principled BSDF.
    """
    single, lost = rough_parts(cos_l, cos_v, cos_lv, roughness)
    colour = np.asarray(base, np.float64)
    return np.asarray(colour / np.pi * (single[..., None] + lost[..., None] * rough_bounce(colour, roughness)))


def rough_parts(cos_l: ArrayLike, cos_v: ArrayLike, cos_lv: ArrayLike, roughness: float) -> tuple[F64, F64]:
    """What a rough diffuse reflects over what a smooth one does, (...): first + second * ``rough_bounce``.

    Single scattering: Fujii, "A tiny improvement of Oren-Nayar reflectance model".  Multiple scattering: Portsmouth,
    Kutz and Hill 2025, "EON: A Practical Energy-Preserving Rough Diffuse BRDF", but darker: Cycles multiplies it by the
    base colour once more.
    """
    cos_l, cos_v, cos_lv = (np.asarray(a, np.float64) for a in (cos_l, cos_v, cos_lv))
    a = _fujii_scale(roughness)
    t = cos_lv - cos_l * cos_v
    t = np.where(t > 0, t / np.maximum(cos_l, cos_v), t)
    lost = [1 - a * (np.pi + roughness * _fujii(c)) for c in (cos_l, cos_v)]
    return np.asarray(np.pi * a * (1 + roughness * t)), np.asarray(lost[0] * lost[1])


def rough_bounce(base: ArrayLike, roughness: float) -> F64:
    """What multiple scattering adds, for each unit of what single scattering loses toward lamp and camera."""
    base, mean = np.asarray(base, np.float64), rough_albedo(roughness)
    return np.asarray(base**2 * mean / (max(1 - mean, ROUGH_LOST) * (1 - base * (1 - mean))))


def rough_albedo(roughness: float) -> float:
    """Mean over the hemisphere of what single scattering reflects of white."""
    return float(_fujii_scale(roughness) * (np.pi + roughness * (2 * np.pi - 5.6) / 3))


def _fujii_scale(roughness: float) -> float:
    return float(1 / (np.pi + roughness * (np.pi / 2 - 2 / 3)))


def _fujii(cosine: F64) -> F64:
    """Integral of the second term of Fujii's model over the hemisphere."""
    c = np.clip(cosine, 1e-6, 1)
    sine = np.sqrt(1 - c * c)
    return np.asarray(sine * (np.arccos(c) - 2 / 3 - sine * c) + 2 / 3 * sine / c * (1 - sine**3))


class Angles(NamedTuple):
    """What the models need of three unit vectors (..., 3): cosines, and 1 - (N.H)^2; 1 where not ``seen``."""

    seen: NDArray[np.bool_]  # both above the horizon
    cos_l: F64
    cos_v: F64
    cos_vh: F64
    sin2h: F64


def angles(L: ArrayLike, V: ArrayLike, N: ArrayLike) -> Angles:
    """Of unit vectors to the light, to the viewer and along the normal."""
    light, view, normal = (np.asarray(v, np.float64) for v in (L, V, N))
    half = light + view
    half = half / length(half)[..., None]
    cos_l, cos_v, cos_vh = dot(light, normal), dot(view, normal), dot(view, half)
    seen = (cos_l > 0) & (cos_v > 0)
    (nx, ny, nz), (hx, hy, hz) = (np.moveaxis(v, -1, 0) for v in (normal, half))
    sin2h = (ny * hz - nz * hy) ** 2 + (nz * hx - nx * hz) ** 2 + (nx * hy - ny * hx) ** 2
    return Angles(seen, np.where(seen, cos_l, 1.0), np.where(seen, cos_v, 1.0), cos_vh, sin2h)


def principled(
    base: ArrayLike, roughness: ArrayLike, L: ArrayLike, V: ArrayLike, N: ArrayLike, level: ArrayLike = 0.5,
    metallic: ArrayLike = 0.0, coat: Coat | None = None, diffuse_roughness: float = 0.0,
) -> F64:
    """The whole BRDF, 1/sr: base (..., 3 or 1) linear, unit vectors (..., 3), 0 below the horizon.

    Roughness, Specular IOR Level and Metallic: (...).
    """
    at = angles(L, V, N)
    geometry = roughness, at.sin2h, 0.0, at.cos_l, at.cos_v, at.cos_vh
    lobe = lobe_ggx(*geometry[:-1]) * F_dielectric(at.cos_vh)
    if np.all(np.asarray(level) == 0.5):  # the resampled table of the default model
        energy = principled_energy(roughness, at.cos_v)
    else:
        energy = principled_energy_level(roughness, at.cos_v, level)
        lobe = lobe * F_level_ratio(at.cos_vh, level)
    below, specular = 1 - energy[..., 1], lobe * energy[..., 0]
    if diffuse_roughness:
        between = dot(np.asarray(L, np.float64), np.asarray(V, np.float64))
        diffuse = diffuse_rough(base, at.cos_l, at.cos_v, between, diffuse_roughness)
    else:
        diffuse = np.asarray(base) / np.pi
    value = diffuse * below[..., None] + specular[..., None]
    if np.any(np.asarray(metallic) != 0):
        share = np.asarray(metallic, np.float64)[..., None]
        value = (1 - share) * value + share * metal(base, *geometry)
    if coat is not None:
        lobe = specular_principled(coat.roughness, *geometry[1:])
        value = left_by_coat(coat, at.cos_v)[..., None] * value + coat.weight * lobe[..., None]
    return np.where(at.seen[..., None], value, 0.0)


def left_by_coat(coat: Coat, cos_v: ArrayLike) -> F64:
    """What a coat leaves of all that lies below it, toward the viewer: the layering of Cycles."""
    return np.asarray(1 - coat.weight * principled_energy(coat.roughness, cos_v)[..., 1])


def metal(
    base: ArrayLike, roughness: ArrayLike, sin2h: ArrayLike, radius2: ArrayLike, cos_l: ArrayLike, cos_v: ArrayLike,
    cos_vh: ArrayLike,
) -> F64:
    """The Principled BSDF of Metallic 1, (..., 3 or 1) as ``base``: Cycles' F82 tint, white, is Schlick's Fresnel."""
    b, w5 = np.asarray(base, np.float64), F_schlick(cos_vh)[..., None]
    gain = metal_gain(b, metal_energy(roughness, cos_v)[..., None, :])
    return np.asarray(lobe_ggx(roughness, sin2h, radius2, cos_l, cos_v)[..., None] * (b + (1 - b) * w5) * gain)


def two_lobe(base: ArrayLike, lobes: Iterable[ArrayLike], L: ArrayLike, V: ArrayLike, N: ArrayLike, ndf: str) -> F64:
    """Two lobes, 1/sr; base (..., 3 or 1), unit vectors (..., 3); 0 below the horizon.

    lobes: roughness of the first, of the second, and the share of the first, (...) each.
    ndf "ggx": two Principled of one base, mixed.  "beckmann": base / pi plus the mixed D F / (4 cos_l cos_v (1 +
    Lambda_l + Lambda_v)) at IOR 1.5 (Cook and Torrance 1982), no energy coupling.
    """
    r1, r2, weight = lobes
    share = np.asarray(weight, np.float64)[..., None]
    if ndf == "ggx":
        return np.asarray(share * principled(base, r1, L, V, N) + (1 - share) * principled(base, r2, L, V, N))
    at = angles(L, V, N)
    first, second = (specular_beckmann(r, at.sin2h, 0.0, at.cos_l, at.cos_v, at.cos_vh)[..., None] for r in (r1, r2))
    value: F64 = np.where(at.seen[..., None], np.asarray(base) / np.pi + share * first + (1 - share) * second, 0.0)
    return value
