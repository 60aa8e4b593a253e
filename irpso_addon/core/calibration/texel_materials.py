"""The material of each texel of a sample: its own roughness, near what its material as a whole says."""

from __future__ import annotations

import numpy as np

from ..data import F64, I32
from ..evaluation.apart_descent import HELD_TOGETHER
from ..evaluation.descent import COSINES, METAL_BASE, AmongCosines
from ..evaluation.joint_material import PLAIN_ALONE, JointSearch, OneMaterial
from ..evaluation.lobe_values import LobePlaces, fresnel_ratio
from ..evaluation.sampled_texels import Lobes, SampledTexels, one_lobe, parts
from ..shading import brdf
from ..vectors import dot, mean
from .paint import base_colours, paints_of
from .rig_sample import RigSample

NODES = np.geomspace(0.08, 1.0, 16)  # roughness
METALS = np.linspace(0.0, 1.0, 5)  # Metallic
METAL_SPREAD = 0.5  # standard deviation of Metallic from texel to texel
LEAST = 1e-12


def materials_of(sample: RigSample, texels: SampledTexels, levels: bool) -> dict[int, OneMaterial]:
    """One roughness and level for each material slot; ``texels``: of the sample, under some rig.

    ``levels``: whether the level may differ from 0.5.
    """
    known, found = np.ones(len(sample.view), bool), {}
    texels.usable()  # once for all parts
    for slot in np.unique(sample.slot):
        own = texels.part(sample.slot == slot)
        if own.usable().any():
            if sample.metals or levels:
                found[int(slot)] = JointSearch(own, metals=sample.metals).apart(known)
            else:
                found[int(slot)] = JointSearch(own, metals=False, levels=PLAIN_ALONE).plain(known)
    return found


def lobes_of(
    sample: RigSample, texels: SampledTexels, materials: dict[int, OneMaterial], near: F64 | None = None,
) -> Lobes:
    """Each texel's own roughness at its material's level; ``texels``: of the sample, under some rig.

    ``near``: (T,) roughness under a rig that is nearly the same; then what is far from it is not looked at.
    """
    roughness, level, metallic = (np.full(len(sample.slot), value) for value in (0.5, 0.5, 0.0))
    texels.usable()  # once for all parts
    for slot, one in materials.items():
        own = sample.slot == slot
        if own.any():
            nearby, some = None if near is None else near[own], texels if own.all() else texels.part(own)
            if sample.metals:
                roughness[own], metallic[own] = _metallic(some, one, nearby)
            else:
                roughness[own] = _roughness(some, one, nearby)
            level[own] = one.level
    return one_lobe(roughness, level, metallic if sample.metals else 0.0)


def shown_by(texels: SampledTexels, lobes: Lobes) -> tuple[F64, F64]:
    """As `parts`, (T, V, 1): a metal's multiple scattering is that of a typical base colour."""
    return parts(texels, lobes, np.full((len(texels.cos_v), 1), METAL_BASE))


def _metallic(texels: SampledTexels, one: OneMaterial, near: F64 | None) -> tuple[F64, F64]:
    """As `_roughness`, and Metallic: (T,) each."""
    f, weight = _weighted(texels)
    paints, nodes, level = paints_of(texels), _nodes(near, len(f)), np.full(len(f), one.level)
    costs = np.empty((len(METALS), *nodes.shape))
    for n, node in enumerate(nodes):
        plain, metal = (shown_by(texels, one_lobe(NODES[node], level, pure)) for pure in (0.0, 1.0))
        for k, share in enumerate(METALS):
            white, rest = ((1 - share) * a[..., 0] + share * b[..., 0] for a, b in zip(plain, metal, strict=True))
            base = base_colours(paints, weight, white, f - rest)
            costs[k, n] = (weight * (f - rest - base * white) ** 2).sum(1)
    degrees = np.maximum((weight > 0).sum(1) - 3, 1)
    costs = costs / max(float(np.median(costs.min((0, 1)) / degrees)), LEAST)
    costs += 2 * HELD_TOGETHER * np.log(NODES[nodes] / one.roughness) ** 2
    costs += ((METALS - one.metallic)[:, None, None] / METAL_SPREAD) ** 2
    best, texel = costs.min(1).argmin(0), np.arange(len(f))
    return _lowest(costs[best, :, texel].T, np.log(NODES[nodes])), METALS[best]


def _weighted(texels: SampledTexels) -> tuple[F64, F64]:
    """(T, V) each: what is reflected, and weights under which squared errors are those of the cube root of radiance."""
    f, light = mean(texels.reflected), mean(texels.irradiance)
    unit = np.maximum(f, mean(texels.typical()))
    return f, np.where(texels.usable(), texels.quality * light ** (2 / 3) / unit ** (4 / 3), 0.0)


def _roughness(texels: SampledTexels, one: OneMaterial, near: F64 | None) -> F64:
    """(T,) by the squared errors of the cube root of radiance, as `JointSearch`."""
    f, weight = _weighted(texels)
    cos_v, paints = np.clip(texels.cos_v, 1e-3, 1.0), paints_of(texels)
    ratio = fresnel_ratio(texels.lobes, cos_v, np.asarray(one.level), texels.nodes)
    energies = brdf.principled_energy_level(NODES[:, None], COSINES, np.full((len(NODES), 1), one.level))
    columns, of = texels.views_of
    among, places = AmongCosines(texels.cos_v[:, columns]), LobePlaces(texels.lobes, cos_v, texels.nodes)

    def cost(node: I32) -> F64:
        """(T,) of a node each."""
        gain, taken = (among.values(table, node[:, None]).take(of, 1) for table in tables)
        specular = dot(places.values(NODES[node]), ratio) * gain
        diffuse = (1 - taken) / np.pi
        base = base_colours(paints, weight, diffuse, f - specular)
        return np.asarray((weight * (f - specular - base * diffuse) ** 2).sum(1))

    tables = [np.ascontiguousarray(energies[..., k]) for k in (0, 1)]
    nodes = _nodes(near, len(f))
    costs = np.stack([cost(node) for node in nodes])
    degrees = np.maximum(texels.usable().sum(1) - 2, 1)
    noise = max(float(np.median(costs.min(0) / degrees)), LEAST)
    costs = costs / noise + 2 * HELD_TOGETHER * np.log(NODES[nodes] / one.roughness) ** 2
    return _lowest(costs, np.log(NODES[nodes]))


def _nodes(near: F64 | None, texels: int) -> I32:
    """(N, T) which of NODES are looked at: all, or five about each texel's own."""
    if near is None:
        return np.broadcast_to(np.arange(len(NODES), dtype=np.int32)[:, None], (len(NODES), texels))
    nearest = np.abs(np.log(NODES[:, None] / near)).argmin(0)
    return np.asarray(np.clip(nearest, 2, len(NODES) - 3) + np.arange(-2, 3)[:, None], np.int32)


def _lowest(costs: F64, nodes: F64) -> F64:
    """(T,) where the parabola through the lowest of (N, T) costs at (N, T) ``nodes``, logarithms, has its bottom."""
    at = np.clip(costs.argmin(0), 1, len(costs) - 2)
    texel = np.arange(costs.shape[1])
    before, here, after = (costs[at + step, texel] for step in (-1, 0, 1))
    bend = np.maximum(before + after - 2 * here, LEAST)
    step = np.clip(0.5 * (before - after) / bend, -1, 1)
    return np.asarray(np.exp(nodes[at, texel] + step * (nodes[1] - nodes[0])))
