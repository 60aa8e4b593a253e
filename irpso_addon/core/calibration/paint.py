"""What the texels' own numbers can explain, taken out of other changes (variable projection).

The pixels of two cameras cover a texture differently.  So a texel's base colour is the sum of one that all cameras
share and a small one of each camera's own, if some camera has two views.  All of a texel's numbers are eliminated
together, under normal priors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..data import F64, I32, Bool
from ..evaluation.sampled_texels import OTHER_CAMERA, SampledTexels

OWN = 0.05  # relative standard deviation of base color from camera to camera
ROUGHNESS = 0.5  # standard deviation of the logarithm of roughness
METALLIC = 0.5  # standard deviation of it
TILT = 0.03  # radians, of the normals of a mesh that is wrong in detail
LEAST = 1e-12


@dataclass(frozen=True)
class Paint:
    """One channel's layers, by cameras."""

    layers: I32  # (n,) of all layers
    cameras: tuple[Bool, ...]  # (n,) each: which of them are a camera's

    @cached_property
    def by_camera(self) -> tuple[I32, F64]:
        """Each layer's camera, (n,); and by how much each layer counts in each camera's sums, (n, cameras)."""
        group = np.argmax(self.cameras, 0).astype(np.int32)
        return group, np.stack(self.cameras, -1).astype(np.float64) + OTHER_CAMERA


def paints_of(texels: SampledTexels) -> list[Paint]:
    """Of each channel that is kept apart.

    Where no camera has two views, as under a carried flash, base colours of their own would explain all that is seen:
    one serves all, and how cameras differ is noise.
    """
    result = []
    for channel in np.unique(texels.channel):
        layers = np.flatnonzero(texels.channel == channel).astype(np.int32)
        cameras = texels.camera[layers]
        each = np.unique(cameras)
        alone = len(each) == len(layers)
        result.append(Paint(layers, (np.ones(len(layers), bool),) if alone else tuple(
            cameras == camera for camera in each)))
    return result


def base_colours(paints: list[Paint], weight: F64, diffuse: F64, rest: F64) -> F64:
    """(T, V) least squares of weight (rest - base diffuse)^2: a camera's own, and where it has none, all cameras'."""
    return np.clip(quotients(paints, weight * diffuse * rest, weight * diffuse**2), 1e-3, 2.0)


def quotients(paints: list[Paint], above: F64, below: F64) -> F64:
    """(T, V) of (T, V): sums over a camera's layers, and a little of all cameras', over the same of ``below``."""
    result = np.zeros_like(above)
    for paint in paints:
        upper, lower = (values if len(paint.layers) == values.shape[1] else values[:, paint.layers]
                        for values in (above, below))
        if len(paint.cameras) == 1:
            result[:, paint.layers] = (upper.sum(1) / np.maximum(lower.sum(1), LEAST))[:, None]
            continue
        group, counts = paint.by_camera
        upper, lower = upper @ counts, lower @ counts
        result[:, paint.layers] = (upper / np.maximum(lower, LEAST))[:, group]
    return result


class OwnNumbers:
    """Of each texel, in one linearisation: what log radiance changes by.  (T, V) arrays are of texels and layers."""

    def __init__(
        self, paints: list[Paint], share: F64, bend: F64, tilts: tuple[F64, ...] = (), metals: F64 | None = None,
    ) -> None:
        """``share``, ``bend``: slopes of log radiance by the logarithms of base colour and roughness.

        ``tilts``: by radians of the normal, each way; none: it is right.
        """
        columns, spread = [bend], [ROUGHNESS]
        self.share = share
        self.alone: list[int] = []  # layers of cameras that have no other: there the camera's own base colour is noise
        for paint in paints:
            own = [paint.layers[camera] for camera in paint.cameras] if len(paint.cameras) > 1 else []
            for layers in (paint.layers, *(layers for layers in own if len(layers) > 1)):
                column = np.zeros_like(share)
                column[:, layers] = share[:, layers]
                columns.append(column)
                spread.append(OWN if layers is not paint.layers else np.inf)
            self.alone += [int(layers[0]) for layers in own if len(layers) == 1]
        columns += tilts
        spread += [TILT] * len(tilts)
        if metals is not None:
            columns.append(metals)
            spread.append(METALLIC)
        self.columns = np.stack(columns, -1)  # (T, V, m)
        self.spread = np.array(spread)  # (m,) standard deviations


class Elimination:
    """Of each texel's own numbers, under some weights.  (T, V) arrays are of texels and layers."""

    def __init__(self, own: OwnNumbers, weight: F64, scatter: float) -> None:
        self.weight, self.columns, alone = weight.copy(), own.columns, own.alone
        self.weight[:, alone] /= 1 + weight[:, alone] * (own.share[:, alone] * OWN / scatter) ** 2
        self.weighted = self.columns * self.weight[..., None]
        normal = self.weighted.transpose(0, 2, 1) @ self.columns
        m = len(own.spread)
        normal[:, range(m), range(m)] += np.maximum((scatter / own.spread) ** 2, LEAST)
        self.root = np.linalg.inv(np.linalg.cholesky(normal)).transpose(0, 2, 1)  # its square is the inverse

    def remains(self, values: F64) -> F64:
        """(T, V) without what the texels' own numbers explain."""
        own = self.root @ (self.root.transpose(0, 2, 1) @ (self.weighted.transpose(0, 2, 1) @ values[..., None]))
        return np.asarray(values - (self.columns @ own)[..., 0])

    def taken(self, across: F64) -> F64:
        """(K, K) to be subtracted from a normal matrix; across: (m, K, T) sums of ``weighted`` times slopes."""
        m, count, texels = across.shape
        part = np.ascontiguousarray(across.transpose(2, 1, 0)) @ self.root  # (T, K, m)
        part = part.transpose(1, 0, 2).reshape(count, texels * m)
        return np.asarray(part @ part.T)
