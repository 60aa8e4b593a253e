"""The one roughness and Specular IOR Level that explain all texels of a sample together, each with its own base colour.

A material whose texels hardly differ is told best by all of them: where no highlight passes a texel, its own numbers
only bend to what the diffuse does not explain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data import F64, Bool
from ..shading import brdf
from .lobe_values import fresnel_ratio, lobe_values
from .sampled_texels import LEAST, SampledTexels

ROUGHNESS = np.geomspace(0.05, 1.0, 18)  # nodes of the search
LEVELS = np.array([0.02, 0.06, 0.12, 0.25, 0.5, 0.75, 1.0])
PLAIN = 4  # of LEVELS: Blender's default
COSINES = np.linspace(0.0, 1.0, 65)
MOST = 20_000  # observations of the sample
HELD_TOGETHER = 1.0  # nats per squared log ratio: how far texels may depart while their level is sought


@dataclass(frozen=True)
class Joint:
    """A material as one."""

    roughness: float  # with the level
    level: float
    plain_roughness: float  # at Specular IOR Level 0.5
    apart_level: float  # the level where each texel has its own roughness


class JointSearch:
    """The model at all nodes, so that any part of the layers can be fitted at once."""

    def __init__(self, texels: SampledTexels) -> None:
        count, layers = texels.reflected.shape
        most = max(MOST // max(layers, 1), 32)
        if count > most:
            texels = texels.part(np.linspace(0, count - 1, most).astype(np.int32))
        self.texels = texels
        self.diffuse, self.specular = _nodes(texels)
        unit = np.maximum(texels.reflected, texels.typical()[:, None])
        # Errors of the cube root of radiance, which lightness is made of.
        self.weight = np.where(texels.usable(), texels.quality * texels.irradiance ** (2 / 3) / unit ** (4 / 3), 0.0)

    def fit(self, known: Bool) -> Joint:
        """From the layers that are ``known``, (V,)."""
        cost = self._costs(known)
        whole = cost.sum(2)
        plain = _lowest(np.log(ROUGHNESS), whole[PLAIN])
        best_level, best = np.unravel_index(whole.argmin(), whole.shape)
        rough = _lowest(np.log(ROUGHNESS), whole[best_level])
        level = _lowest(LEVELS, whole[:, best])
        degrees = np.maximum((self.weight[:, known] > 0).sum(1) - 2, 1)
        noise = max(float(np.median(cost[best_level].min(0) / degrees)), LEAST)
        pull = 2 * HELD_TOGETHER * (np.log(ROUGHNESS) - rough) ** 2
        apart = (cost / noise + pull[:, None]).min(1).sum(1)
        return Joint(float(np.exp(rough)), float(np.clip(level, LEVELS[0], 1.0)), float(np.exp(plain)),
                     float(np.clip(_lowest(LEVELS, apart), LEVELS[0], 1.0)))

    def _costs(self, known: Bool) -> F64:
        """(levels, roughnesses, T) weighted squared residual, base colour in closed form for each channel."""
        w, d = self.weight[:, known], self.texels.reflected[:, known]
        s, q = self.specular[:, :, :, known], self.diffuse[:, :, :, known]
        channel = self.texels.channel[known]
        total = np.zeros(s.shape[:3])
        for c in np.unique(channel):
            at = channel == c
            off, a, v = d[:, at] - s[..., at], q[..., at], w[:, at]
            base = np.clip((v * a * off).sum(-1) / np.maximum((v * a * a).sum(-1), LEAST), 0, 1)
            total += (v * (off - base[..., None] * a) ** 2).sum(-1)
        return total


def _nodes(texels: SampledTexels) -> tuple[F64, F64]:
    """(levels, roughnesses, T, V) each: what a white diffuse reflects, and what the lobe does."""
    shape = (len(LEVELS), len(ROUGHNESS), *texels.reflected.shape)
    diffuse, specular = np.empty(shape), np.empty(shape)
    cos_v = np.clip(texels.cos_v, 1e-3, 1.0)
    ratios = [fresnel_ratio(texels.lobes, cos_v, np.asarray(level)) for level in LEVELS]
    for j, roughness in enumerate(ROUGHNESS):
        lobe = lobe_values(texels.lobes, cos_v, np.full(len(texels.reflected), roughness))
        for i, level in enumerate(LEVELS):
            energy = brdf.principled_energy_level(roughness, COSINES, level)
            gain, taken = (np.interp(texels.cos_v, COSINES, energy[:, k]) for k in (0, 1))
            diffuse[i, j] = (1 - taken) / np.pi
            specular[i, j] = (lobe * ratios[i]).sum(-1) * gain
    return diffuse, specular


def _lowest(nodes: F64, costs: F64) -> float:
    """Where the parabola through the lowest of (N,) costs and its neighbours has its bottom."""
    at = int(np.clip(costs.argmin(), 1, len(nodes) - 2))
    if at != costs.argmin():
        return float(nodes[costs.argmin()])
    x, y = nodes[at - 1:at + 2], costs[at - 1:at + 2]
    bend, slope, _ = np.polyfit(x - x[1], y, 2)
    return float(x[1] + np.clip(-0.5 * slope / bend, x[0] - x[1], x[2] - x[1])) if bend > 0 else float(x[1])
