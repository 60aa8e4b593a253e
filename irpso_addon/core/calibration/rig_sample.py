"""Some texels with all that the views observe of them, as they are under another rig."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..checks.light_checks import four_sided, light_slopes
from ..data import F64, I32, Bool, Camera, Light
from ..evaluation.folds import WHITE
from ..evaluation.sampled_texels import SampledTexels
from ..images.response import curved, straight
from ..shading import brdf
from ..shading.lights import light_irradiance
from ..vectors import dot, length
from ..vignetting import log_cosine
from .rig import Rig, RigChange

DARK = 0.005  # of white: what light that bounces between metals and noise make of their pictures
LEAST_COSINE = 1e-3
LEAST_LIGHT = 1e-20
NEAR = 0.01  # of a lamp's distance, or radians: from place to place at which slopes of irradiance are taken
COLOURS = 3
ROUGH, TYPICAL_BASE = 0.5, 0.4  # Diffuse Roughness and base colour of a rough diffuse; others are powers of it
SHEEN = 0.5  # roughness with which light from all around is reflected: its albedo hardly depends on it


@dataclass(frozen=True)
class RigSample:
    """T texels and V layers."""

    texels: SampledTexels
    rig: Rig
    view: I32  # (V,) place of each layer's view in the rig's
    position: F64  # (T, 3) world, metres
    normal: F64  # (T, 3) world, unit
    slot: I32  # (T,) material slot
    cluster: I32  # (T,) neighbours, which err alike, share a number
    scale_known: bool = True  # the lamps' powers are those of the pictures: the Specular IOR Level is likely to be 0.5
    light: float = 1.0  # W/m^2: the unit of irradiance from all around
    openness: F64 | None = None  # (T,) share of light from all around that nothing hides; None: all of it
    shade: F64 | None = None  # (T, V, C) radiance of the pictures where texels face away from all lamps; else NaN
    metals: bool = False  # whether texels may be metal, each as far as it shows

    def part(self, some: Bool) -> RigSample:
        """Some of the texels."""
        other = replace(self, texels=self.texels.part(some), position=self.position[some], normal=self.normal[some],
                        slot=self.slot[some], cluster=self.cluster[some],
                        openness=None if self.openness is None else self.openness[some],
                        shade=None if self.shade is None else self.shade[some])
        vars(other)["geometry"] = self.geometry.part(other, some)
        return other

    def channel(self, channel: int) -> RigSample:
        """What the pictures show in one of COLOURS channels."""
        texels, one = self.texels, slice(channel, channel + 1)
        return self.showing(
            replace(texels, reflected=texels.reflected[..., one], irradiance=texels.irradiance[..., one]),
            None if self.shade is None else self.shade[..., one])

    def showing(self, texels: SampledTexels, shade: F64 | None) -> RigSample:
        """The same places under the same lamps and cameras, of which pictures show something else."""
        other = replace(self, texels=texels, shade=shade)
        vars(other)["geometry"] = self.geometry.of(other)
        return other

    @cached_property
    def clarity(self) -> F64:
        """(T, V) how much an observation counts; dark ones of metals, where light that bounces shows, count little."""
        if not self.metals:
            return np.ones(self.texels.cos_v.shape)
        radiance, usable = (self.texels.reflected * self.texels.irradiance).mean(-1), self.texels.usable()
        dark = DARK * float(np.percentile(radiance[usable], WHITE)) if usable.any() else 1.0
        return 1 / (1 + (dark / np.maximum(radiance, LEAST_LIGHT)) ** 2)

    @cached_property
    def geometry(self) -> RigGeometry:
        """What follows from the given rig."""
        return RigGeometry(self)


@dataclass(frozen=True)
class Seen:
    """A sample under a changed rig."""

    texels: SampledTexels  # its observations, as the changed rig has them
    brighter: F64  # (T, V) light by the changed rig's lamps over that by the given one's, exposure included
    slopes: dict[str, F64]  # of each lamp, (T, 3): of the logarithm of irradiance, in its group's axes and reach
    fine: dict[str, Bool]  # of each lamp, (T,): where the slopes are known
    share: dict[tuple[int, str], F64]  # of the layer's irradiance, (T,): by layer and lamp
    shown: F64  # (T, V) of radiance in the pictures, over what the given rig takes it to be
    bent: Bent | None = None  # light from all around, and the response of the files; None: there is neither

    @cached_property
    def diffuse(self) -> F64:
        """(3, T, V) slopes of the logarithm of radiance by the shape of the diffuse."""
        return diffuse_shapes(self.texels.lobes, self.texels.cos_v)

    def as_given(self, reflected: F64) -> F64:
        """(T, V, C) what the given rig makes of pictures in which texels reflect so under the changed one."""
        if self.bent is not None:
            reflected = self.bent.undone(reflected)
        return reflected * self.brighter[..., None]


@dataclass(frozen=True)
class Bent:
    """Where pictures are not in proportion to the lamps' light.  (T, V, C) arrays, reflected: of the changed rig."""

    around: F64  # irradiance from all around over that by the changed rig's lamps
    sheen: F64  # what highlights of it add, over the irradiance by the lamps
    value: F64  # of the files where a texel reflects 1 of the lamps' light
    power: float  # to which files hold radiance, in the dark ...
    shoulder: float  # ... and how many times flatter their curve is at white

    def done(self, reflected: F64) -> F64:
        """Of what is reflected as if the pictures were in proportion."""
        of_lamps = straight(reflected * self.value, self.power, self.shoulder) / self.value - self.sheen
        return np.asarray(of_lamps / (1 + self.around))

    def undone(self, reflected: F64) -> F64:
        """The reverse of `done`."""
        of_all = (reflected * (1 + self.around) + self.sheen) * self.value
        return np.asarray(curved(of_all, self.power, self.shoulder) / self.value)

    def lit(self) -> F64:
        """(T, V) share of the lamps in a layer's irradiance."""
        return np.asarray((1 / (1 + self.around)).mean(-1))


