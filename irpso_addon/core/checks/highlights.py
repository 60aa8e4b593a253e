"""Do highlights lie where the lamps would put them?  Asked of pictures and mesh, before anything is solved.

Each pixel says where its lamp would have to stand for the surface to mirror it into the camera.  Over many pixels,
of one view or of all that a lamp lit from the same side, radiance over irradiance is highest where the lamp stands:
paint, which is in other places in each view, averages out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..data import F32, F64, I32, Camera, Light
from ..shading.brdf import angles, specular_principled
from ..shading.lights import light_sample
from .drawn_view import DrawnView
from .registration_fit import eroded

ROUGHNESS = 0.2  # of the lobe that is predicted
SAMPLES = 40_000  # pixels of a view, at most
STEEP = 0.3  # least cosine: beyond it surfaces gloss by themselves (Fresnel), and edges are near
RIM = 2  # pixels next to the outline, left out
SHARE = 0.6  # of the irradiance that must be the lamp's own
WIDE = 0.6  # of the lamp's distance: how far from its place is looked
CELLS = (41, 29, 21, 15)  # squared, over that: the most of which FILLED have LEAST pixels
LEAST, FILLED = 6, 0.5
CONTRAST = 0.5  # a highlight is so much brighter than the rest, relative
TOP, BRIGHTER = 0.005, 1.5  # share of a view's pixels that are its highlight; times its median that they must show
SPOTS, APART, WORTH = 6, 0.06, 0.1  # predicted ones: how many; how far apart, of a side; of the first one's radiance
REACH = 0.25  # of the lamp's distance: cells about the brightest that its highlight may take


@dataclass(frozen=True)
class LampVotes:
    """What N pixels of a view say of a lamp."""

    at: I32  # (N,) number of the pixel
    place: F64  # (N, 2) where the lamp would have to stand to be mirrored: beside its place, over its distance
    value: F64  # (N,) radiance over irradiance, 1/sr
    predicted: F64  # (N,) radiance of a lobe of ROUGHNESS, relative
    degrees: F64  # (N,) between normal and half vector
    axes: F64  # (2, 3) world: right and up of ``place``
    distance: float  # of the lamp from the object, metres; 1 of a SUN


@dataclass(frozen=True)
class SeenHighlight:
    """Where a view's brightest pixels are, beside where they are predicted; numbers of pixels."""

    predicted: tuple[int, ...]  # the brightest first, at most SPOTS
    seen: int | None  # None: nothing is clearly brighter than the rest
    pixels: float  # from the one that is seen to the nearest that is predicted; NaN where none is seen
    degrees: float  # between normal and half vector where it is seen; NaN as well


@dataclass(frozen=True)
class Peak:
    """Where votes are brightest."""

    place: tuple[float, float]


def distance_of(light: Light, middle: F64) -> float:
    """Metres from the object's middle; 1 for a SUN."""
    return 1.0 if light.kind == "SUN" else max(float(np.linalg.norm(light.matrix[:3, 3] - middle)), 1e-9)


def axes_of(light: Light, middle: F64, up: F64) -> F64:
    """(2, 3) right and up as seen from the lamp towards the object's middle: across its direction, ``up`` upwards."""
    away = light.matrix[:3, 2] if light.kind == "SUN" else light.matrix[:3, 3] - middle
    away = away / max(float(np.linalg.norm(away)), 1e-30)
    if abs(float(away @ up)) > 0.99:
        up = np.eye(3)[int(np.argmin(np.abs(away)))]
    right = np.cross(up, away)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(away, right)])


