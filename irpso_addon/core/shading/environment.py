"""Light from all around as weighted directions, and what the specular lobe returns of it over nodes of roughness.

Float64 twin of ``shaders/observe/environment.frag`` and ``shaders/include/node_curve.glsl``.

An environment becomes directions by cuts that leave the least variance (after Debevec 2005, "A Median Cut Algorithm
for Light Probe Sampling"; here each cut minimises the spread of light about the cells' mean directions).  A direction
keeps its cell's spread, which widens the lobe that sees it.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..data import F32, F64, Bool, Environment
from . import brdf

COUNT = 512  # directions: the error of radiance is below 1 % (docs/environment.md)
SHADOW_SIDE = 256  # texels of a direction's shadow map
NODES = 12  # of roughness, even in its logarithm from ROUGHNESS_MIN to 1
NODES_AT_ONCE = NODES // 2  # in one draw: with irradiance, not more than the eight targets that OpenGL 3.3 has
NODE_COLUMNS = 4  # of them side by side in a texture, ...
NODE_ROWS = NODES // NODE_COLUMNS  # ... and one above the other
NODE_ROUGHNESS: tuple[float, ...] = tuple(float(r) for r in np.geomspace(brdf.ROUGHNESS_MIN, 1.0, NODES))
WIDTH = 1024  # pixels: environments are reduced to this before they are cut
WIDTH_UNDIVIDED = 256  # of directions that do not divide
DIM = 0.05  # share of the mean radiance that is added where cells are chosen: dim parts are seen by sharp lobes, too
LEAST = 1e-9  # 1/sr: below, logarithms are cut
PARTS = 4  # into which a direction is divided where a lobe is as sharp as its spread, and each of those again, ...
LEVELS = 5  # ... so many times
SHARP = 0.03  # of the half vector's sin^2 to the normal plus alpha^2: a variance from which on that is so

Cells = NDArray[np.int64]  # (N, 4) bottom, top, left, right of rectangles of a picture
Index = NDArray[np.int64] | int


@dataclass(frozen=True)
class Directions:
    """N directions that stand for an environment, in world space."""

    toward: F64  # (N, 3) unit, to the light
    power: F64  # (N, 3) W/m^2 on a surface that faces it, linear RGB
    spread: F64  # (N,) radians: standard deviation of its light about it, along each of two axes
    parts: Directions | None = None  # PARTS of each direction, one direction's after the other's; power 0: none
    near: float = np.inf  # variance from which on its parts replace a direction whatever the lobe

    def turned(self, by: float) -> Directions:
        """The light turned by so many radians about Z, against the clock as seen from above."""
        return Directions(self.toward @ about_z(by), self.power, self.spread, self.parts and self.parts.turned(by))


def about_z(turn: float) -> F64:
    """(3, 3) directions in the world to those in which the light shone before it was turned, radians."""
    cos, sin = float(np.cos(turn)), float(np.sin(turn))
    return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def texel_directions(height: int, width: int) -> tuple[F64, F64]:
    """((h, w, 3) unit directions, (h, 1) solid angle of each) of an equirectangular picture, row 0 at the bottom.

    Blender's mapping: u = 1/2 - atan2(y, x) / (2 pi), v = 1/2 + asin(z) / pi (Cycles, direction_to_equirectangular).
    """
    rows = np.pi * (np.arange(height + 1) / height - 0.5)
    latitude = (rows[1:] + rows[:-1])[:, None] / 2
    longitude = 2 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)[None]
    flat = np.cos(latitude)
    unit = np.stack([flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude) + 0 * longitude], -1)
    return unit, (np.diff(np.sin(rows)) * 2 * np.pi / width)[:, None]


def directions(environment: Environment, count: int = COUNT, divides: bool = True) -> Directions:
    """At most ``count`` directions; fewer where the environment has fewer pixels, or is black.

    ``divides``: whether they have parts; those that have none need no pixels as small.
    """
    radiance = reduced(environment.radiance, WIDTH if divides else WIDTH_UNDIVIDED).astype(np.float64)
    unit, solid = texel_directions(*radiance.shape[:2])
    grey = radiance.mean(-1)
    chosen_by = (grey + DIM * float((grey * solid).sum() / (4 * np.pi))) * solid
    cells = _cells(_summed(np.concatenate([chosen_by[..., None], chosen_by[..., None] * unit], -1)), count)
    light = radiance * solid[..., None]
    weight = light.mean(-1, keepdims=True)
    table = _summed(np.concatenate([light, weight, weight * unit], -1))
    cells = _neighbours_together(cells[_sums(table, *cells.T)[:, 3] > 0])
    levels = [cells]
    for _ in range(LEVELS if divides else 0):
        levels.append(_halved(levels[-1], PARTS))
    parts = None
    for level in reversed(levels):
        parts = _of_cells(table, level, environment.rotation, parts)
    assert parts is not None
    return parts


def _of_cells(table: F64, cells: Cells, rotation: F64, parts: Directions | None = None) -> Directions:
    """The mean direction of each of (N, 4) cells, from sums of (R, G, B, weight, weight times direction)."""
    sums = _sums(table, *cells.T)
    length = np.linalg.norm(sums[:, 4:], axis=1)
    some = sums[:, 3] > 1e-12 * table[-1, -1, 3]  # sums are differences of sums
    mean = np.where(some, np.minimum(length / np.where(some, sums[:, 3], 1.0), 1.0), 1.0)
    toward = np.where(some[:, None], sums[:, 4:] / np.maximum(length, 1e-300)[:, None], np.array([0.0, 0.0, 1.0]))
    power = np.where(some[:, None], np.maximum(sums[:, :3], 0) * mean[:, None], 0.0)
    return Directions(toward @ rotation, power, np.sqrt(1 - mean), parts)  # picture to world


def _halved(cells: Cells, count: int) -> Cells:
    """(N count, 4): each cell in halves across its longer side, and those again, until there are ``count``."""
    while count > 1:
        bottom, top, left, right = cells.T
        rows = top - bottom >= right - left
        middle = np.where(rows, bottom + top, left + right) // 2
        one = np.stack([bottom, np.where(rows, middle, top), left, np.where(rows, right, middle)], -1)
        two = np.stack([np.where(rows, middle, bottom), top, np.where(rows, left, middle), right], -1)
        cells, count = np.stack([one, two], 1).reshape(-1, 4), count // 2
    return cells


def reduced(picture: F32, width: int) -> F32:
    """(h, w, C) with at most so many columns: means over whole blocks of pixels."""
    step = -(-picture.shape[1] // width)
    if step == 1:
        return picture
    height, columns = picture.shape[0] // step * step, picture.shape[1] // step * step
    if (height, columns) != picture.shape[:2]:  # no whole blocks: the nearest pixels of a picture that has
        y = (np.arange(-(-picture.shape[0] // step) * step) + 0.5) / (-(-picture.shape[0] // step) * step)
        x = (np.arange(-(-picture.shape[1] // step) * step) + 0.5) / (-(-picture.shape[1] // step) * step)
        picture = picture[(y * picture.shape[0]).astype(int)][:, (x * picture.shape[1]).astype(int)]
    blocks = picture.reshape(picture.shape[0] // step, step, picture.shape[1] // step, step, picture.shape[2])
    return np.asarray(blocks.mean((1, 3), dtype=np.float64), np.float32)


def _summed(values: F64) -> F64:
    """(h + 1, w + 1, C) sums over all rows and columns before."""
    table = np.zeros((values.shape[0] + 1, values.shape[1] + 1, values.shape[2]))
    inner = table[1:, 1:]
    values.cumsum(0, out=inner)
    inner.cumsum(1, out=inner)
    return table


def _sums(table: F64, bottom: Index, top: Index, left: Index, right: Index) -> F64:
    """(N, C) over rectangles."""
    return np.asarray(table[top, right] - table[bottom, right] - table[top, left] + table[bottom, left])


def _cost(sums: F64) -> F64:
    """How far light lies from its mean direction: W - |sum w d|; sums: (N, 4) of w and w d."""
    return np.asarray(sums[..., 0] - np.linalg.norm(sums[..., 1:], axis=-1))


def _best_cut(table: F64, cell: tuple[int, int, int, int]) -> tuple[float, bool, int]:
    """(what the best cut gains, whether it is across rows, where)."""
    bottom, top, left, right = cell
    whole = float(_cost(_sums(table, *(np.array([side]) for side in cell)))[0])
    best = (-1.0, True, 0)
    for rows, (low, high) in ((True, (bottom, top)), (False, (left, right))):
        at = np.arange(low + 1, high)
        if not len(at):
            continue
        if rows:
            one, two = _sums(table, bottom, at, left, right), _sums(table, at, top, left, right)
        else:
            one, two = _sums(table, bottom, top, left, at), _sums(table, bottom, top, at, right)
        cost = _cost(one) + _cost(two)
        k = int(cost.argmin())
        best = max(best, (whole - float(cost[k]), rows, int(at[k])))
    return best


def _cells(table: F64, count: int) -> Cells:
    """(N, 4) rectangles: bottom, top, left, right; the one that gains most is cut next."""
    height, width = table.shape[0] - 1, table.shape[1] - 1
    heap = [(-gain, (0, height, 0, width), rows, at) for gain, rows, at in [_best_cut(table, (0, height, 0, width))]]
    whole: list[tuple[int, int, int, int]] = []
    while heap and len(heap) + len(whole) < count:
        gain, cell, rows, at = heapq.heappop(heap)
        if gain >= 0:  # one pixel, or black
            whole.append(cell)
            continue
        bottom, top, left, right = cell
        halves = [(bottom, at, left, right), (at, top, left, right)] if rows else [
            (bottom, top, left, at), (bottom, top, at, right)]
        for half in halves:
            found, across, place = _best_cut(table, half)
            heapq.heappush(heap, (-found, half, across, place))
    return np.array([*whole, *(cell for _, cell, _, _ in heap)])


def _neighbours_together(cells: Cells) -> Cells:
    """Sorted by the interleaved digits of their middles (Morton 1966).

    Pixels that a device computes together divide neighbouring cells, and so do it in one batch of directions.
    """
    y, x = cells[:, :2].sum(1), cells[:, 2:].sum(1)
    order = sum((y >> k & 1) << 2 * k + 1 | (x >> k & 1) << 2 * k for k in range((2 * WIDTH).bit_length()))
    return cells[np.argsort(order, kind="stable")]


def environment_irradiance(light: Directions, normal: F64) -> F64:
    """(T, 3) W/m^2, without shadows, on surfaces of (T, 3) unit normals."""
    return np.asarray(_above(normal @ light.toward.T, light.spread) @ light.power)


def clamped_mean(middle: F64, half_width: F64 | float) -> F64:
    """Mean of max(x, 0) where x is spread evenly about a middle, so far to both sides."""
    across = (middle + half_width) ** 2 / np.maximum(4 * half_width, 1e-12)
    return np.where(np.abs(middle) < half_width, across, np.maximum(middle, 0.0))


def _above(cosine: F64, spread: F64) -> F64:
    """Of what lies across the horizon only a part is above."""
    return clamped_mean(cosine, spread * np.sqrt(3 * np.maximum(1 - cosine**2, 0)))


def node_values(light: Directions, N: F64, V: F64, lit: F64 | None = None) -> tuple[F64, F64, F64]:
    """Of one place: (irradiance (3,), radiance that the lobe sends to V (NODES, 3), the same without Fresnel (NODES,)).

    W/m^2 and W/(m^2 sr), without the gain by multiple scattering; the last is the mean of the channels.
    ``lit``: (N,) share of each direction's light that arrives, for the parts as for the whole.
    """
    draws = [_drawn(light, N, V, lit, NODE_ROUGHNESS[first:first + NODES_AT_ONCE])
             for first in range(0, NODES, NODES_AT_ONCE)]
    irradiance, sent, plain = zip(*draws, strict=True)
    return irradiance[0], np.concatenate(sent), np.concatenate(plain)


def _drawn(light: Directions, N: F64, V: F64, lit: F64 | None, nodes: Sequence[float]) -> tuple[F64, F64, F64]:
    """As `node_values`, of nodes of rising roughness: the first decides which directions are divided."""
    arrives = light.power if lit is None else light.power * lit[:, None]
    wide = _wide(light, N, V, nodes[0])
    values = _summed_lobes(light.toward[~wide], arrives[~wide], light.spread[~wide], N, V, nodes)
    if light.parts is not None and wide.any():
        count = len(light.parts.toward) // len(light.toward)
        chosen = np.repeat(wide, count)
        parts = _chosen(light.parts, chosen)
        more = _drawn(parts, N, V, None if lit is None else np.repeat(lit, count)[chosen], nodes)
        values = values[0] + more[0], values[1] + more[1], values[2] + more[2]
    return values


def _chosen(light: Directions, which: Bool) -> Directions:
    parts = light.parts
    if parts is not None:
        parts = _chosen(parts, np.repeat(which, len(parts.toward) // len(light.toward)))
    return Directions(light.toward[which], light.power[which], light.spread[which], parts, light.near)


def _wide(light: Directions, N: F64, V: F64, roughness: float) -> Bool:
    """(N,) directions of which the lobe of a roughness sees more than where they are."""
    if light.parts is None:
        return np.zeros(len(light.toward), bool)
    H = light.toward + V
    square = np.maximum((H * H).sum(-1), 1e-12)
    sin2h = (np.cross(N, H) ** 2).sum(-1) / square
    seen = (light.spread**2 / square > SHARP * (sin2h + roughness**4)) | (light.spread**2 > light.near)
    return np.asarray((light.toward @ N > -2 * light.spread) & seen)


def _summed_lobes(
    L: F64, arrives: F64, sigma: F64, N: F64, V: F64, nodes: Sequence[float],
) -> tuple[F64, F64, F64]:
    """As `node_values`, of directions as they are; ``arrives``: (N, 3) W/m^2 on what faces them."""
    cos_l, cos_v = _above(L @ N, sigma), float(np.clip(N @ V, 1e-3, 1))
    up = cos_l > 0
    L, cos_l, sigma = L[up], np.clip(cos_l[up], 1e-3, 1), sigma[up]
    arrives = arrives[up] * cos_l[:, None]
    H = L + V
    length = np.linalg.norm(H, axis=1)
    H = H / length[:, None]
    sin2h = (np.cross(N, H) ** 2).sum(-1)
    variance = (sigma / length) ** 2  # of the half vector, along each of two axes: a quarter of a disc's radius^2
    shape = np.stack([brdf.lobe_ggx(r, sin2h, 4 * variance, cos_l, cos_v) for r in nodes])
    sent = (shape * brdf.F_dielectric((H * V).sum(-1))) @ arrives
    return arrives.sum(0), sent, shape @ arrives.mean(-1)


def at_roughness(nodes: F64, roughness: F64 | float) -> F64:
    """(...) from (..., NODES) values at NODE_ROUGHNESS: Catmull and Rom's cubic through their logarithms."""
    return at_roughness_of_logs(np.log(np.maximum(nodes, LEAST)), roughness)


