"""Texels of a sample with all that the views observe of them, and what a material predicts that they show.

A *layer* is a view and holds C = 3 channels.  Where lamps are coloured and channels are kept apart, a view counts as
three layers of C = 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..data import F64, I32, Bool, Coat
from ..shading import brdf
from ..vectors import mean, summed
from .lobe_values import LobePlaces, coat_values, diffuse_parts, fresnel_ratio, lobe_values, metal_values

MISSED_SHADOW = 0.3  # of a texel's typical reflection: darker is taken for a shadow that the shadow map missed
OTHER_CAMERA = 0.02  # weight of another camera's pixels, which show another part of the texture, beside the own one's
PASSES = 3  # in which multiple scattering that depends on base colour is found: a metal's, and of a rough diffuse
LEAST = 1e-12


@dataclass(frozen=True)
class SampledTexels:
    """V layers of C channels at T texels."""

    reflected: F64  # (T, V, C) radiance / irradiance, 1/sr
    quality: F64  # (T, V) 0 (not observed, or at an edge of shadow or silhouette) to 1
    cos_v: F64  # (T, V)
    lobes: F64  # (T, V, L, 4) per light: sin2h, radius2, cos_l, F / (2 cos_l cos_v) * share of the irradiance
    irradiance: F64  # (T, V, C) W/m^2 without shadows
    camera: I32  # (V,)
    channel: I32  # (V,) 0 to 2 where the channels are kept apart, else 0
    lamps: I32  # (V,) which set of lamps shone
    nodes: F64 | None = None  # (T, V, 2, NODES) of the environment, see lobe_values.py; None: there is none
    # (T, V) quality of clipped pixels, of which ``reflected`` says what they show at least; None: there are none.
    clipped: F64 | None = None

    def typical(self) -> F64:
        """(T, V, C) median of what a texel reflects in the same channel; 1 where it is not observed."""
        return self._typical

    @cached_property
    def _typical(self) -> F64:
        result = np.ones_like(self.reflected)
        for channel in np.unique(self.channel):
            same = self.channel == channel
            seen = np.where(self.quality[:, same, None] > 0, self.reflected[:, same], np.nan)
            some = (self.quality[:, same] > 0).any(1)
            result[np.ix_(some, same)] = np.maximum(median_of_known(seen[some]), 1e-4)[:, None]
        result.setflags(write=False)
        return result

    def usable(self) -> Bool:
        """(T, V) good observations that no missed shadow explains."""
        return self._usable

    @cached_property
    def _usable(self) -> Bool:
        usable: Bool = (self.quality > 0) & (mean(self.reflected) > MISSED_SHADOW * mean(self.typical()))
        usable.setflags(write=False)
        return usable

    def trust(self) -> F64:
        """(T, V) 0..1: how far to trust an observation beside a good one at its angle, whose quality is cos_v^2."""
        quality = self.quality if self.clipped is None else self.quality + self.clipped
        return np.minimum(quality / np.clip(self.cos_v, 1e-3, 1.0) ** 2, 1.0)

    def typical_observations(self) -> float:
        """How many usable observations a texel that has some typically has."""
        count = self.usable().sum(1)
        return float(np.median(count[count > 0])) if count.any() else 0.0

    def diffuse_gain(self, roughness: float, base: F64 | None = None) -> F64:
        """(T, V, C) what a diffuse of that Diffuse Roughness reflects over what a smooth one does.

        base: (T, C); None: about what the texels reflect.
        """
        single, lost = diffuse_parts(self.lobes, np.clip(self.cos_v, 1e-3, 1.0), roughness)
        if base is not None:
            return np.asarray(single + lost * brdf.rough_bounce(base[:, None], roughness))
        usable = self.usable()[..., None]
        count = np.maximum(usable.sum(1, keepdims=True), 1)
        one, two = (np.where(usable, part, 0).sum(1, keepdims=True) / count for part in (single, lost))
        shown = np.pi * self.typical()
        bounce = brdf.rough_bounce(np.clip(shown, 0, 1), roughness)
        for _ in range(PASSES):
            bounce = brdf.rough_bounce(np.clip(shown / np.maximum(one + two * bounce, LEAST), 0, 1), roughness)
        return np.asarray(single + lost * bounce)

    @cached_property
    def views_of(self) -> tuple[I32, I32]:
        """(columns of `cos_v` that differ; (V,) which of these each layer has): views of a camera see a texel alike."""
        _, columns, of = np.unique(self.camera, return_index=True, return_inverse=True)
        if not np.array_equal(self.cos_v, self.cos_v[:, columns[of]]):
            columns = of = np.arange(len(self.camera))
        return columns.astype(np.int32), of.astype(np.int32)

    def part(self, texels: Bool | I32) -> SampledTexels:
        """Some of the texels."""
        part = SampledTexels(self.reflected[texels], self.quality[texels], self.cos_v[texels], self.lobes[texels],
                             self.irradiance[texels], self.camera, self.channel, self.lamps,
                             None if self.nodes is None else self.nodes[texels],
                             None if self.clipped is None else self.clipped[texels])
        # Each texel says these of itself: where they are known, they are not sought again.
        vars(part).update({name: vars(self)[name][texels] for name in ("_typical", "_usable") if name in vars(self)})
        return part

    def nearest(self) -> F64:
        """(T,) least squared sine between normal and half vector of what is usable; of an environment 0."""
        if self.nodes is not None:
            return np.zeros(len(self.quality))
        return np.asarray(np.where(self.usable()[..., None], self.lobes[..., 0], 1.0).min((1, 2)))


@dataclass(frozen=True)
class Lobes:
    """The material of T texels, base colour aside."""

    roughness: F64  # (T, 2) of the two lobes, alike where there is one
    weight: F64  # (T,) of the first
    level: F64  # (T,) Specular IOR Level
    beckmann: bool = False  # two lobes of Beckmann's distribution over a Lambert diffuse
    metallic: float | F64 = 0.0  # of one lobe; (T,): of each texel
    coat: Coat | None = None
    diffuse: float = 0.0  # Diffuse Roughness of one lobe


def one_lobe(
    roughness: F64, level: float | F64, metallic: float | F64 = 0.0, coat: Coat | None = None, diffuse: float = 0.0,
) -> Lobes:
    """(T,) roughness under one Specular IOR Level, or one for each."""
    return Lobes(np.stack([roughness, roughness], -1), np.ones(len(roughness)), np.full(len(roughness), level),
                 metallic=metallic, coat=coat, diffuse=diffuse)


def parts(texels: SampledTexels, lobes: Lobes | None, base: F64 | None = None) -> tuple[F64, F64]:
    """What is reflected for each unit of base colour, and whatever that is; None: Lambert.

    (T, V, 1) each, but (T, V, C) of a metal or a rough diffuse, whose multiple scattering is that of ``base``, (T, C).
    """
    if lobes is None:
        shape = (*texels.cos_v.shape, 1)
        return np.full(shape, 1 / np.pi), np.zeros(shape)
    diffuse, specular = _lobe(texels, lobes.roughness[:, 0], lobes.level, lobes.beckmann)
    if np.any(lobes.weight < 1):
        other = _lobe(texels, lobes.roughness[:, 1], lobes.level, lobes.beckmann)
        w = lobes.weight[:, None]
        diffuse, specular = w * diffuse + (1 - w) * other[0], w * specular + (1 - w) * other[1]
    diffuse, specular = diffuse[..., None], specular[..., None]
    if lobes.diffuse > 0:
        diffuse = diffuse * texels.diffuse_gain(lobes.diffuse, base)
    if np.any(lobes.metallic > 0):
        assert base is not None
        gain = metal_gain(lobes.roughness[:, 0], texels.cos_v, base)
        own, edge = (part[..., None] * gain for part in _metal(texels, lobes))
        share = np.reshape(lobes.metallic, (-1, 1, 1))
        diffuse, specular = (1 - share) * diffuse + share * own, (1 - share) * specular + share * edge
    if lobes.coat is not None:
        cos_v = np.clip(texels.cos_v, 1e-3, 1.0)
        above, left = coat_values(LobePlaces(texels.lobes, cos_v, texels.nodes), cos_v, lobes.coat)
        diffuse, specular = left[..., None] * diffuse, left[..., None] * specular + above[..., None]
    return diffuse, specular


def _metal(texels: SampledTexels, lobes: Lobes) -> tuple[F64, F64]:
    return metal_values(texels.lobes, np.clip(texels.cos_v, 1e-3, 1.0), lobes.roughness[:, 0], texels.nodes)


def metal_gain(roughness: F64, cos_v: F64, base: F64) -> F64:
    """(T, V, C) gain of a metal's lobe by multiple scattering.  roughness: (T,).  cos_v: (T, V).  base: (T, C)."""
    return brdf.metal_gain(base[:, None], brdf.metal_energy(roughness[:, None], cos_v)[:, :, None])


