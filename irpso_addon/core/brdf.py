"""Cycles' Principled BSDF (metallic 0, IOR 1.5, multiscatter GGX): float64 twin of ``shaders/include/brdf.glsl``.

Same names and arguments as there, vectorised over arrays that broadcast.  alpha = roughness^2, alpha2 = alpha^2;
cos_l, cos_v: N.L and N.V; cos_vh: V.H with H the half vector; sin2h: 1 - (N.H)^2, kept as such because
1 - cos^2 cancels in float32 near the peak.  Values are BRDFs in 1/sr, without the cosine of the incoming light.
The tests compare the two files function by function, and this one with Cycles' pixels.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from .data import F64
from .tables import IOR, bilinear, principled_table

ArrayLike = float | NDArray[np.floating]  # every argument broadcasts


def D_ggx(alpha2: ArrayLike, sin2h: ArrayLike) -> F64:
    """Normal distribution, 1/sr.  Walter et al. 2007, "Microfacet Models for Refraction", eq. 33."""
    a2, s = np.asarray(alpha2, np.float64), np.asarray(sin2h, np.float64)
    # alpha2 cos^2 + sin^2, with cos^2 = 1 - sin^2
    return a2 / (np.pi * (s * (1 - a2) + a2) ** 2)


def D_ggx_spread(alpha2: ArrayLike, sin2h: ArrayLike, spread: ArrayLike) -> F64:
    """Mean of D over two points sin2h +- spread: two-point Gauss-Hermite rule for its mean over a pixel or lamp."""
    s = np.asarray(sin2h, np.float64)
    half = np.minimum(spread, s)
    return 0.5 * (D_ggx(alpha2, s - half) + D_ggx(alpha2, s + half))


def D_ggx_spread_d(alpha2: ArrayLike, sin2h: ArrayLike, spread: ArrayLike) -> tuple[F64, F64]:
    """(D_ggx_spread, its derivative by alpha2)."""
    a2, s = np.asarray(alpha2, np.float64), np.asarray(sin2h, np.float64)
    half = np.minimum(spread, s)
    low, high = s - half, s + half
    q_low, q_high = low * (1 - a2) + a2, high * (1 - a2) + a2
    derivative = (low * (1 + a2) - a2) / q_low**3 + (high * (1 + a2) - a2) / q_high**3
    return D_ggx_spread(a2, s, half), derivative / (2 * np.pi)


def lambda_root(alpha2: ArrayLike, tan2: ArrayLike) -> F64:
    """sqrt(1 + alpha2 tan2); 1 + Lambda_l + Lambda_v is the mean of the two roots.  Heitz 2014, eq. 72 and 99."""
    return np.sqrt(1 + np.asarray(alpha2, np.float64) * tan2)


def F_dielectric(cos_vh: ArrayLike) -> F64:
    """Unpolarised Fresnel reflectance at IOR 1.5.  Cook and Torrance 1982, "A Reflectance Model", sec. 5."""
    c = np.asarray(cos_vh, np.float64)
    g = np.sqrt(IOR * IOR - 1 + c * c)
    parallel = (c * (g + c) - 1) / (c * (g - c) + 1)
    return 0.5 * ((g - c) / (g + c)) ** 2 * (1 + parallel * parallel)


@cache
def _table() -> F64:
    return principled_table().astype(np.float64)


def principled_energy(roughness: ArrayLike, cos_v: ArrayLike) -> F64:
    """(comp, A), shape (..., 2): gain of the specular lobe and dimming of the diffuse.  Kulla and Conty 2017."""
    return bilinear(_table(), *np.broadcast_arrays(np.asarray(roughness, np.float64), cos_v))


def principled_energy_d(roughness: ArrayLike, cos_v: ArrayLike) -> tuple[F64, F64]:
    """(principled_energy, its derivative by roughness): the slope of the table's cell."""
    table = _table()
    last = len(table) - 1
    r, c = np.broadcast_arrays(np.clip(np.asarray(roughness, np.float64), 0, 1), cos_v)
    below = np.minimum((r * last).astype(int), last - 1)
    slope = bilinear(table, (below + 1) / last, c) - bilinear(table, below / last, c)
    return principled_energy(r, c), slope * last


def specular_principled(
    roughness: ArrayLike, sin2h: ArrayLike, spread: ArrayLike, cos_l: ArrayLike, cos_v: ArrayLike, cos_vh: ArrayLike,
) -> F64:
    """D F comp / (4 cos_l cos_v (1 + Lambda_l + Lambda_v)).  Heitz 2014, eq. 99."""
    a2 = np.asarray(roughness, np.float64) ** 4
    cl, cv = np.asarray(cos_l, np.float64), np.asarray(cos_v, np.float64)
    roots = lambda_root(a2, 1 / (cl * cl) - 1) + lambda_root(a2, 1 / (cv * cv) - 1)
    gain = principled_energy(roughness, cv)[..., 0]
    value: F64 = D_ggx_spread(a2, sin2h, spread) * F_dielectric(cos_vh) * gain / (2 * cl * cv * roots)
    return value


def diffuse_principled(roughness: ArrayLike, cos_v: ArrayLike) -> F64:
    """(1 - A) / pi: what the layer above leaves to a white diffuse.  Depends on the view only, as in Cycles."""
    value: F64 = (1 - principled_energy(roughness, cos_v)[..., 1]) / np.pi
    return value


def principled(base: ArrayLike, roughness: ArrayLike, L: ArrayLike, V: ArrayLike, N: ArrayLike) -> F64:
    """The whole BRDF, 1/sr: base (..., 3 or 1) linear, roughness (...), unit vectors (..., 3); 0 below the horizon."""
    light, view, normal = (np.asarray(v, np.float64) for v in (L, V, N))
    half = light + view
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    cos_l, cos_v, cos_vh = ((a * b).sum(-1) for a, b in ((light, normal), (view, normal), (view, half)))
    sin2h = (np.cross(normal, half) ** 2).sum(-1)
    seen = (cos_l > 0) & (cos_v > 0)
    cos_l, cos_v = np.where(seen, cos_l, 1.0), np.where(seen, cos_v, 1.0)
    diffuse = diffuse_principled(roughness, cos_v)
    specular = specular_principled(roughness, sin2h, 0.0, cos_l, cos_v, cos_vh)
    value: F64 = np.where(seen[..., None], np.asarray(base) * diffuse[..., None] + specular[..., None], 0.0)
    return value
