"""The Principled BSDF with the numbers that the product does not have, as Cycles renders it, in float64.

From the top: sheen, coat, metal beside (Fresnel lobe over diffuse).  A layer dims what is below it by its albedo toward
the viewer, the largest of the channels.  Sources: Cycles 4.2 to 5.2 for the order and the bookkeeping; the papers below
for the formulas.  ``cycles.py`` measures how far it is from Cycles' pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np

from irpso_addon.core.data import F64
from irpso_addon.core.shading import brdf, tables
from studies.stability.measured.merl import fresnel

SHEEN_NODES = 32  # along roughness and cosine
WHITE = np.ones(3)


@dataclass(frozen=True)
class Numbers:
    """Of one material; all but the colours are between 0 and 1."""

    base: F64 = field(default_factory=lambda: np.full(3, 0.5))  # (3,)
    tint: F64 = field(default_factory=lambda: WHITE)  # (3,) Specular Tint
    roughness: float = 0.5
    level: float = 0.5
    metallic: float = 0.0
    diffuse_roughness: float = 0.0
    coat: float = 0.0
    coat_roughness: float = 0.03
    sheen: float = 0.0
    sheen_roughness: float = 0.5
    second: float = 0.0  # share of a second Principled, of
    second_roughness: float = 0.5


@dataclass(frozen=True)
class Geometry:
    """n pairs of directions."""

    at: brdf.Angles
    cos_lv: F64  # (n,)
    glossy: F64  # (n,) reflectance at IOR 1.5

    @classmethod
    def of(cls, L: F64, V: F64, N: F64) -> Geometry:
        """Of unit vectors (n, 3)."""
        at = brdf.angles(L, V, N)
        return cls(at, (L * V).sum(-1), brdf.F_dielectric(at.cos_vh))


def principled(g: Geometry, numbers: Numbers, sheen_table: F64 | None = None) -> F64:
    """f (n, 3), 1/sr.  ``sheen_table``: see ``cycles.sheen_table``; needed where there is sheen."""
    at, left = g.at, np.ones(len(g.cos_lv))
    value = np.zeros((len(left), 3))
    if numbers.sheen:
        assert sheen_table is not None
        lobe, albedo = _sheen(g, numbers.sheen_roughness, sheen_table)
        value += (numbers.sheen * lobe)[:, None]
        left = left * (1 - numbers.sheen * albedo)
    if numbers.coat:
        gain, albedo = (at_view(part, numbers.coat_roughness, at.cos_v) for part in _coat_tables())
        lobe = lobe_of(at, numbers.coat_roughness) * g.glossy * gain
        value += (numbers.coat * left * lobe)[:, None]
        left = left * (1 - numbers.coat * albedo)
    body = _body(g, numbers, numbers.roughness)
    if numbers.second:
        body = (1 - numbers.second) * body + numbers.second * _body(g, numbers, numbers.second_roughness)
    return np.asarray(np.where(at.seen[:, None], value + left[:, None] * body, 0.0))


def lobe_of(at: brdf.Angles, roughness: float) -> F64:
    """D G2 / (4 cos_l cos_v)."""
    return brdf.lobe_ggx(roughness, at.sin2h, 0.0, at.cos_l, at.cos_v)


@cache
def _coat_tables() -> tuple[F64, F64]:
    """(comp, A) at Specular IOR Level 0.5."""
    both = tables.principled_table()[: tables.SIZE].astype(np.float64)
    return both[..., 0], both[..., 1]


def at_view(table: F64, roughness: float, cos_v: F64) -> F64:
    """``tables.bilinear`` at one roughness, where it takes a tenth of the time."""
    place = roughness * (len(table) - 1)
    i = min(int(place), len(table) - 2)
    row = table[i] + (place - i) * (table[i + 1] - table[i])
    return np.asarray(np.interp(cos_v, np.linspace(0, 1, table.shape[1]), row))


def _body(g: Geometry, of: Numbers, roughness: float) -> F64:
    """(n, 3): metal beside the dielectric."""
    at, nodes, shared = g.at, tables.energy_nodes(), lobe_of(g.at, roughness)[:, None]
    e1 = at_view(nodes.albedo, roughness, at.cos_v)[:, None]
    mean = float(np.interp(roughness, np.linspace(0, 1, len(nodes.mean)), nodes.mean))
    value = np.zeros((len(shared), 3))
    if of.metallic < 1:
        value = (1 - of.metallic) * _dielectric(g, of, roughness, shared, e1, mean)
    if of.metallic:
        value = value + of.metallic * shared * _metal(at.cos_vh[:, None], of, e1, mean)
    return value


def _dielectric(g: Geometry, of: Numbers, roughness: float, shared: F64, e1: F64, mean: float) -> F64:
    """Specular Tint multiplies the reflectance head-on; at the horizon it stays 1."""
    f0, n, at = 2 * of.level * tables.F0, tables.level_ior(of.level), g.at
    white, tinted = 1 - f0, f0 * of.tint

    def between(reflectance: F64) -> F64:  # f0..1 becomes tinted..1
        s = np.clip((reflectance - f0) / white, 0, 1)
        return np.asarray(tinted + (1 - tinted) * s)

    single = between((n - 1) / (4.08567 + 1.00071 * n))  # Kulla and Conty 2017
    multiple = single * mean / (1 - single * (1 - mean))
    gain = 1 + multiple * (1 - e1) / e1
    s = at_view(tables.level_fresnel(tables.energy_nodes(), of.level), roughness, at.cos_v)[:, None]
    albedo = (tinted + (1 - tinted) * s) * e1 * gain
    lobe = shared * between(fresnel(at.cos_vh, float(n))[:, None]) * gain
    return np.asarray(lobe + (1 - albedo.max(1, keepdims=True)) * brdf.diffuse_rough(
        of.base, g.at.cos_l, g.at.cos_v, g.cos_lv, of.diffuse_roughness))


def _metal(cos_vh: F64, of: Numbers, e1: F64, mean: float) -> F64:
    """(n, 3) reflectance times gain: Schlick's, with the tint's value at 82 degrees (Kutz et al. 2021, F82-tint)."""
    most = 6 / 7  # 1 - cos(81.8 degrees)
    dip = (of.base + (1 - of.base) * most**5) * 7 / most**6 * (1 - of.tint)
    away = 1 - cos_vh
    reflectance = np.clip(of.base + (1 - of.base) * away**5 - dip * cos_vh * away**6, 0, 1)
    single = of.base + (1 - of.base) / 21 - dip / 126
    return np.asarray(reflectance * (1 + single * mean / (1 - single * (1 - mean)) * (1 - e1) / e1))


def _sheen(g: Geometry, roughness: float, table: F64) -> tuple[F64, F64]:
    """(lobe (n,), albedo (n,)): Zeltner et al. 2022, "Practical Multiple-Scattering Sheen Using Linearly Transformed
    Cosines", eq. 6 and 7: a cosine lobe, transformed by a and b of the view."""
    at = g.at
    a, b, albedo = (at_view(part, roughness, at.cos_v) for part in np.moveaxis(table, -1, 0))
    along = (g.cos_lv - at.cos_l * at.cos_v) / np.sqrt(np.maximum(1 - at.cos_v**2, 1e-12))
    across2 = np.maximum(1 - at.cos_l**2 - along**2, 0)
    length2 = (a * along + b * at.cos_l) ** 2 + a**2 * across2 + at.cos_l**2
    return np.asarray(albedo / np.pi * (a / length2) ** 2), albedo