def _lobe(texels: SampledTexels, roughness: F64, level: F64, beckmann: bool) -> tuple[F64, F64]:
    cos_v = np.clip(texels.cos_v, 1e-3, 1.0)
    shape = lobe_values(texels.lobes, cos_v, roughness, beckmann, texels.nodes)
    if beckmann:
        return np.full(cos_v.shape, 1 / np.pi), summed(shape)
    if np.any(level != 0.5):
        shape = shape * fresnel_ratio(texels.lobes, cos_v, level[:, None, None], texels.nodes, roughness)
    gain, taken = energy_of(texels, roughness, level)
    return (1 - taken) / np.pi, summed(shape) * gain


def energy_of(texels: SampledTexels, roughness: F64, level: F64) -> tuple[F64, F64]:
    """(T, V) each: gain of a lobe by multiple scattering, and what it takes from the diffuse.

    ``roughness``, ``level``: (T,).  It is looked up once for all views of a camera.
    """
    columns, of = texels.views_of
    cos_v = np.clip(texels.cos_v[:, columns], 1e-3, 1.0)
    energy = (brdf.principled_energy(roughness[:, None], cos_v) if np.all(level == 0.5) else
              brdf.principled_energy_level(roughness[:, None], cos_v, level[:, None]))
    gain, taken = (energy[..., k].take(of, 1) for k in (0, 1))
    return gain, taken


