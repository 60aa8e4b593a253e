"""What maps say that a view should show: radiance over irradiance at its pixels, by the models of core/shading/brdf.py.

Independent of the shaders that solved, so that it can judge them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data import F32, F64, I32, Bool, Coat, Maps, Solution
from ..resampling import bilinear
from ..shading import brdf
from .lobe_values import LobePlaces, coat_values, diffuse_parts, fresnel_ratio, lobe_values, metal_values

TAPS = 4  # by TAPS, over a pixel's footprint


@dataclass(frozen=True)
class PlaceView:
    """One view at T places: texels, or pixels."""

    rgb: F32  # (T, 3) radiance / irradiance, 1/sr
    weight: F32  # (T, 3) how good an observation of the channel is; 0: none, or at an edge of shadow or silhouette
    cos_v: F32  # (T,)
    lobes: F32  # (T, 3, L, 4) for each channel and light: sin2h, radius2, cos_l, F / (2 cos_l cos_v) * share of E
    irradiance: F32 | None = None  # (T, 3) W/m^2 without shadows, where that was asked for; NaN at places passed over
    nodes: F32 | None = None  # (T, 3, 2, NODES) of an environment, see lobe_values.py

    def nearest(self) -> F32:
        """(T,) least squared sine between normal and half vector; of an environment 0."""
        if self.nodes is not None:
            return np.zeros(len(self.cos_v), np.float32)
        return np.asarray(self.lobes[:, :, :, 0].min((1, 2)))


@dataclass(frozen=True)
class Surface:
    """Maps at T places."""

    base: F64  # (T, 3) linear
    lobes: F64  # (T, 3) roughness1, roughness2, weight of lobe 1
    level: F64  # (T,) Specular IOR Level
    beckmann: Bool  # (T,) two lobes of Beckmann's distribution over a diffuse
    metallic: F64 | None = None  # (T,) of one lobe; None: 0 everywhere
    coat: I32 | None = None  # (T,) which of the ``coats``, -1: none; None: none anywhere
    coats: tuple[Coat, ...] = ()
    diffuse_roughness: F64 | None = None  # (T,) of one lobe; None: 0 everywhere


@dataclass(frozen=True)
class Pixels:
    """Where P pixels of a camera look."""

    uv: F32  # (P, 2) at their centres
    slope: F32  # (P, 4) d(uv)/dx, d(uv)/dy, by pixel
    footprint: float  # pixels: width of the box over which one averages


def surface(solution: Solution, ndf: str, slots: I32, names: tuple[str, ...]) -> Surface:
    """A solution's maps, T = n n; slots: (n, n) material of each texel, names: of the materials."""
    maps: Maps = solution.maps
    r = maps.roughness
    lobes = np.stack([r, r, np.ones_like(r)], -1) if maps.lobes is None else maps.lobes
    level = np.full_like(r, 0.5) if maps.specular is None else maps.specular
    material = np.maximum(slots, 0)
    model = np.array([solution.model.get(name, "one-lobe") for name in names])[material]
    metallic = np.array([solution.metallic.get(name, 0.0) for name in names], np.float64)[material]
    if maps.metallic is not None:  # some of it is paint
        metallic = np.where(np.array([name in solution.paint for name in names])[material], maps.metallic, metallic)
    level = np.where(model == "lambert", 0.0, level)
    rough = np.array([solution.diffuse_roughness.get(name, 0.0) for name in names], np.float64)[material]
    coated = [name for name in names if name in solution.coats]
    coat = np.array([coated.index(name) if name in coated else -1 for name in names], np.int32)[material]
    return Surface(
        base=maps.base_color.reshape(-1, 3).astype(np.float64), lobes=lobes.reshape(-1, 3).astype(np.float64),
        level=level.ravel().astype(np.float64), beckmann=((model == "two-lobe") & (ndf == "beckmann")).ravel(),
        metallic=metallic.ravel(), coat=coat.ravel() if coated else None,
        coats=tuple(solution.coats[name] for name in coated), diffuse_roughness=rough.ravel() if rough.any() else None)


