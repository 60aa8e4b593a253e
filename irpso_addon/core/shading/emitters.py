"""Meshes that glow as weighted patches: float64 twin of the patches in ``shaders/observe/environment.frag``.

The surfaces are cut into patches of about equal weight.  Seen from one place, a patch is a direction of
`environment`, so that nodes of roughness hold what the specular lobe returns of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from ..data import F64, Bool, Emitter, Environment, Light
from .environment import Directions, clamped_mean, directions, environment_irradiance
from .lights import light_irradiance

COUNT = 512  # patches of all emitters of a view, at most; each has a shadow map
LEAST_COUNT = 16  # of one emitter's side: as many as a lamp's points; ...
CURVED_COUNT = 128  # ... and so many more where it faces all ways
FINE = 0.02  # radians, seen from the subject: patches need not be smaller
PARTS = 4  # into which a patch is divided where a lobe is as sharp as it is wide, and each of those again, ...
LEVELS = 3  # ... so many times
NEAR = 0.003  # variance of its directions, in radians squared, from which on a patch is divided in any case
NORMALS = 0.5  # spread of normals against that of directions, where patches are cut
FAINT = 1e-3  # of the irradiance of a view's lamps: an emitter below is left out
LIFT = 1e-4  # of an emitter's extent: how far before it its shadows are seen from


@dataclass(frozen=True)
class Patches:
    """N pieces of glowing surfaces; of each the side that shines."""

    place: F64  # (N, 3) world, metres: the mean
    normal: F64  # (N, 3) mean of the unit normals
    power: F64  # (N, 3) radiance times area: W/sr, linear RGB
    size: F64  # (N,) metres: standard deviation of places, along each of two axes of the surface
    sight: F64  # (N, 3) a place just before the surface: what it does not see is in the shadow
    parts: Patches | None = None  # PARTS of each patch, one patch's after the other's; power 0: none


@dataclass(frozen=True)
class _Leaves:
    """Small triangles of one side of an emitter."""

    corners: F64  # (T, 3, 3)
    radiance: F64  # (T, 3)
    normal: F64  # (T, 3) unit
    area: F64  # (T,)


def patches(emitters: Sequence[Emitter], center: F64, radius: float, count: int = COUNT) -> Patches:
    """Of all emitters, for a subject in a sphere: only what can shine on it."""
    sides = [(emitter, side) for emitter in emitters for side in _sides(emitter, center, radius)]
    weights = [float(_weight(side, center, radius).sum()) for _, side in sides]
    made = []
    for (emitter, side), weight in zip(sides, weights, strict=True):
        levels = _levels(side, center, radius, count * weight / sum(weights))
        extent = float(np.linalg.norm(np.ptp(emitter.triangles.reshape(-1, 3).astype(np.float64), axis=0)))
        made.append(_patches(_divided(side, center, radius, 2**levels * PARTS**LEVELS), center, radius, levels,
                             LIFT * extent))
    return reduce(_joined, made, _none())


def _none() -> Patches:
    none = np.zeros((0, 3))
    empty = Patches(none, none, none, np.zeros(0), none)
    found = empty
    for _ in range(LEVELS):
        found = replace(empty, parts=found)
    return found


def _joined(one: Patches, two: Patches) -> Patches:
    parts = _joined(one.parts, two.parts) if one.parts is not None and two.parts is not None else None
    place, normal, power, sight = (np.concatenate([getattr(one, name), getattr(two, name)])
                                   for name in ("place", "normal", "power", "sight"))
    return Patches(place, normal, power, np.concatenate([one.size, two.size]), sight, parts)


def _sides(emitter: Emitter, center: F64, radius: float) -> list[_Leaves]:
    """The triangles' fronts, and their backs if they shine too; without those that the subject is behind."""
    corners = emitter.triangles.astype(np.float64)
    found = []
    for turned in ([0, 1, 2], [0, 2, 1])[:2 if emitter.both_sides else 1]:
        side = _leaves(corners[:, turned], emitter.radiance.astype(np.float64))
        before = ((center - side.corners[:, 0]) * side.normal).sum(-1) > -radius
        shines = before & (side.radiance > 0).any(-1) & (side.area > 1e-14)
        if shines.any():
            found.append(_chosen(side, shines))
    return found


