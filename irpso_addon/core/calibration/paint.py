"""What the texels' own numbers can explain, taken out of other changes (variable projection).

The pixels of two cameras cover a texture differently.  So a texel's base colour is the sum of one that all cameras
share and a small one of each camera's own.  All of a texel's numbers are eliminated together, under normal priors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data import F64, I32, Bool
from ..evaluation.sampled_texels import OTHER_CAMERA, SampledTexels

OWN = 0.05  # relative standard deviation of base color from camera to camera
ROUGHNESS = 0.5  # standard deviation of the logarithm of roughness
TILT = 0.03  # radians, of the normals of a mesh that is wrong in detail
LEAST = 1e-12


@dataclass(frozen=True)
class Paint:
    """One channel's layers, by cameras."""

    layers: I32  # (n,) of all layers
    cameras: tuple[Bool, ...]  # (n,) each: which of them are a camera's


def paints_of(texels: SampledTexels) -> list[Paint]:
    """Of each channel that is kept apart."""
    result = []
    for channel in np.unique(texels.channel):
        layers = np.flatnonzero(texels.channel == channel).astype(np.int32)
        cameras = texels.camera[layers]
        result.append(Paint(layers, tuple(cameras == camera for camera in np.unique(cameras))))
    return result


def base_colours(paints: list[Paint], weight: F64, diffuse: F64, rest: F64) -> F64:
    """(T, V) least squares of weight (rest - base diffuse)^2: a camera's own, and where it has none, all cameras'."""
    result = np.empty_like(diffuse)
    off, information = weight * diffuse * rest, weight * diffuse**2
    for paint in paints:
        all_off, all_known = (part[:, paint.layers].sum(1) for part in (off, information))
        for camera in paint.cameras:
            own = paint.layers[camera]
            known = information[:, own].sum(1) + OTHER_CAMERA * all_known
            result[:, own] = ((off[:, own].sum(1) + OTHER_CAMERA * all_off) / np.maximum(known, LEAST))[:, None]
    return np.clip(result, 1e-3, 2.0)


class Elimination:
    """Of each texel's own numbers, for one linearisation.  (T, V) arrays are of texels and layers."""

    def __init__(
        self, paints: list[Paint], weight: F64, share: F64, bend: F64, scatter: float, tilts: tuple[F64, ...] = (),
    ) -> None:
        """``share``, ``bend``: slopes of log radiance by the logarithms of base colour and roughness.

        ``tilts``: by radians of the normal, each way; none: it is right.
        """
        columns, priors = [bend], [(scatter / ROUGHNESS) ** 2]
        for paint in paints:
            own = [paint.layers[camera] for camera in paint.cameras] if len(paint.cameras) > 1 else []
            for layers in (paint.layers, *(layers for layers in own if len(layers) > 1)):
                column = np.zeros_like(share)
                column[:, layers] = share[:, layers]
                columns.append(column)
                priors.append((scatter / OWN) ** 2 if len(priors) > 1 and layers is not paint.layers else LEAST)
            alone = [layers[0] for layers in own if len(layers) == 1]  # there the camera's own is noise
            weight = weight.copy()
            weight[:, alone] /= 1 + weight[:, alone] * (share[:, alone] * OWN / scatter) ** 2
        columns += tilts
        priors += [(scatter / TILT) ** 2] * len(tilts)
        self.weight = weight
        self.columns = np.stack(columns, -1)  # (T, V, m)
        self.weighted = self.columns * weight[..., None]
        normal = self.weighted.transpose(0, 2, 1) @ self.columns
        m = len(priors)
        normal[:, range(m), range(m)] += np.array(priors)
        self.inverse = np.linalg.inv(normal)

    def remains(self, values: F64) -> F64:
        """(T, V) without what the texels' own numbers explain."""
        own = self.inverse @ (self.weighted.transpose(0, 2, 1) @ values[..., None])
        return np.asarray(values - (self.columns @ own)[..., 0])

    def taken(self, across: F64) -> F64:
        """(K, K) to be subtracted from a normal matrix; across: (T, m, K) sums of ``weighted`` times slopes."""
        left = self.inverse @ across
        K = across.shape[-1]
        return np.asarray(across.reshape(-1, K).T @ left.reshape(-1, K))
