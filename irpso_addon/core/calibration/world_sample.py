"""Some texels with all that the views observe of them, as they are under worlds that are turned or brighter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..data import F64, I32, Bool
from ..evaluation.lobe_values import half_cosine
from ..evaluation.sampled_texels import SampledTexels
from ..job import Steps
from ..shading import brdf
from .rig_sample import RigSample

LEAST_QUALITY = 0.2  # of an observation: pixels that are worse mix too much of the texture
LEAST_VIEWS = 3  # good observations of a texel: base colour and roughness explain fewer under any light
LEAST_SHARE = 0.02  # of the given irradiance: darker places lie in shadows of which nothing is known
DARK = 1e-9


@dataclass(frozen=True)
class Around:
    """What the environment of each layer does at T texels, shadows included."""

    irradiance: F64  # (T, V, C) W/m^2
    nodes: F64  # (T, V, 2, NODES) relative to it, as of SampledTexels

    def toward(self, other: Around, share: F64) -> Around:
        """On the way to another light, or past it; share: (V,) of the way."""
        step = share[None, :, None]
        logs = np.log(np.maximum(self.irradiance, DARK)), np.log(np.maximum(other.irradiance, DARK))
        return Around(np.exp(logs[0] + step * (logs[1] - logs[0])),
                      self.nodes + step[..., None] * (other.nodes - self.nodes))

    def part(self, some: Bool) -> Around:
        """Some of the texels."""
        return Around(self.irradiance[some], self.nodes[some])


@dataclass(frozen=True)
class Changed:
    """A sample under a changed light."""

    texels: SampledTexels
    brighter: F64  # (T, V, C) its irradiance over that by the given light


LightAt = Callable[[F64], Steps[Around]]  # under (K,) turns beside those given, radians


@dataclass(frozen=True)
class WorldSample:
    """T texels and V layers, which K environments light: worlds, each under one turn."""

    rig: RigSample
    keys: tuple[tuple[str, float], ...]  # (K,) of the environments
    key: I32  # (V,) which environment; -1: none
    lamps: bool  # whether some layer has lamps: then worlds have a strength
    given: Around

    @property
    def names(self) -> tuple[str, ...]:
        """(K,) of the worlds."""
        return tuple(name for name, _ in self.keys)

    @property
    def worlds(self) -> tuple[str, ...]:
        """Their names, each once."""
        return tuple(dict.fromkeys(self.names))

    @cached_property
    def share(self) -> F64:
        """(T, V) of the environment in the irradiance: what no lobe of a lamp claims."""
        texels = self.rig.texels
        cos_v = np.clip(texels.cos_v, 1e-3, 1.0)[..., None]
        fresnel = brdf.F_dielectric(half_cosine(texels.lobes, cos_v[..., 0]))
        lamps = (texels.lobes[..., 3] * 2 * np.clip(texels.lobes[..., 2], 1e-3, 1.0) * cos_v / fresnel).sum(-1)
        return np.where(self.key >= 0, np.clip(1 - lamps, 0.0, 1.0), 0.0)

    def clean(self) -> WorldSample:
        """Without pixels that mix too much of the texture, and without what lies in deep shadow."""
        texels = self.rig.texels
        light = self.given.irradiance.min(-1)
        seen = (texels.quality > 0) & (self.key >= 0)
        typical = float(np.median(light[seen])) if seen.any() else 0.0
        fine = (texels.quality > LEAST_QUALITY) & ((self.key < 0) | (light > LEAST_SHARE * typical))
        fine &= (fine & texels.usable()).sum(1, keepdims=True) >= LEAST_VIEWS
        alone = len(set(zip(texels.camera.tolist(), texels.channel.tolist(), strict=True))) == len(texels.camera)
        return replace(self, rig=replace(self.rig, texels=replace(
            texels, quality=np.where(fine, texels.quality, 0.0),
            camera=np.zeros_like(texels.camera) if alone else texels.camera)))  # of one view each they differ by noise

    def part(self, some: Bool) -> WorldSample:
        """Some of the texels."""
        return replace(self, rig=self.rig.part(some), given=self.given.part(some))

    def under(self, now: Around, log_strength: F64) -> Changed:
        """The observations as a changed light has them; log_strength: of each of the worlds."""
        texels, lit = self.rig.texels, self.key >= 0
        strength = np.exp(self.of_layer(log_strength))[None, :, None]
        share = self.share[..., None]
        more = strength * np.maximum(now.irradiance, DARK) / np.maximum(self.given.irradiance, DARK)
        brighter = np.where(lit[None, :, None], 1 - share + share * more, 1.0)
        part = np.log(more.mean(-1) / brighter.mean(-1))
        assert texels.nodes is not None
        nodes, step = texels.nodes.copy(), now.nodes - self.given.nodes
        nodes[:, lit, 0] += (step[:, :, 0] + part[..., None])[:, lit]
        nodes[:, lit, 1] = np.clip((nodes[:, :, 1] + step[:, :, 1])[:, lit], 0.0, 1.0)
        lobes = texels.lobes.copy()
        lobes[..., 3] /= brighter.mean(-1)[..., None]
        return Changed(replace(texels, reflected=texels.reflected / brighter, nodes=nodes, lobes=lobes), brighter)

    def of_layer(self, log_strength: F64) -> F64:
        """(V,) of the worlds' numbers."""
        world = np.array([self.worlds.index(name) for name in self.names])
        return np.where(self.key >= 0, log_strength[world[np.maximum(self.key, 0)]], 0.0)