class RigGeometry:
    """What of a sample follows from the given rig."""

    def __init__(self, sample: RigSample) -> None:
        self.sample = sample
        self.lit = _lit(sample)
        self.slopes: dict[str, tuple[list[float], F64, Bool]] = {}  # by lamp: number of the place, as of `_slopes`
        self.given = self._light(RigChange.none(len(sample.rig.groups), len(sample.rig.views)))
        of_view = [log_cosine(view.camera, sample.position - view.camera.position) for view in sample.rig.views]
        self.to_camera = [to_camera(view.camera, sample.position) for view in sample.rig.views]
        self.given_angles: dict[tuple[int, str], tuple[F64, F64]] = {}  # by view and lamp
        self.cosine = np.stack([of_view[place] for place in sample.view], -1)  # (T, V) log of it to the camera's axis
        shown = np.array([(view.gain * 2.0**view.exposure, view.vignetting) for view in sample.rig.views])[sample.view]
        lit = np.array([float(view.ambient is None) for view in sample.rig.views])[sample.view]
        reached = np.ones(len(sample.slot)) if sample.openness is None else sample.openness
        self.open = reached[:, None] * lit  # (T, V) share of the light from all around
        self.file = shown[:, 0] * np.exp(shown[:, 1] * self.cosine)  # (T, V) value of files for each unit of radiance
        # How fits of the sample begin, by whether levels are free and by the change: see rig_fit.py
        self.begun: dict[tuple[bool, bytes], Any] = {}  # from what is given
        self.again: dict[tuple[bool, bytes], Any] = {}  # from the last other change
        self.gains: F64 | None = None  # (V,) of what views show over what others do: see far_exposures.py

    def of(self, sample: RigSample) -> RigGeometry:
        """Of other texels' observations at the same places."""
        other = copy(self)
        other.sample, other.begun, other.again, other.gains = sample, {}, {}, None
        other.slopes = dict(self.slopes)
        return other

    def part(self, sample: RigSample, some: Bool) -> RigGeometry:
        """Of some of the texels."""
        other = copy(self)
        other.sample, other.begun, other.again, other.gains, other.given_angles = sample, {}, {}, None, {}
        other.lit = {name: lit[some] for name, lit in self.lit.items()}
        other.slopes = {name: (place, slopes[some], fine[some]) for name, (place, slopes, fine) in self.slopes.items()}
        other.given = {name: (light[some], slopes[some], fine[some])
                       for name, (light, slopes, fine) in self.given.items()}
        other.to_camera = [way[some] for way in self.to_camera]
        other.cosine, other.open, other.file = self.cosine[some], self.open[some], self.file[some]
        return other

    def under(self, change: RigChange) -> Seen:
        """The sample under a changed rig."""
        sample, rig = self.sample, self.sample.rig
        lights = rig.lights(change)
        now = self._light(change) if change.moves else self.given
        texels = sample.texels
        lamps, shown = np.ones(texels.cos_v.shape), np.ones(texels.cos_v.shape)
        lobes, share = texels.lobes.copy(), {}
        toward = {name: self._toward(light) for name, light in lights.items()} if change.moves else {}
        for v, place in enumerate(sample.view):
            view = rig.views[place]
            powers = [float(np.mean(lights[light.name].power)) for light in view.lights]
            before = [float(np.mean(light.power)) * self.given[light.name][0] for light in view.lights]
            after = [power * now[light.name][0] for power, light in zip(powers, view.lights, strict=True)]
            total, old = sum(after, np.zeros(1)), sum(before, np.zeros(1))
            fine = (total > 0) & (old > 0)
            lamps[:, v] = np.where(fine, total / np.where(fine, old, 1.0), 1.0)
            shown[:, v] = np.exp(change.log_gain[place] + change.vignetting * self.cosine[:, v])
            for n, light in enumerate(view.lights):
                share[v, light.name] = after[n] / np.where(total > 0, total, 1.0)
                ratio = share[v, light.name] * old / np.maximum(before[n], 1e-30)
                if change.moves:
                    lobes[:, v, n] = _turned(lobes[:, v, n], self._angles(toward[light.name], int(place)),
                                             self._given_angles(light, int(place)))
                lobes[:, v, n, 3] *= np.where(before[n] > 0, ratio, 1.0)
        exposed = shown.copy()
        if change.cosine or change.transmission or change.rough:
            shape = np.tensordot([change.cosine, change.transmission, change.rough],
                                 diffuse_shapes(lobes, texels.cos_v), 1)
            shown *= np.exp(shape)
            lobes[..., 3] *= np.exp(-shape)[..., None]
        brighter, bent = lamps * shown, self._bent(change, lamps, shown) if change.bends else None
        reflected = texels.reflected / brighter[..., None]
        if bent is not None:
            reflected, lit = bent.done(reflected), bent.lit()
            lobes[..., 3] *= lit[..., None]
            share = {(v, name): part * lit[:, v] for (v, name), part in share.items()}
        return Seen(replace(texels, reflected=reflected, lobes=lobes), brighter,
                    {name: slopes for name, (_, slopes, _) in now.items()},
                    {name: fine for name, (*_, fine) in now.items()}, share, exposed, bent)

    def turned(self, change: RigChange, lobes: F64, axis: int, by: float) -> F64:
        """(T, V, L, 4) ``lobes`` of a changed rig, once its lamps move along an axis of their groups too."""
        sample, rig = self.sample, self.sample.rig
        before = rig.lights(change)
        after = rig.lights(replace(change, offset=change.offset + by * np.eye(3)[axis]))
        now, then = ({name: self._toward(light) for name, light in lights.items()} for lights in (after, before))
        lobes = lobes.copy()
        for v, place in enumerate(sample.view):
            for n, light in enumerate(rig.views[place].lights):
                lobes[:, v, n] = _turned(lobes[:, v, n], self._angles(now[light.name], int(place)),
                                         self._angles(then[light.name], int(place)))
        return lobes

    def _bent(self, change: RigChange, lamps: F64, shown: F64) -> Bent:
        """``lamps``, ``shown``: (T, V) factors of the lamps' irradiance and of what a picture shows of radiance."""
        texels = self.sample.texels
        irradiance = np.maximum(texels.irradiance * lamps[..., None], LEAST_LIGHT)
        ambient = max(change.ambient, 0.0) * self.sample.light * self.open[..., None]
        sheen = brdf.principled_energy(SHEEN, np.clip(texels.cos_v, LEAST_COSINE, 1.0))[..., 1] / np.pi
        return Bent(ambient / irradiance, ambient * sheen[..., None] / irradiance,
                    irradiance * (shown * self.file)[..., None], float(np.exp(change.log_response)),
                    float(np.exp(change.log_shoulder)))

    def _toward(self, light: Light) -> tuple[F64, F64]:
        """Unit vectors (T, 3) to a lamp's middle, and N.L (T,), which all its layers share."""
        L = to_middle(light, self.sample.position)
        return L, dot(self.sample.normal, L)

    def _angles(self, toward: tuple[F64, F64], place: int) -> tuple[F64, F64]:
        """(T,) each: N.L, and the squared sine of the half vector's angle; of a lamp, as of `_toward`, in a view."""
        L, cos_l = toward
        H = L + self.to_camera[place]
        cos_h = dot(self.sample.normal, H) / np.maximum(length(H), 1e-12)
        return cos_l, 1 - np.clip(cos_h, -1, 1) ** 2

    def _given_angles(self, light: Light, place: int) -> tuple[F64, F64]:
        """The same of a lamp as it is given."""
        of = place, light.name
        if of not in self.given_angles:
            self.given_angles[of] = self._angles(self._toward(light), place)
        return self.given_angles[of]

    def _light(self, change: RigChange) -> dict[str, tuple[F64, F64, Bool]]:
        """Of each lamp: irradiance over power (T,), slopes (T, 3), and where those are known (T,).

        Where no view shows a texel under the lamp, irradiance is 1, and nothing is known of slopes.
        """
        sample, lights, result = self.sample, self.sample.rig.lights(change), {}
        near = np.round(change.offset / NEAR)
        slopes = self._slopes(replace(change, offset=NEAR * near), near)
        for group in sample.rig.groups:
            for name in group.lights:
                seen, irradiance = self.lit[name], np.ones(len(sample.slot))
                # What counts are ratios to the lamp as it is given.
                irradiance[seen] = light_irradiance(
                    four_sided(lights[name]), sample.position[seen], sample.normal[seen])
                result[name] = irradiance, *slopes[name]
        return result

    def _slopes(self, change: RigChange, near: F64) -> dict[str, tuple[F64, Bool]]:
        """Slopes of `_light` by lamp, and where they are known; ``near``: (G, 3) number of each group's place.

        They take most of the time, and change little between places that are near each other.
        """
        sample, middle = self.sample, self.sample.position.mean(0)
        lights: dict[str, Light] = {}
        for group, place in zip(sample.rig.groups, near.tolist(), strict=True):
            for name, axes in zip(group.lights, group.axes, strict=True):
                if name in self.slopes and self.slopes[name][0] == place:
                    continue
                lights = lights or sample.rig.lights(change)
                light, seen = four_sided(lights[name]), self.lit[name]
                own = 1.0 if light.kind == "SUN" else float(np.linalg.norm(light.matrix[:3, 3] - middle))
                of, known = light_slopes(light, sample.position[seen], sample.normal[seen], own)
                slopes, fine = np.zeros((len(seen), 3)), np.zeros(len(seen), bool)
                fine[seen] = known
                slopes[seen] = np.where(known[:, None], of @ axes * (group.reach / own), 0.0)
                self.slopes[name] = place, slopes, fine
        return {name: (slopes, fine) for name, (_, slopes, fine) in self.slopes.items()}