def _leaves(corners: F64, radiance: F64) -> _Leaves:
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return _Leaves(corners, radiance, cross / np.maximum(length, 1e-300)[:, None], length / 2)


def _chosen(side: _Leaves, which: Bool) -> _Leaves:
    return _Leaves(side.corners[which], side.radiance[which], side.normal[which], side.area[which])


def _weight(side: _Leaves, center: F64, radius: float) -> F64:
    """(T,) about what each adds to the subject's irradiance."""
    away = side.corners.mean(1) - center
    return np.asarray(side.radiance.mean(-1) * side.area / np.maximum((away * away).sum(-1), radius**2))


def _levels(side: _Leaves, center: F64, radius: float, most: float) -> int:
    """How many times it is cut in halves: by its size as the subject sees it, and its share of all patches."""
    away = np.maximum(np.linalg.norm(side.corners.mean(1) - center, axis=-1), radius)
    seen = float((side.area / away**2).sum())
    curved = 1 - float(np.linalg.norm(np.average(side.normal, axis=0, weights=side.area)))
    least = LEAST_COUNT + CURVED_COUNT * curved
    return int(np.ceil(np.log2(np.clip(min(seen / FINE**2, most), least, max(COUNT, least)))))


def _divided(side: _Leaves, center: F64, radius: float, count: int) -> _Leaves:
    """The triangles cut across their longest edges until each weighs less than one of ``count``."""
    limit = float(_weight(side, center, radius).sum()) / count
    while (large := _weight(side, center, radius) > limit).any():
        corners = side.corners[large]
        edges = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=-1)  # from each corner to the next
        first = edges.argmax(1)[:, None]
        a, b, c = (np.take_along_axis(corners, ((first + k) % 3)[..., None], 1)[:, 0] for k in range(3))
        middle = (a + b) / 2
        halves = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
        rest = _chosen(side, ~large)
        side = _leaves(np.concatenate([rest.corners, halves]),
                       np.concatenate([rest.radiance, side.radiance[large], side.radiance[large]]))
    return side


def _patches(side: _Leaves, center: F64, radius: float, levels: int, lift: float) -> Patches:
    """2^levels patches with their parts, by halving each along its widest spread."""
    each = int(np.log2(PARTS))
    fine = levels + each * LEVELS
    weight, middle = _weight(side, center, radius), side.corners.mean(1)
    away = float(np.average(np.maximum(np.linalg.norm(middle - center, axis=1), radius), weights=weight))
    traits = np.concatenate([middle / away, NORMALS * side.normal], 1)
    number = np.zeros(len(weight), np.int64)
    for level in range(fine):
        number = _halved(traits, weight, number, 2**level)
    parts = _of_numbers(side, number, 2**fine, lift)
    for coarser in range(each, each * LEVELS + 1, each):
        parts = replace(_of_numbers(side, number >> coarser, 2 ** (fine - coarser), lift), parts=parts)
    return parts