def predicted(
    texels: SampledTexels, lobes: Lobes | None, known: Bool, brightest: float = 1.0, drawn: float = 0.0,
    by_light: float = 0.0,
) -> F64:
    """(T, V, C) radiance / irradiance of all layers, base colour from the layers that are ``known``, (V,).

    ``brightest``: of base colours, 1 unless the power of all lamps is a matter of what is compared.  ``drawn``: for so
    many observations counts what all texels together say of base colour (see `common_base`), beside a texel's own.
    ``by_light``: power of the irradiance by which observations count in base colour.
    """
    return under_strengths(texels, lobes, known, (drawn,), brightest, by_light)[0]


def under_strengths(
    texels: SampledTexels, lobes: Lobes | None, known: Bool, drawn: Sequence[float], brightest: float = 1.0,
    by_light: float = 0.0,
) -> list[F64]:
    """As of `predicted`, for each number of observations that ``drawn`` has.

    Each camera's pixels cover the texture differently, so that a camera's own views say its base colour, and those of
    others where it has none.
    """
    weight, (first, passes) = _base_weight(texels, by_light), _first_pass(texels, lobes)
    weight = np.where(known[:, None], weight, 0.0)
    return [_predicted(texels, lobes, known, weight, first, passes, strength, brightest) for strength in drawn]


def predicted_apart(
    texels: SampledTexels, lobes: Lobes | None, left_out: Sequence[Bool], drawn: float = 0.0, by_light: float = 0.0,
) -> F64:
    """(T, V, C) as of `predicted`, of each layer by those that are not left out with it; 0 of one that never is."""
    weight, (first, passes) = _base_weight(texels, by_light), _first_pass(texels, lobes)
    result = np.zeros_like(texels.reflected)
    for out in left_out:
        known = ~out
        found = _predicted(
            texels, lobes, known, np.where(known[:, None], weight, 0.0), first, passes, drawn, brightest=1.0)
        result[:, out] = found[:, out]
    return result


def _base_weight(texels: SampledTexels, by_light: float) -> F64:
    """(T, V, C) of squared residuals in a texel's base colour."""
    unit = np.maximum(texels.reflected, texels.typical())
    weight = np.where(texels.usable()[..., None], texels.quality[..., None] / unit**2, 0.0)
    return np.asarray(weight * texels.irradiance**by_light if by_light else weight)


def _first_pass(texels: SampledTexels, lobes: Lobes | None) -> tuple[tuple[F64, F64], int]:
    """(as of `parts` before base colour is known, how many passes find it)."""
    again = lobes is not None and (np.any(lobes.metallic > 0) or lobes.diffuse > 0)
    return parts(texels, lobes, np.full_like(texels.reflected[:, 0], 0.5)), PASSES if again else 1