def diffuse_shapes(lobes: F64, cos_v: F64) -> F64:
    """(3, T, V) logarithms by which a diffuse differs from Lambert's.

    Of the cosine to the lamps, of a dielectric's transmission to them and to the camera, and of what a rough surface
    shows over what a smooth one does.  ``lobes``, ``cos_v``: as `SampledTexels` has them.
    """
    light = np.maximum(lobes[..., 3], 1e-12)
    cos_l, sin2h = (np.clip((lobes[..., k] * light).sum(-1) / light.sum(-1), low, 1.0) for k, low in (
        (2, LEAST_COSINE), (0, 0.0)))
    cos_v = np.clip(cos_v, LEAST_COSINE, 1.0)
    # To the camera from the lamp: N.H = (N.L + N.V) / |L + V|.
    between = np.minimum((cos_l + cos_v) ** 2 / (2 * np.maximum(1 - sin2h, LEAST_COSINE)) - 1, 1)
    rough = brdf.diffuse_rough(np.array([TYPICAL_BASE]), cos_l, cos_v, between, ROUGH)[..., 0] * np.pi / TYPICAL_BASE
    return np.log(np.stack([cos_l, (1 - brdf.F_dielectric(cos_l)) * (1 - brdf.F_dielectric(cos_v)), rough]))