def _halved(traits: F64, weight: F64, number: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """(T,) cluster numbers 0..2 count - 1 from those of ``count`` clusters: each is cut at its median weight."""
    total = np.bincount(number, weight, count)
    some = np.maximum(total, 1e-300)
    mean = np.stack([np.bincount(number, weight * t, count) / some for t in traits.T], 1)
    spread = np.stack([np.bincount(number, weight * t, count) for t in ((traits - mean[number]) ** 2).T], 1)
    along = np.take_along_axis(traits, spread.argmax(1)[number][:, None], 1)[:, 0]
    order = np.lexsort((along, number))
    before = np.cumsum(weight[order]) - weight[order] / 2 - (np.cumsum(total) - total)[number[order]]
    upper = np.empty(len(number), np.int64)
    upper[order] = before >= total[number[order]] / 2
    return np.asarray(2 * number + upper)


def _of_numbers(side: _Leaves, number: NDArray[np.int64], count: int, lift: float) -> Patches:
    """One patch of each cluster's triangles."""
    def summed(values: F64) -> F64:
        return np.stack([np.bincount(number, value, count) for value in values.T], 1)

    middle = side.corners.mean(1)
    weight = side.radiance.mean(-1) * side.area
    some = np.maximum(np.bincount(number, weight, count), 1e-300)[:, None]
    place, normal = summed(middle * weight[:, None]) / some, summed(side.normal * weight[:, None]) / some
    off = ((middle - place[number]) ** 2).sum(-1)
    edges = ((np.roll(side.corners, -1, 1) - side.corners) ** 2).sum((1, 2))
    variance = summed((weight * (off + edges / 36))[:, None])[:, 0] / some[:, 0]  # a triangle's own: edges^2 / 36
    order = np.lexsort((-off, number))  # the nearest to the mean is the last of its cluster
    nearest = np.zeros(count, np.int64)
    nearest[number[order]] = order
    return Patches(place, normal, summed(side.radiance * side.area[:, None]), np.sqrt(variance / 2),
                   middle[nearest] + lift * side.normal[nearest])


def seen_from(found: Patches, P: F64) -> Directions:
    """The patches as directions from a place (3,)."""
    offset = found.place - P
    d2 = np.maximum((offset * offset).sum(-1), 1e-20)
    toward = offset / np.sqrt(d2)[:, None]
    facing = -(found.normal * toward).sum(-1)
    power = found.power * (_facing(facing, found.normal) / d2)[:, None]
    spread = found.size * np.sqrt((1 + facing**2) / 2 / d2)
    return Directions(toward, power, spread, None if found.parts is None else seen_from(found.parts, P), NEAR)


def _facing(cosine: F64, normal: F64) -> F64:
    """Mean of max(cosine, 0) over a patch whose normals' mean has a cosine; its normals are spread evenly about it."""
    return clamped_mean(cosine, np.sqrt(1.5 * np.maximum(1 - (normal * normal).sum(-1), 1e-12)))


def emitter_irradiance(found: Patches, P: F64, N: F64) -> F64:
    """(T, 3) W/m^2 at (T, 3) places of (T, 3) unit normals, without shadows and parts."""
    total = np.zeros((len(P), 3))
    for place, normal, power in zip(found.place, found.normal, found.power, strict=True):
        offset = place - P
        d2 = np.maximum((offset * offset).sum(-1), 1e-20)
        share = np.maximum((N * offset).sum(-1), 0) * _facing(-(offset @ normal) / np.sqrt(d2), normal) / d2**1.5
        total += share[:, None] * power
    return total


def counts(emitter: Emitter, lights: Sequence[Light], center: F64, radius: float) -> bool:
    """Whether it adds to what lamps send to a subject in a sphere, where the sphere is nearest to it."""
    found = patches([emitter], center, radius, LEAST_COUNT)
    toward = found.power.mean(-1) @ (found.place - center)
    length = float(np.linalg.norm(toward))
    if not length:
        return bool(len(found.place))
    N = (toward / length)[None]
    own = float(emitter_irradiance(found, center + radius * N, N).mean())
    total = 0.0
    for light in lights:
        facing = light.matrix[:3, 2] if light.kind == "SUN" else light.matrix[:3, 3] - center
        total += float(light.power.mean() * light_irradiance(light, center, facing / np.linalg.norm(facing)))
    return own >= FAINT * total


def around_irradiance(environment: Environment, P: F64, N: F64, count: int) -> F64:
    """(T, 3) W/m^2 of an environment at (T, 3) places of (T, 3) unit normals, without shadows.

    ``count``: directions and patches that stand for it.
    """
    result = environment_irradiance(directions(environment, count, divides=False), N)
    if environment.emitters and len(P):
        low, high = P.min(0), P.max(0)
        radius = float(np.linalg.norm(high - low)) / 2 + 1e-6
        result = result + emitter_irradiance(patches(environment.emitters, (low + high) / 2, radius, count), P, N)
    return result


def mean_power(emitters: Sequence[Emitter]) -> F64:
    """(3,) radiance of all, over all directions, from a metre before them: about what share and colour they have."""
    total = np.zeros(3)
    for emitter in emitters:
        side = _leaves(emitter.triangles.astype(np.float64), emitter.radiance.astype(np.float64))
        total += side.area @ side.radiance
    return total / (4 * np.pi)