def _predicted(
    texels: SampledTexels, lobes: Lobes | None, known: Bool, weight: F64, first: tuple[F64, F64], passes: int,
    drawn: float, brightest: float,
) -> F64:
    """``weight``: (T, V, C) of squared residuals.  ``first``: what `parts` says in the first of so many passes."""
    base = texels.reflected[:, 0]  # until the first pass has found it
    for n in range(passes):
        white, rest = parts(texels, lobes, base) if n else first
        off, information = weight * white * (texels.reflected - rest), weight * white * white
        common = _common(texels, known, white, rest) if drawn else np.zeros((len(known), 1))
        result = np.empty_like(texels.reflected)
        for channel in np.unique(texels.channel):
            same = texels.channel == channel
            total = off[:, same].sum(1), information[:, same].sum(1)
            count = (weight[:, same] > 0).sum(1, dtype=np.float64)
            alike = common[same][0]
            base = drawn_to(np.clip(total[0] / np.maximum(total[1], LEAST), 0, brightest), count, alike, drawn)
            for camera in np.unique(texels.camera[same]):
                own = same & (texels.camera == camera)
                share = off[:, own].sum(1), information[:, own].sum(1)
                shown = (share[0] + OTHER_CAMERA * total[0]) / np.maximum(share[1] + OTHER_CAMERA * total[1], LEAST)
                result[:, own] = drawn_to(np.clip(shown, 0, brightest), count, alike, drawn)[:, None]
    return np.asarray(result * white + rest)


def common_base(texels: SampledTexels, lobes: Lobes | None) -> tuple[float, ...]:
    """RGB of the one base colour that explains best, by least squares, what all texels reflect."""
    known, base = np.ones(len(texels.camera), bool), np.full_like(texels.reflected[:, 0], 0.5)
    _, first = np.unique(texels.channel, return_index=True)
    for _ in range(PASSES):
        common = _common(texels, known, *parts(texels, lobes, base))
        base = np.broadcast_to(common[first[0]], base.shape)
    return tuple(float(value) for value in common[first].ravel())


def _common(texels: SampledTexels, known: Bool, white: F64, rest: F64) -> F64:
    """(V, C) of each layer's channel, as of `common_base`.  ``white``, ``rest``: as of `parts`.

    Not relative to what is observed, as in a texel: among what differs from texel to texel, as bumps do, that would
    count dark observations most.  By the irradiance, as of `weight_of` in joint_material.py: light that comes out
    beside where it went in makes places bright that hardly any light meets.
    """
    usable = (texels.usable() & known)[..., None]
    weight = np.where(usable, texels.quality[..., None] * texels.irradiance ** (2 / 3), 0.0)
    off, information = (weight * white * (texels.reflected - rest)).sum(0), (weight * white * white).sum(0)
    result = np.empty_like(off)
    for channel in np.unique(texels.channel):
        same = texels.channel == channel
        result[same] = np.clip(off[same].sum(0) / np.maximum(information[same].sum(0), LEAST), 0, 1)
    return result


def noise_by_light(texels: SampledTexels, by_light: float) -> float:
    """How much more of the noise base colours have whose observations count by that power of their irradiance.

    Ratio of standard errors, in the mean of the texels; a camera's views count so among themselves alone, as in a map.
    """
    quality = np.where(texels.usable(), texels.quality, 0.0)
    power = mean(texels.irradiance) ** by_light
    total = noise = np.zeros(len(quality))
    for own in (texels.camera == camera for camera in np.unique(texels.camera)):
        count = quality[:, own].sum(1)
        first, second = (summed(quality[:, own] * power[:, own] ** n) for n in (1, 2))
        total, noise = total + count, noise + (count / np.maximum(first, LEAST)) ** 2 * second
    seen = total > 0
    return float(np.sqrt(np.mean(noise[seen] / total[seen]))) if seen.any() else 1.0


def drawn_to(own: F64, count: F64, common: F64, strength: float) -> F64:
    """Base colours that ``count`` observations say, drawn to a common one, which counts for ``strength`` of them."""
    return np.asarray((count * own + strength * common) / np.maximum(count + strength, LEAST)) if strength else own


def median_of_known(values: F64) -> F64:
    """(T, ...) median along axis 1 of what is not NaN in (T, V, ...), of which there is something everywhere."""
    ordered = np.ascontiguousarray(np.moveaxis(values, 1, -1))
    ordered.sort(-1)  # NaN last
    known = np.count_nonzero(~np.isnan(ordered), axis=-1)
    low, high = (np.take_along_axis(ordered, at[..., None], -1)[..., 0] for at in ((known - 1) // 2, known // 2))
    return np.asarray(0.5 * (low + high))