def lamp_votes(drawn: DrawnView, number: int, axes: F64, middle: F64) -> LampVotes:
    """Of the view's light of that number; ``middle`` (3,) of the object."""
    light = drawn.view.lights[number]
    at = np.flatnonzero(eroded(drawn.covered, RIM) & drawn.shown & (drawn.lit[number] > 0.9))
    at = at[:: max(1, -(-len(at) // SAMPLES))].astype(np.int32)
    P, N = (values.reshape(-1, 3)[at].astype(np.float64) for values in (drawn.position, drawn.normal))
    offset, _ = light_sample(light, P, 0, 1)
    reach = np.ones(len(P)) if light.kind == "SUN" else np.linalg.norm(offset, axis=-1)
    L = offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-30)
    V = towards(drawn.view.camera, P)
    seen = angles(L, V, N)
    each = irradiances(drawn, P, N, np.asarray(at, np.int32))
    total = each.sum(0)
    mirrored = 2 * (V * N).sum(-1, keepdims=True) * N - V
    across = (mirrored * L).sum(-1)
    good = seen.seen & (seen.cos_l > STEEP) & (seen.cos_v > STEEP) & (each[number] > SHARE * total) & (across > 0.3)
    where = (mirrored[good] / across[good, None] - L[good]) * reach[good, None] / distance_of(light, middle)
    lobe = specular_principled(ROUGHNESS, seen.sin2h, 0.0, seen.cos_l, seen.cos_v, seen.cos_vh) * each[number]
    return LampVotes(
        at[good], where @ axes.T, drawn.brightness.ravel()[at][good] / total[good], lobe[good],
        np.degrees(np.arcsin(np.sqrt(np.clip(seen.sin2h[good], 0, 1)))), axes, distance_of(light, middle))


def irradiances(drawn: DrawnView, P: F64, N: F64, at: I32) -> F64:
    """(K, N) of each of the view's lights, W/m^2, the mean of the channels, at pixels ``at`` (N,); lamps as points."""
    found = np.zeros((len(drawn.view.lights), len(P)))
    for n, light in enumerate(drawn.view.lights):
        offset, weight = light_sample(light, P, 0, 1)
        cosine = (offset * N).sum(-1) / np.maximum(np.linalg.norm(offset, axis=-1), 1e-30)
        found[n] = weight * np.maximum(cosine, 0) * light.power.mean() * drawn.lit[n].ravel()[at]
    return found


def irradiance(drawn: DrawnView) -> F32:
    """(h, w) of all lights together; 0 where the object is not drawn."""
    at = np.flatnonzero(drawn.covered).astype(np.int32)
    P, N = (values.reshape(-1, 3)[at].astype(np.float64) for values in (drawn.position, drawn.normal))
    whole = np.zeros(drawn.covered.size, np.float32)
    whole[at] = irradiances(drawn, P, N, at).sum(0)
    return whole.reshape(drawn.covered.shape)


def towards(camera: Camera, P: F64) -> F64:
    """(N, 3) unit vectors from places to the camera."""
    if camera.orthographic:
        return np.broadcast_to(-camera.forward, P.shape)
    offset = camera.position - P
    return np.asarray(offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-30))


def highlight_of(votes: LampVotes, size: tuple[int, int]) -> SeenHighlight:
    """Of a view, in a picture of ``size`` (width, height)."""
    y, x = np.divmod(votes.at, size[0])
    apart, spots = APART * max(size), list[int]()
    left = votes.predicted.copy()
    while len(left) and len(spots) < SPOTS and left.max() > WORTH * votes.predicted.max():
        first = int(np.argmax(left))
        near = np.hypot(x - x[first], y - y[first]) < apart
        if votes.predicted[first] >= votes.predicted[near].max():  # else it is another one's flank
            spots.append(first)
        left[near] = 0
    predicted = tuple(int(votes.at[spot]) for spot in spots)
    count = max(10, int(TOP * len(votes.at)))
    if len(votes.at) < 2 * count or not spots:
        return SeenHighlight(predicted, None, float("nan"), float("nan"))
    top = np.argpartition(votes.value, -count)[-count:]
    if not 0 < BRIGHTER * np.median(votes.value) < np.median(votes.value[top]):  # else it is black, and noise is left
        return SeenHighlight(predicted, None, float("nan"), float("nan"))
    middle = np.median(votes.place[top], axis=0)
    seen = int(top[np.argmin(np.hypot(*(votes.place[top] - middle).T))])
    pixels = min(float(np.hypot(x[seen] - x[spot], y[seen] - y[spot])) for spot in spots)
    return SeenHighlight(predicted, int(votes.at[seen]), pixels, float(votes.degrees[seen]))


def peak_of(votes: Sequence[LampVotes]) -> Peak | None:
    """Where they are brightest, views together; None where no place is clearly brighter than the others."""
    votes = [v for v in votes if len(v.value) and np.median(v.value) > 0]  # of a view that is black noise alone votes
    if not votes:
        return None
    place = np.concatenate([v.place for v in votes])
    value = np.concatenate([v.value / float(np.median(v.value)) for v in votes])
    for side in CELLS:
        cells, counts = _cells(place, value, side)
        known = counts >= LEAST
        if known.mean() > FILLED:
            break
    if known.mean() < FILLED / 4:
        return None
    grid = _smooth(cells, known)
    base = float(np.median(grid[known]))
    top = int(np.argmax(np.where(known, grid, -np.inf)))
    contrast = float(grid.ravel()[top]) / max(base, 1e-30) - 1
    if not contrast > CONTRAST:
        return None
    x, y = _centre(grid, known, base, top)
    return Peak((x, y))


def _cells(place: F64, value: F64, side: int) -> tuple[F64, F64]:
    """(side, side) median value of each cell, rows up; and how many votes it has."""
    index = np.round((place / WIDE + 1) / 2 * (side - 1)).astype(np.int64)
    inside = ((index >= 0) & (index < side)).all(-1) & np.isfinite(value)
    number, value = index[inside] @ np.array([1, side]), value[inside]
    order = np.lexsort((value, number))
    number, value = number[order], value[order]
    counts = np.bincount(number, minlength=side * side)
    first = np.cumsum(counts) - counts
    median = np.append(value, 0.0)[np.minimum(first + counts // 2, len(value))]  # of an empty cell anything
    return median.reshape(side, side), counts.reshape(side, side).astype(np.float64)


def _smooth(cells: F64, known: np.ndarray) -> F64:
    """Means over 3 x 3 cells, of those that are known."""
    total, weight = np.zeros(cells.shape), np.zeros(cells.shape)
    wide, ok = np.pad(np.where(known, cells, 0), 1), np.pad(known.astype(np.float64), 1)
    for y in range(3):
        for x in range(3):
            total += wide[y:y + cells.shape[0], x:x + cells.shape[1]]
            weight += ok[y:y + cells.shape[0], x:x + cells.shape[1]]
    return np.asarray(total / np.maximum(weight, 1))


def _centre(grid: F64, known: np.ndarray, base: float, top: int) -> tuple[float, float]:
    """The middle of what is brighter than half way up to the brightest cell, near it; over the lamp's distance."""
    at = np.linspace(-WIDE, WIDE, len(grid))
    x, y = np.meshgrid(at, at)
    half = (base + float(grid.ravel()[top])) / 2
    above = np.where(known, np.maximum(grid - half, 0), 0)
    here = np.array([x.ravel()[top], y.ravel()[top]])
    for _ in range(10):
        weight = above * (np.hypot(x - here[0], y - here[1]) < REACH)
        here = np.array([(weight * x).sum(), (weight * y).sum()]) / max(float(weight.sum()), 1e-30)
    return float(here[0]), float(here[1])