def at_roughness_of_logs(logs: F64, roughness: F64 | float) -> F64:
    """The same of logarithms, not below that of LEAST."""
    k, t = _place(roughness)
    weights = ((0.5 * t * (-1 + t * (2 - t)))[..., None] * _BEFORE[k]
               + (1 + t**2 * (1.5 * t - 2.5))[..., None] * _EYE[k]
               + (0.5 * t * (1 + t * (4 - 3 * t)))[..., None] * _EYE[k + 1]
               + (0.5 * t**2 * (t - 1))[..., None] * _AFTER[k])
    return np.exp(_weighed(logs, weights))


def cosine_at(cosines: F64, roughness: F64 | float) -> F64:
    """(...) between (..., NODES) values of V.H at NODE_ROUGHNESS."""
    k, t = _place(roughness)
    return np.clip(_weighed(cosines, (1 - t)[..., None] * _EYE[k] + t[..., None] * _EYE[k + 1]), 0, 1)


# Weights of the nodes that give a node's value, and those of the one before and of the one after the next: beyond the
# ends a straight line.
_EYE = np.eye(NODES)
_BEFORE = np.concatenate([2 * _EYE[:1] - _EYE[1:2], _EYE[:-2]])
_AFTER = np.concatenate([_EYE[2:], 2 * _EYE[-1:] - _EYE[-2:-1]])


def _place(roughness: F64 | float) -> tuple[NDArray[np.int64], F64]:
    """Between which nodes, the lower one's number and how far on to the next."""
    least = brdf.ROUGHNESS_MIN
    at = np.log(np.clip(roughness, least, 1.0) / least) * (NODES - 1) / np.log(1 / least)
    k = np.minimum(np.asarray(at).astype(np.int64), NODES - 2)
    return k, np.asarray(at - k)


def _weighed(values: F64, weights: F64) -> F64:
    """(...) of (..., NODES) values and weights, which broadcast to each other."""
    return np.asarray(np.einsum("...n,...n->...", values, weights))
