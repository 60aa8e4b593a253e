"""Assets of the study as arrays: what Cycles is given, and the maps they are painted with.  All of it are formulas.

docs/intervals.md says what was chosen on them.  Each is made of sheets: grids of quads with an island of the UV square
each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from irpso_addon.core.data import F32, F64, I32, Bool

Island = tuple[float, float, float, float]  # left, right, bottom, top in the UV square
Paint = Callable[[F64, F64], tuple[F64, F64]]  # (u, v), (n, n) each -> base colour (n, n, 3) linear, roughness (n, n)
TEXELS = 256
FINER = 4  # points a texel's side, over which its truth is the mean
MARGIN = 0.012  # of the UV square: around each island


@dataclass(frozen=True)
class Sheet:
    """A grid of quads; counter-clockwise from outside."""

    vertices: F64  # (V, 3) metres
    quads: I32  # (Q, 4), or (Q, 3) of triangles
    uvs: F64  # (Q, 4, 2), or (Q, 3, 2)
    slot: int  # of the material


@dataclass(frozen=True)
class Asset:
    """One object, how it is painted, and how its pictures are taken."""

    name: str
    words: str  # what it is, for the page
    sheets: tuple[Sheet, ...]
    paint: Paint
    levels: tuple[float, ...] = (0.5,)  # Specular IOR Level of each material slot
    pixels: int = 192
    samples: int = 4
    bounces: int = 0
    noise: float = 0.01  # of each pixel, relative
    area: float = 0.0  # metres: width of the lamps; 0: points
    finest: bool = False  # the paint alternates from texel to texel: not to be averaged
    texels: int = TEXELS  # of the maps it is painted with


def sheet(point: Callable[[F64, F64], F64], counts: tuple[int, int], island: Island, slot: int = 0) -> Sheet:
    """``point``: (N,) u and v, each 0..1 -> (N, 3); outside is where d/du x d/dv points."""
    nu, nv = counts
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, nu + 1), np.linspace(0, 1, nv + 1)))
    j, i = (a.ravel() for a in np.mgrid[:nv, :nu])
    quads = np.stack([(j + b) * (nu + 1) + i + a for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))], -1)
    left, right, bottom, top = island
    uvs = np.stack([left + (right - left) * u, bottom + (top - bottom) * v], -1)
    return Sheet(np.asarray(point(u, v)), quads.astype(np.int32), uvs[quads], slot)


def truth(asset: Asset, size: int | None = None) -> tuple[F32, F32]:
    """Base colour (n, n, 3) linear and roughness (n, n), row 0 at the bottom: means over each texel.

    ``size``: n; None: the asset's own.
    """
    size = size or asset.texels
    finer = max(TEXELS // size, 1) if asset.finest else FINER
    axis = (np.arange(finer * size) + 0.5) / (finer * size)
    base, rough = asset.paint(*np.meshgrid(axis, axis))
    blocks = (size, finer, size, finer)
    return (base.reshape(*blocks, 3).mean((1, 3)).astype(np.float32),
            rough.reshape(blocks).mean((1, 3)).astype(np.float32))


def cells(columns: int, rows: int) -> list[Island]:
    """Islands in rows, the first at the bottom left."""
    return [(i / columns + MARGIN, (i + 1) / columns - MARGIN, j / rows + MARGIN, (j + 1) / rows - MARGIN)
            for j in range(rows) for i in range(columns)]


def waves(u: F64, v: F64, seed: int, highest: float, count: int = 9) -> F64:
    """Smooth noise of mean 0 and deviation 1; ``highest``: waves across the UV square."""
    rng = np.random.default_rng(seed)
    total = np.zeros_like(u)
    for _ in range(count):
        angle, wave, phase = rng.uniform(0, np.pi), rng.uniform(0.3, 1) * highest, rng.uniform(0, 1)
        total += np.cos(2 * np.pi * (wave * (np.cos(angle) * u + np.sin(angle) * v) + phase))
    return total / np.sqrt(count / 2)


def unit(a: F64) -> F64:
    return np.asarray(a / np.linalg.norm(a, axis=-1, keepdims=True))


# ---- a knotted tube with stripes


KNOT_RADIUS, KNOT_PARTS = 0.17, 3


def knot(t: F64, turn: F64) -> F64:
    """Points of a tube about a trefoil knot; ``t`` along it and ``turn`` around it, 0..1."""
    def curve(t: F64) -> F64:
        a = 2 * np.pi * t
        return 0.3 * np.stack([np.sin(a) + 2 * np.sin(2 * a), np.cos(a) - 2 * np.cos(2 * a), -1.2 * np.sin(3 * a)], -1)
    tangent = unit(curve(t + 1e-4) - curve(t - 1e-4))
    across = unit(np.cross(tangent, [0.0, 0.0, 1.0]))  # the knot is never parallel to z
    up, angle = np.cross(across, tangent), 2 * np.pi * turn[:, None]
    return np.asarray(curve(t) + KNOT_RADIUS * (np.cos(angle) * across + np.sin(angle) * up))


def knot_paint(u: F64, v: F64) -> tuple[F64, F64]:
    """Stripes of roughness 0.15 to 0.7 that wind about the tube, in five paints with clouds."""
    phase = (3 * u + 4 * v) % 1 + 0.02 * waves(u, v, 5, 9)
    stripe = np.clip(np.floor(5 * phase), 0, 4).astype(int)
    base = np.array([(.55, .12, .08), (.07, .25, .5), (.7, .6, .35), (.12, .4, .15), (.3, .28, .3)])[stripe]
    rough = np.array([0.15, 0.45, 0.3, 0.7, 0.22])[stripe]
    return np.clip(base * (1 + 0.15 * waves(u, v, 6, 20))[..., None], 0.02, 0.9), rough


def make_knot(bounces: int) -> Asset:
    parts = tuple(
        sheet(lambda u, v, k=k: knot((k + u) / KNOT_PARTS, v), (96, 36), island)
        for k, island in enumerate(cells(1, KNOT_PARTS)))
    words = "a knotted tube with stripes of roughness 0.15 to 0.7 in five paints, point lamps"
    if bounces:
        return Asset("knot, bounced light", f"the same, path-traced with {bounces} bounces", parts, knot_paint,
                     bounces=bounces, samples=64, noise=0.0)
    return Asset("knot", words, parts, knot_paint)


# ---- a slab in relief


def slab_point(u: F64, v: F64) -> F64:
    height = 0.035 * waves(u, v, 21, 4) + 0.003 * waves(u, v, 22, 18)
    ring = np.hypot(u - 0.6, v - 0.45)
    return np.stack([1.5 * (u - 0.5), 1.5 * (v - 0.5), height + 0.1 * np.exp(-((ring - 0.22) / 0.06) ** 2)], -1)


def slab_paint(u: F64, v: F64) -> tuple[F64, F64]:
    """Roughness that varies over some ten texels, and a base colour that varies otherwise."""
    rough = np.clip(0.38 + 0.07 * waves(u, v, 31, 16, 25) + 0.05 * waves(u, v, 32, 4), 0.15, 0.9)
    shade = np.clip(0.35 + 0.1 * waves(u, v, 33, 25), 0.05, 0.9)
    return shade[..., None] * np.array([1.0, 0.75, 0.5]), rough


def make_slab() -> Asset:
    return Asset("slab", "a slab in relief, strongly curved, with a roughness that varies over some ten texels, "
                 "lamps of 0.3 m", (sheet(slab_point, (160, 160), cells(1, 1)[0]),), slab_paint,
                 pixels=224, samples=16, area=0.3)


# ---- a machine's part


def box(centre: tuple[float, float, float], size: tuple[float, float, float], islands: list[Island],
        slot: int) -> list[Sheet]:
    """Six faces, each flat."""
    found = []
    for island, (axis, sign) in zip(islands, ((a, s) for a in range(3) for s in (1, -1)), strict=True):
        across, along = (axis + 1) % 3, (axis + 2) % 3

        def point(u: F64, v: F64, axis: int = axis, sign: int = sign, x: int = across, y: int = along) -> F64:
            out = np.zeros((len(u), 3))
            out[:, axis], out[:, x], out[:, y] = 0.5 * sign, sign * (u - 0.5), v - 0.5
            return np.asarray(np.array(centre) + out * np.array(size))
        found.append(sheet(point, (4, 4), island, slot))
    return found


def cylinder(foot: tuple[float, float, float], radius: float, height: float, islands: list[Island],
             slot: int) -> list[Sheet]:
    """About z: its side and its upper end."""
    def side(u: F64, v: F64) -> F64:
        a = 2 * np.pi * u
        return np.array(foot) + np.stack([radius * np.cos(a), radius * np.sin(a), height * v], -1)

    def end(u: F64, v: F64) -> F64:  # a square's grid on a disc
        x, y = 2 * u - 1, 2 * v - 1
        disc = np.stack([x * np.sqrt(1 - y * y / 2), y * np.sqrt(1 - x * x / 2), np.zeros_like(x)], -1)
        return np.array(foot) + radius * disc + np.array([0, 0, height])
    return [sheet(side, (48, 4), islands[0], slot), sheet(end, (12, 12), islands[1], slot)]


MACHINE = (  # base colour and roughness of each slot
    ((0.5, 0.1, 0.05), 0.3), ((0.08, 0.09, 0.1), 0.55), ((0.7, 0.68, 0.6), 0.2))


def machine_paint(u: F64, v: F64) -> tuple[F64, F64]:
    """By rows of islands: enamel, rubber and a glazed plate, each a little uneven, with a worn patch here and there."""
    row = np.clip((v * 4).astype(int), 0, 3)
    slot = np.array([0, 0, 1, 2])[row]
    base = np.array([colour for colour, _ in MACHINE])[slot] * (1 + 0.1 * waves(u, v, 41, 30))[..., None]
    rough = np.array([value for _, value in MACHINE])[slot] * (1 + 0.06 * waves(u, v, 42, 8))
    worn = waves(u, v, 43, 12) > 1.3
    return np.clip(base, 0.02, 0.9), np.where(worn, rough + 0.2, rough)


def make_machine() -> Asset:
    """The rows of islands are those of `machine_paint`."""
    at = cells(6, 4)
    flat = [(cell[0], cell[1] + 1 / 6, *cell[2:]) for cell in at]
    sheets = (*box((0, 0, -0.3), (1.4, 1.0, 0.3), at[:6], 0), *box((-0.4, 0.1, 0.15), (0.35, 0.5, 0.6), at[6:12], 0),
              *cylinder((0.3, 0.2, -0.15), 0.28, 0.55, [flat[12], at[14]], 1),
              *cylinder((0.4, -0.3, -0.15), 0.12, 0.35, [at[15], at[16]], 1),
              *box((-0.4, 0.1, 0.5), (0.6, 0.7, 0.1), at[18:24], 2))
    return Asset("machine part", "boxes and cylinders with sharp edges in three materials, of Specular IOR Level 0.5, "
                 "0.25 and 0.8, point lamps", sheets, machine_paint, levels=(0.5, 0.25, 0.8))


# ---- a grille


def grille_point(u: F64, v: F64) -> F64:
    a = np.pi * (0.1 + 0.8 * (1 - u))
    return np.stack([0.62 * np.cos(a), 1.4 * (v - 0.5), 0.62 * np.sin(a) - 0.3], -1)


def grille_paint(u: F64, v: F64) -> tuple[F64, F64]:
    """Roughness 0.25 and 1.0 in turn: lines of one texel, checks of two, dots of three in matt ground, by thirds."""
    x, y = (u * TEXELS).astype(int), (v * TEXELS).astype(int)
    lines, checks = x % 2 == 1, (x // 2 + y // 2) % 2 == 1
    dots = ~((x % 5 < 3) & (y % 5 < 3))
    matt: Bool = np.select([v < 1 / 3, v < 2 / 3], [lines, checks], dots)
    return np.broadcast_to([0.4, 0.38, 0.35], (*u.shape, 3)), np.where(matt, 1.0, 0.25)


def make_grille() -> Asset:
    return Asset("grille", "half a cylinder with a grille of roughness 0.25 and 1.0 that is finer than the pixels, "
                 "point lamps", (sheet(grille_point, (96, 8), cells(1, 1)[0]),), grille_paint, pixels=128, finest=True)


ASSETS = (make_knot(0), make_knot(4), make_slab(), make_machine(), make_grille())
