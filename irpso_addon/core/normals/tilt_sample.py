"""Some texels with all that the views observe of them, as they are under tilted normals.

A texel's *tilt* (x, y) makes of its normal N the unit vector along N + x A + y B, A and B orthonormal to N.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..calibration.rig_sample import RigSample
from ..data import F64, Bool
from ..evaluation.lobe_values import half_cosine
from ..evaluation.sampled_texels import SampledTexels
from ..shading import brdf, environment
from ..shading.lights import light_basis
from ..vectors import dot, length

LEAST_COSINE = 1e-3
GRAZING = 0.1  # cosine to the camera: tilts turn no normal farther away
DIMMEST = 0.05  # of the light under the given normals: what gets less says nothing
LEAST = 1e-12
LEAST_LOG, MOST_LOG = -3.0, 1.5  # of an environment's light over that under the given normals: slopes lead no farther


@dataclass(frozen=True)
class TiltedWorlds:
    """How what the environment of each layer does changes with a tilt: slopes of logarithms, a radian.

    0 where a layer has no environment.
    """

    irradiance: F64  # (T, V, 2)
    lobe: F64  # (T, V, NODES, 2) the radiance that the specular lobe returns at nodes of roughness

    def part(self, some: Bool) -> TiltedWorlds:
        """Some of the texels."""
        return TiltedWorlds(self.irradiance[some], self.lobe[some])

    def brighter(self, tilt: F64) -> F64:
        """(T, V) irradiance under (T, 2) tilts, over the given one."""
        return np.asarray(np.exp(np.clip(dot(self.irradiance, tilt[:, None]), LEAST_LOG, MOST_LOG)))

    def log_lobe(self, nodes: F64, tilt: F64) -> F64:
        """(T, V, NODES) logarithms of ``nodes``, (T, V, 2, NODES), under tilts, over the given irradiance."""
        step = np.clip(dot(self.lobe, tilt[:, None, None]), LEAST_LOG, MOST_LOG)
        return np.asarray(np.maximum(nodes[..., 0, :] + step, np.log(environment.LEAST)))


@dataclass(frozen=True)
class TiltSample:
    """T texels, V layers, L lights a layer."""

    rig: RigSample
    to_light: F64  # (T, V, L, 3) unit, of the lamp's middle; 0 where a layer has fewer lights
    to_camera: F64  # (T, V, 3) unit
    first: F64  # (T, 3) unit: A
    second: F64  # (T, 3) unit: B
    share: F64  # (T, V, L) of the layer's irradiance; what is missing to 1 has no direction, but for an environment's
    around: F64  # (T, V) of an environment
    worlds: TiltedWorlds | None = None  # None: no layer has one

    @classmethod
    def of(cls, rig: RigSample, worlds: TiltedWorlds | None = None) -> TiltSample:
        """Of observations under the given normals."""
        texels, position = rig.texels, rig.position
        to_light = np.zeros((*texels.lobes.shape[:3], 3))
        to_camera = np.empty((*texels.cos_v.shape, 3))
        for v, place in enumerate(rig.view):
            view = rig.rig.views[place]
            camera = view.camera
            to_camera[:, v] = -camera.forward if camera.orthographic else camera.position - position
            for n, light in enumerate(view.lights[:to_light.shape[2]]):
                to_light[:, v, n] = light.matrix[:3, 2] if light.kind == "SUN" else light.matrix[:3, 3] - position
        first, second = light_basis(rig.normal)
        share = _shares(texels)
        has_world = np.array([rig.rig.views[place].environment is not None for place in rig.view])
        around = np.where(has_world, np.clip(1 - share.sum(-1), 0.0, 1.0), 0.0)
        return cls(rig, _unit(to_light), _unit(to_camera), first, second, share, around, worlds)

    @property
    def texels(self) -> SampledTexels:
        """What is observed, over the irradiance that the given normals have."""
        return self.rig.texels

    def offset(self, tilt: F64) -> F64:
        """(T, 3) to be added to the given normals, for (T, 2) tilts."""
        return np.asarray(tilt[:, :1] * self.first + tilt[:, 1:] * self.second)

    def in_plane(self, offset: F64) -> F64:
        """(T, 2) tilts of (T, 3)."""
        return np.stack([(offset * self.first).sum(-1), (offset * self.second).sum(-1)], -1)

    def cosines(self, tilt: F64) -> tuple[F64, F64, F64]:
        """N.L (T, V, L), the squared sine of the half vector's angle (T, V, L), N.V (T, V), as lobes have them.

        They are observed at a pixel, whose normal differs a little from the texel's: what the tilt changes is added.
        """
        lobes, cos_v = self.texels.lobes, self.texels.cos_v
        normal = _unit(self.rig.normal + self.offset(tilt))
        by = normal - self.rig.normal
        half, before = self._half
        lamp = self._lamp
        sin2h = np.where(lamp, np.clip(before - _along(half, normal) ** 2, 0.0, 1.0), lobes[..., 0])
        cos_l = lobes[..., 2] + _along(self.to_light, by)
        turned = np.clip(cos_v + _along(self.to_camera, by), GRAZING, 1.0)
        return cos_l, sin2h, np.where(cos_v < GRAZING, np.maximum(cos_v, LEAST_COSINE), turned)

    @cached_property
    def _half(self) -> tuple[F64, F64]:
        """Half vectors (T, V, L, 3), and (T, V, L) from which (N.H)^2 is subtracted for the observed squared sine."""
        half = _unit(self.to_light + self.to_camera[:, :, None])
        return half, self.texels.lobes[..., 0] + _along(half, self.rig.normal) ** 2

    @cached_property
    def _lamp(self) -> Bool:
        return np.asarray(self.to_light.any(-1))

    def brighter(self, tilt: F64, cos_l: F64) -> F64:
        """(T, V) irradiance under tilts, at their cosines (T, V, L), over the given one."""
        ratio = np.maximum(cos_l, 0.0) / np.maximum(self.texels.lobes[..., 2], LEAST_COSINE)
        lamps = 1 + dot(self.share, ratio - 1)
        return lamps if self.worlds is None else lamps + self.around * (self.worlds.brighter(tilt) - 1)

    def tilted(self, tilt: F64) -> tuple[SampledTexels, F64]:
        """The texels as they are observed under tilted normals, and (T, V) their light over the given one."""
        texels = self.texels
        cos_l, sin2h, cos_v = self.cosines(tilt)
        brighter = self.brighter(tilt, cos_l)
        more = np.maximum(brighter, DIMMEST)
        # F / (2 N.L N.V) times the share of the light, which goes as N.L:
        factor = np.where(cos_l > 0, texels.lobes[..., 3] * (texels.cos_v / cos_v / more)[..., None], 0.0)
        lobes = np.stack([sin2h, texels.lobes[..., 1], np.clip(cos_l, LEAST_COSINE, 1.0), factor], -1)
        quality = np.where(brighter > DIMMEST, texels.quality, 0.0)
        return replace(texels, reflected=texels.reflected / more[..., None], quality=quality, cos_v=cos_v,
                       lobes=lobes, nodes=self._nodes(tilt, more)), more

    def _nodes(self, tilt: F64, more: F64) -> F64 | None:
        """As `SampledTexels` has them, under tilts that make irradiance (T, V) ``more``."""
        given = self.texels.nodes
        if given is None or self.worlds is None:
            return given
        around = self.worlds.log_lobe(given, tilt) - np.log(more)[..., None]
        return np.stack([np.asarray(around), given[..., 1, :]], -2)

    def part(self, some: Bool) -> TiltSample:
        """Some of the texels."""
        return TiltSample(
            self.rig.part(some), self.to_light[some], self.to_camera[some], self.first[some], self.second[some],
            self.share[some], self.around[some], None if self.worlds is None else self.worlds.part(some))


def _shares(texels: SampledTexels) -> F64:
    """(T, V, L) from the lobes' factors."""
    lobes = texels.lobes
    cos_v, cos_l = np.clip(texels.cos_v, LEAST_COSINE, 1.0), np.clip(lobes[..., 2], LEAST_COSINE, 1.0)
    fresnel = brdf.F_dielectric(half_cosine(lobes, cos_v))
    share = np.where(lobes[..., 3] > 0, lobes[..., 3] * 2 * cos_l * cos_v[..., None] / np.maximum(fresnel, LEAST), 0.0)
    if lobes.shape[2] == 1:
        return np.asarray(np.where(np.abs(share - 1) < 0.1, 1.0, share))  # means over a pixel; else light bounces, too
    return np.asarray(share / np.maximum(share.sum(-1, keepdims=True), 1.0))


def _unit(vectors: F64) -> F64:
    return np.asarray(vectors / np.maximum(length(vectors), LEAST)[..., None])


def _along(vectors: F64, normal: F64) -> F64:
    """(T, ...) scalar products of (T, ..., 3) with each texel's vector, (T, 3)."""
    return np.asarray((vectors.reshape(len(normal), -1, 3) @ normal[:, :, None]).reshape(vectors.shape[:-1]))
