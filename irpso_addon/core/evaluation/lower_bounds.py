"""Clipped pixels as lower bounds: the surface is at least as bright as white there.

What is predicted darker costs as much as any other error does, and what is predicted brighter costs nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..data import F64, I32, Bool
from ..vectors import summed
from .sampled_texels import SampledTexels

LEAST_KNOWN = 2  # good observations that say a texel's base colour: with fewer it may be any, and bounds say nothing


def bound_weight(texels: SampledTexels, known: Bool) -> F64 | None:
    """(T, V, C) of squared errors, as of `weight_of`, of clipped pixels in the ``known`` layers, (V,); None: none."""
    if texels.clipped is None:
        return None
    quality = np.zeros_like(texels.clipped)
    for channel in np.unique(texels.channel):  # each is known by its own layers alone
        own = known & (texels.channel == channel)
        enough = texels.usable()[:, own].sum(1) >= LEAST_KNOWN
        quality[:, own] = np.where(enough[:, None], texels.clipped[:, own], 0.0)
    if not quality.any():
        return None
    unit = np.maximum(texels.reflected, texels.typical())
    return np.asarray(quality[..., None] * texels.irradiance ** (2 / 3) / unit ** (4 / 3))


@dataclass(frozen=True)
class NodeBounds:
    """N clipped pixels of one channel's layers, and the model at all nodes of `JointSearch`."""

    texel: I32  # (N,) ascending
    weight: F64  # (N, C)
    least: F64  # (N, C)
    gain: F64  # (N, C) of a rough diffuse; (1, 1) of a smooth one
    shown: Mapping[str, F64]  # (levels or 1, roughnesses, N) each: a, s, A, S

    @classmethod
    def of(
        cls, texels: SampledTexels, weight: F64, layers: I32, products: Mapping[str, F64], gain: F64,
    ) -> NodeBounds | None:
        """``weight``: of `bound_weight`.  ``layers``, ``products``: of `Nodes`.  ``gain``: (T, V, C) or (1, 1, 1)."""
        own = weight.take(layers, 1)
        texel, place = np.nonzero(own.any(-1))
        if not len(texel):
            return None
        at = texel, layers[place]
        shown = {name: products[name][texel, :, place].T for name in "asAS" if name in products}
        return cls(texel.astype(np.int32), weight[at], texels.reflected[at],
                   gain[0] if len(gain) == 1 else gain[at], shown)

    def costs(self, base: F64, metallic: float) -> F64:
        """(levels, roughnesses, T), of base colours (levels, roughnesses, T, C)."""
        nodes = {name: value.reshape(-1, base.shape[1], len(self.texel), 1) for name, value in self.shown.items()}
        white, rest = nodes["a"] * self.gain, nodes["s"]
        if metallic > 0:
            white = (1 - metallic) * white + metallic * nodes["A"]
            rest = (1 - metallic) * rest + metallic * nodes["S"]
        dark = np.maximum(self.least - rest - base[:, :, self.texel] * white, 0)
        texels, first = np.unique(self.texel, return_index=True)
        result = np.zeros(base.shape[:3])
        result[:, :, texels] = np.add.reduceat(summed(self.weight * dark**2), first, axis=2)
        return result
