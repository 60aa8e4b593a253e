"""Light from all around as places show it that face away from all lamps of a view.

Lit places hardly distinguish a little of such light from lamps or normals that are off.  Places that face away show
nothing else but it and what bounces off other surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data import F64, I32, Bool
from ..shading import brdf
from ..vectors import dot
from .rig_sample import SHEEN, RigSample, to_middle

AWAY = -0.15  # cosine to a lamp, at most: normals are off by some degrees, and lamps have a size
FACING = 0.35  # cosine to the camera, at least
LEAST_OPEN = 0.05  # share of light from all around: what hides more is not known so well
FEWEST = 8  # clusters of texels that show it
UNSURE = 0.1  # relative: what is not alike from everywhere, and what bounces
LEAST_UNSURE = 5e-4  # of the lamps' typical irradiance: read noise, and what black levels leave


@dataclass(frozen=True)
class AroundInShade:
    """Irradiance from all around, over the sample's unit."""

    value: float
    error: float


def faces_away(sample: RigSample) -> Bool:
    """(T, V) places that a layer's camera sees and that no lamp of its view can reach."""
    texels = sample.texels
    seen = np.zeros(texels.quality.shape, bool)
    for camera in np.unique(texels.camera):
        own = texels.camera == camera
        seen[:, own] = (texels.quality[:, own] > 0).any(1, keepdims=True)
    away = seen & (texels.cos_v.max(1, keepdims=True) > FACING)
    for v, place in enumerate(sample.view):
        view = sample.rig.views[place]
        away[:, v] &= bool(view.lights) and view.environment is None and (
            view.ambient is None and not any(view.ambient_radiance))  # else the picture has light that is known
        for light in view.lights:
            away[:, v] &= dot(to_middle(light, sample.position), sample.normal) < AWAY
    return away


def shows_shade(sample: RigSample) -> bool:
    """Whether enough places face away from all lamps."""
    if sample.shade is None:
        return False
    return len(np.unique(sample.cluster[np.isfinite(sample.shade).any((1, 2))])) >= FEWEST


def around_in_shade(sample: RigSample, base: F64, shown: F64, openness: F64) -> AroundInShade | None:
    """What the places in the shade say; None where too few do.

    (T, V) each: base colours, what pictures show of radiance, and the share of such light that reaches a place.
    """
    if sample.shade is None or not shows_shade(sample):
        return None
    shade = sample.shade.mean(-1)
    known = np.isfinite(shade) & (openness > 0)
    at, toward = np.nonzero(known)[0], np.clip(sample.texels.cos_v[known], FACING, 1.0)
    sheen = brdf.principled_energy(SHEEN, toward)[..., 1]
    reflected = (base[known] * (1 - sheen) + sheen) * np.maximum(openness[known], LEAST_OPEN) * shown[known]
    found = shade[known] / reflected * (np.pi / sample.light)
    values = _medians(found, sample.cluster[at])
    if len(values) < FEWEST:
        return None
    value = max(float(np.median(values)), 0.0)
    spread = 1.4826 * float(np.median(np.abs(values - value))) / len(values)**0.5
    return AroundInShade(value, max(UNSURE * value, spread, LEAST_UNSURE))


def _medians(values: F64, cluster: I32) -> F64:
    """Of each cluster, whose numbers (N,) ``cluster`` has."""
    order = np.lexsort((values, cluster))
    first, count = np.unique(cluster[order], return_index=True, return_counts=True)[1:]
    ordered = values[order]
    return np.asarray(0.5 * (ordered[first + (count - 1) // 2] + ordered[first + count // 2]))
