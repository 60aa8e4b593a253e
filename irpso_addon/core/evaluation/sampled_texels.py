"""Texels of a sample with all that the views observe of them, and what a material predicts that they show.

A view whose channels are kept apart counts once for each of them: V counts those *layers*.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data import F64, I32, Bool
from ..shading import brdf
from .lobe_values import fresnel_ratio, lobe_values

MISSED_SHADOW = 0.3  # of a texel's typical reflection: darker is taken for a shadow that the shadow map missed
OTHER_CAMERA = 0.02  # weight of another camera's pixels, which show another part of the texture, beside the own one's
LEAST = 1e-12


@dataclass(frozen=True)
class SampledTexels:
    """V layers at T texels."""

    reflected: F64  # (T, V) radiance / irradiance, 1/sr: the mean of R, G and B, or of the layer's channel
    quality: F64  # (T, V) 0 (not observed, or at an edge of shadow or silhouette) to 1
    cos_v: F64  # (T, V)
    lobes: F64  # (T, V, L, 4) per light: sin2h, its spread, cos_l, F / (2 cos_l cos_v) * share of the irradiance
    irradiance: F64  # (T, V) W/m^2 without shadows
    camera: I32  # (V,)
    channel: I32  # (V,) 0 to 2 where the channels are kept apart, else 0
    lamps: I32  # (V,) which set of lamps shone

    def typical(self) -> F64:
        """(T,) median of what a texel reflects; 1 where it is not observed."""
        seen = np.where(self.quality > 0, self.reflected, np.nan)
        some = (self.quality > 0).any(1)
        median = np.ones(len(seen))
        median[some] = np.nanmedian(seen[some], axis=1)
        return np.asarray(np.maximum(median, 1e-4))

    def usable(self) -> Bool:
        """(T, V) good observations that no missed shadow explains."""
        return (self.quality > 0) & (self.reflected > MISSED_SHADOW * self.typical()[:, None])

    def part(self, texels: Bool | I32) -> SampledTexels:
        """Some of the texels."""
        return SampledTexels(self.reflected[texels], self.quality[texels], self.cos_v[texels], self.lobes[texels],
                             self.irradiance[texels], self.camera, self.channel, self.lamps)


@dataclass(frozen=True)
class Lobes:
    """The material of T texels, base colour aside."""

    roughness: F64  # (T, 2) of the two lobes, alike where there is one
    weight: F64  # (T,) of the first
    level: F64  # (T,) Specular IOR Level
    beckmann: bool = False  # two lobes of Beckmann's distribution over a Lambert diffuse


def one_lobe(roughness: F64, level: float) -> Lobes:
    """(T,) roughness under one Specular IOR Level."""
    return Lobes(np.stack([roughness, roughness], -1), np.ones(len(roughness)), np.full(len(roughness), level))


def parts(texels: SampledTexels, lobes: Lobes | None) -> tuple[F64, F64]:
    """(T, V) each: what a white diffuse reflects below the lobes, and what the lobes do; None: Lambert."""
    if lobes is None:
        return np.full(texels.reflected.shape, 1 / np.pi), np.zeros(texels.reflected.shape)
    diffuse, specular = _lobe(texels, lobes.roughness[:, 0], lobes.level, lobes.beckmann)
    if np.any(lobes.weight < 1):
        other = _lobe(texels, lobes.roughness[:, 1], lobes.level, lobes.beckmann)
        w = lobes.weight[:, None]
        diffuse, specular = w * diffuse + (1 - w) * other[0], w * specular + (1 - w) * other[1]
    return diffuse, specular


def _lobe(texels: SampledTexels, roughness: F64, level: F64, beckmann: bool) -> tuple[F64, F64]:
    cos_v = np.clip(texels.cos_v, 1e-3, 1.0)
    shape = lobe_values(texels.lobes, cos_v, roughness, beckmann)
    if beckmann:
        return np.full(cos_v.shape, 1 / np.pi), shape.sum(-1)
    if np.all(level == 0.5):
        energy = brdf.principled_energy(roughness[:, None], cos_v)
    else:
        energy = brdf.principled_energy_level(roughness[:, None], cos_v, level[:, None])
        shape = shape * fresnel_ratio(texels.lobes, cos_v, level[:, None, None])
    return (1 - energy[..., 1]) / np.pi, shape.sum(-1) * energy[..., 0]


def predicted(texels: SampledTexels, lobes: Lobes | None, known: Bool) -> F64:
    """(T, V) radiance / irradiance of all layers, base colour from the layers that are ``known``, (V,).

    Each camera's pixels cover the texture differently, so that a camera's own views say its base colour, and those of
    others where it has none.
    """
    diffuse, specular = parts(texels, lobes)
    unit = np.maximum(texels.reflected, texels.typical()[:, None])
    weight = np.where(texels.usable() & known, texels.quality / unit**2, 0.0) * diffuse
    off = weight * (texels.reflected - specular)
    information = weight * diffuse
    result = np.empty_like(diffuse)
    for channel in np.unique(texels.channel):
        same = texels.channel == channel
        total = off[:, same].sum(1), information[:, same].sum(1)
        for camera in np.unique(texels.camera[same]):
            own = same & (texels.camera == camera)
            share = off[:, own].sum(1), information[:, own].sum(1)
            base = (share[0] + OTHER_CAMERA * total[0]) / np.maximum(share[1] + OTHER_CAMERA * total[1], LEAST)
            result[:, own] = np.clip(base, 0, 1)[:, None]
    return np.asarray(result * diffuse + specular)