def shown(maps: Surface, pixels: Pixels) -> Surface:
    """What pixels show of maps: the mean base colour over the footprint, the lobes of the centre.

    A map is the surface, a pixel its mean: one texel in place of the pixel would blame a sharp map for being sharp.
    """
    size = round(len(maps.level) ** 0.5)
    base = maps.base.reshape(size, size, 3)
    mean = np.zeros((len(pixels.uv), 3))
    steps = ((np.arange(TAPS) + 0.5) / TAPS - 0.5) * pixels.footprint
    for dx in steps:
        for dy in steps:
            mean += bilinear(base, pixels.uv + dx * pixels.slope[:, :2] + dy * pixels.slope[:, 2:]) / TAPS**2
    x, y = np.clip((pixels.uv * size).astype(int), 0, size - 1).T
    texel = y * size + x
    lobes = bilinear(maps.lobes.reshape(size, size, 3), pixels.uv)
    metallic = None if maps.metallic is None else maps.metallic[texel]
    coat = None if maps.coat is None else maps.coat[texel]
    rough = None if maps.diffuse_roughness is None else maps.diffuse_roughness[texel]
    return Surface(mean, lobes, maps.level[texel], maps.beckmann[texel], metallic, coat, maps.coats, rough)


def predict(at: Surface, view: PlaceView) -> F64:
    """(T, 3) radiance / irradiance, 1/sr."""
    r1, r2, weight = at.lobes.T
    diffuse, specular = _lobe(at, r1, view)
    if np.any(weight < 1):
        other = _lobe(at, r2, view)
        diffuse = weight * diffuse + (1 - weight) * other[0]
        specular = weight[:, None] * specular + (1 - weight)[:, None] * other[1]
    value: F64 = at.base * diffuse[:, None] * _rough(at, view) + specular
    if at.metallic is not None and np.any(at.metallic > 0):
        share = at.metallic[:, None]
        value = (1 - share) * value + share * _metal(at, r1, view)
    return value if at.coat is None else _under_coats(value, at.coat, at.coats, view)


def _rough(at: Surface, view: PlaceView) -> F64:
    """(T, 3) what the diffuse reflects over what a smooth one does; (1, 1) where all are smooth."""
    if at.diffuse_roughness is None:
        return np.ones((1, 1))
    result = np.ones_like(at.base)
    for roughness in np.unique(at.diffuse_roughness[at.diffuse_roughness > 0]):
        here = at.diffuse_roughness == roughness
        cos_v = np.clip(view.cos_v[here].astype(np.float64), 1e-3, 1)
        single, lost = diffuse_parts(view.lobes[here].astype(np.float64), cos_v[:, None], float(roughness))
        result[here] = single[..., 0] + lost[..., 0] * brdf.rough_bounce(at.base[here], float(roughness))
    return result


def _under_coats(value: F64, which: I32, coats: tuple[Coat, ...], view: PlaceView) -> F64:
    """(T, 3) with the coats above."""
    result = value.copy()
    for number, coat in enumerate(coats):
        at = which == number
        cos_v = np.clip(view.cos_v[at].astype(np.float64), 1e-3, 1)
        above, left = coat_values(
            LobePlaces(view.lobes[at].astype(np.float64), cos_v[:, None], _nodes(view, at)), cos_v[:, None], coat)
        result[at] = left * value[at] + above
    return result


def _metal(at: Surface, roughness: F64, view: PlaceView) -> F64:
    """(T, 3) what a metal of that base colour reflects."""
    cos_v = np.clip(view.cos_v.astype(np.float64), 1e-3, 1)
    own, edge = metal_values(view.lobes.astype(np.float64), cos_v[:, None], roughness, _nodes(view))
    gain = brdf.metal_gain(at.base, brdf.metal_energy(roughness, cos_v)[:, None])
    value: F64 = gain * (at.base * own + edge)
    return value


def _lobe(at: Surface, roughness: F64, view: PlaceView) -> tuple[F64, F64]:
    """(T,) what a white diffuse reflects below one lobe, and (T, 3) what the lobe does."""
    cos_v = np.clip(view.cos_v.astype(np.float64), 1e-3, 1)
    energy = brdf.principled_energy(roughness, cos_v)
    other = at.level != 0.5
    if other.any():
        energy[other] = brdf.principled_energy_level(roughness[other], cos_v[other], at.level[other])
    gain, taken = np.where(at.beckmann[:, None], np.array([1.0, 0.0]), energy).T
    lobes, across = view.lobes.astype(np.float64), cos_v[:, None]
    nodes = _nodes(view)
    specular = lobe_values(lobes, across, roughness, nodes=nodes)
    if at.beckmann.any():
        classic = lobe_values(lobes, across, roughness, beckmann=True, nodes=nodes)
        specular = np.where(at.beckmann[:, None, None], classic, specular)
    if other.any():
        specular[other] *= fresnel_ratio(
            lobes[other], across[other], at.level[other][:, None, None], _nodes(view, other), roughness[other])
    return (1 - taken) / np.pi, gain[:, None] * specular.sum(-1)


def _nodes(view: PlaceView, at: Bool | slice = slice(None)) -> F64 | None:
    return None if view.nodes is None else view.nodes[at].astype(np.float64)