def typical_light(texels: SampledTexels) -> float:
    """Median irradiance by lamps, W/m^2."""
    some = texels.usable()
    return float(np.median(texels.irradiance.mean(-1)[some])) if some.any() else 1.0


def to_middle(light: Light, position: F64) -> F64:
    """(T, 3) unit vectors to a lamp's middle."""
    way = (np.broadcast_to(light.matrix[:3, 2], position.shape) if light.kind == "SUN"
           else light.matrix[:3, 3] - position)
    return np.asarray(way / np.maximum(length(way)[..., None], 1e-12))


def _lit(sample: RigSample) -> dict[str, Bool]:
    """Of each lamp, the texels that some view shows under it, (T,)."""
    texels = sample.texels
    shown = texels.quality > 0 if texels.clipped is None else (texels.quality > 0) | (texels.clipped > 0)
    result = {name: np.zeros(len(shown), bool) for group in sample.rig.groups for name in group.lights}
    for v, place in enumerate(sample.view):
        for light in sample.rig.views[place].lights:
            result[light.name] |= shown[:, v]
    return result


def to_camera(camera: Camera, position: F64) -> F64:
    """(T, 3) unit vectors."""
    way = np.broadcast_to(-camera.forward, position.shape) if camera.orthographic else camera.position - position
    return np.asarray(way / np.maximum(length(way)[..., None], 1e-12))


def _turned(lobe: F64, now: tuple[F64, F64], given: tuple[F64, F64]) -> F64:
    """(T, 4) a lobe as observed, its lamp moved by as much as the texel's own geometry says."""
    turned = np.empty_like(lobe)
    turned[:, 0] = np.clip(lobe[:, 0] + (now[1] - given[1]), 0.0, 1.0)
    turned[:, 1] = lobe[:, 1]
    turned[:, 2] = np.clip(lobe[:, 2] + (now[0] - given[0]), LEAST_COSINE, 1.0)
    turned[:, 3] = lobe[:, 3] * np.clip(lobe[:, 2], LEAST_COSINE, 1.0) / turned[:, 2]
    return turned
