"""Roughness and base colour of texels from observations, in numpy: the fit of core/cpu_solver/solver.py.

The residual at roughnesses over the whole range, base colour in closed form at each (variable projection), then the two
deepest valleys ever finer.  A texel has several points: one roughness, a base colour each.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from ..data import F64, Bool
from ..job import Progress
from ..shading import brdf
from .observe import Seen
from .rays import Index

NODES = 48
ROUNDS = 5  # of looking closer at a valley, twice as close in each
PROBES_AT_ONCE = 1 << 18  # BRDFs of a view: bounds the memory
NOISE_FLOOR = 1e-4  # relative
NOISE_PRIOR = 4.0  # observations that the typical noise counts for beside a texel's own
WORST_SIGMA = 0.5


@dataclass(frozen=True)
class Fit:
    """What was found at N texels."""

    roughness: F64  # (N,)
    sigma: F64  # (N,) its standard error
    base: F64  # (N, 3)
    base_sigma: F64  # (N,)
    error: F64  # (N,) relative, root mean square
    observations: F64  # (N,) good ones, at one of its points


@dataclass(frozen=True)
class _Chunk:
    """The views at the points of some texels, N texels with P points each."""

    views: list[Seen]  # (N * P, ...)
    weight: F64  # (V, N * P, 3)
    texels: int
    lambert: bool

    def residual(self, roughness: F64) -> tuple[F64, F64]:
        """At roughnesses (N, J): weighted squares left (N, J), and base colour of each point (N, P, J, 3)."""
        points = len(self.views[0].cos_v) // self.texels
        r = np.repeat(roughness, points, 0)  # (S, J)
        white, with_f, all_f = (np.zeros((*r.shape, 3)) for _ in range(3))
        energies: dict[int, F64] = {}  # by camera: looking up is what takes longest
        for view, weight in zip(self.views, self.weight, strict=True):
            if view.camera not in energies:
                energies[view.camera] = brdf.principled_energy(r, view.cos_v[:, None])
            diffuse, specular = _shine(view, r, energies[view.camera], self.lambert)
            rest = view.f[:, None] - specular
            white += weight[:, None] * (diffuse * diffuse)[..., None]
            with_f += weight[:, None] * diffuse[..., None] * rest
            all_f += weight[:, None] * rest * rest
        base = np.maximum(with_f / np.maximum(white, 1e-300), 0)
        left = np.maximum(all_f - 2 * base * with_f + base * base * white, 0).mean(-1)
        shape = self.texels, points, *r.shape[1:]
        return left.reshape(shape).sum(1), base.reshape(*shape, 3)


def _shine(view: Seen, roughness: F64, energy: F64, lambert: bool) -> tuple[F64, F64]:
    """At roughnesses (S, J): what a white diffuse reflects (S, J), and the highlight (S, J, 1 or 3), 1/sr."""
    if lambert:
        return np.full(roughness.shape, 1 / np.pi), np.zeros((*roughness.shape, 1))
    cos_v = view.cos_v[:, None]
    alpha2 = (roughness**4)[..., None]
    cos_l = view.cos_l[:, None].astype(np.float64)
    roots = brdf.lambda_root(alpha2, 1 / cos_l**2 - 1) + brdf.lambda_root(alpha2, 1 / cos_v[..., None] ** 2 - 1)
    lobes = brdf.D_ggx(alpha2, view.sin2h[:, None]) / roots  # (S, J, K)
    highlight = np.einsum("sjk,skc->sjc", lobes, view.factor.astype(np.float64))
    return (1 - energy[..., 1]) / np.pi, energy[..., :1] * highlight


def fit_texels(
    views: list[Seen], at: Bool, side: int, lambert: bool,
) -> Generator[Progress, None, tuple[Fit, Index]]:
    """Every texel that has observations, and their places in the flat map.

    at: (n * side, n * side) which points are covered, ``views`` hold those; a texel has side * side, n * n texels.
    """
    weight = _weights(views)
    numbers = np.full(at.shape, -1)
    numbers[at] = np.arange(int(at.sum()))
    size = len(at) // side
    by_texel = numbers.reshape(size, side, size, side).swapaxes(1, 2).reshape(size * size, side * side)
    observed = np.append((weight > 0).any((0, 2)), False)  # the last: no point there
    where = np.flatnonzero(observed[by_texel].any(-1))
    lamps = max(view.sin2h.shape[1] for view in views)
    step = max(PROBES_AT_ONCE // (NODES * side**2 * lamps), 1)
    chunks = [where[i:i + step] for i in range(0, len(where), step)]
    searched, left, degrees = [], [], []
    for texels in chunks:
        chunk = _chunk(views, weight, by_texel[texels], lambert)
        quality = np.concatenate([v.quality.mean(-1)[None] for v in chunk.views])
        counts = (quality * (chunk.weight > 0).any(-1)).sum(0).reshape(len(texels), -1)
        searched.append((chunk, _search(chunk), counts))
        left.append(searched[-1][1][1])
        degrees.append(counts.sum(-1) - (counts > 0).sum(-1) - 1)
        yield Progress(0.9 * len(searched) / len(chunks), "solve")
    variance = _noise(np.concatenate(left), np.concatenate(degrees)) if chunks else NOISE_FLOOR**2
    parts = [_fit(chunk, best, counts, variance) for chunk, best, counts in searched]
    yield Progress(1.0, "solve")
    empty = [np.zeros((0, 3)) if name == "base" else np.zeros(0) for name in Fit.__annotations__]
    return Fit(*(np.concatenate([e, *(getattr(part, name) for part in parts)])
                 for name, e in zip(Fit.__annotations__, empty, strict=True))), where


def _weights(views: list[Seen]) -> F64:
    """(V, S, 3): quality over the squared signal, which is the observation's own in a highlight, else the typical."""
    f = np.stack([view.f for view in views]).mean(-1, keepdims=True)
    quality = np.stack([view.quality for view in views])
    known = np.where(quality.max(-1, keepdims=True) > 0, f, np.nan)
    known[:, np.isnan(known).all(0)] = 0.0
    typical = np.nanmedian(known, axis=0)
    return np.asarray(quality / np.maximum(np.maximum(f, typical), 1e-6) ** 2)


def _chunk(views: list[Seen], weight: F64, points: Index, lambert: bool) -> _Chunk:
    """The views at points (N, P) of texels; -1: none there."""
    flat = points.ravel()
    here = np.maximum(flat, 0)
    weights = np.where((flat >= 0)[None, :, None], weight[:, here], 0.0)
    cut = [replace(view, **{name: getattr(view, name)[here] for name in (
        "f", "quality", "cos_v", "sin2h", "cos_l", "factor")}) for view in views]
    return _Chunk(cut, weights, len(points), lambert)


def _search(chunk: _Chunk) -> tuple[F64, F64, F64]:
    """Roughness (N,) that fits best, the squares it leaves (N,), and those at the nodes (N, NODES)."""
    nodes = np.broadcast_to(_nodes(), (chunk.texels, NODES))
    table, _ = chunk.residual(nodes)
    around = np.pad(table, ((0, 0), (1, 1)), constant_values=np.inf)
    valley = np.where((table <= around[:, :-2]) & (table <= around[:, 2:]), table, np.inf)
    two = np.argsort(valley, axis=1)[:, :2]
    centre = np.log(_nodes())[two]  # (N, 2)
    step = np.log(1 / brdf.ROUGHNESS_MIN) / (NODES - 1)
    best = np.take_along_axis(valley, two, 1)
    for _ in range(ROUNDS):
        step /= 2
        tried = np.clip(centre[..., None] + step * np.array([-1.0, 0.0, 1.0]), np.log(brdf.ROUGHNESS_MIN), 0.0)
        left = chunk.residual(np.exp(tried.reshape(-1, 6)))[0].reshape(-1, 2, 3)
        low = left.argmin(-1)[..., None]
        centre, best = np.take_along_axis(tried, low, 2)[..., 0], np.take_along_axis(left, low, 2)[..., 0]
    which = best.argmin(1)[:, None]
    centre = np.take_along_axis(centre, which, 1)
    tried = centre + step * np.array([[-1.0, 0.0, 1.0]])
    a, b, c = chunk.residual(np.exp(tried))[0].T
    bend = a - 2 * b + c
    move = np.where(bend > 0, 0.5 * (a - c) / np.where(bend > 0, bend, 1.0), 0.0)
    at = np.clip(centre[:, 0] + step * np.clip(move, -1, 1), np.log(brdf.ROUGHNESS_MIN), 0.0)
    return np.exp(at), chunk.residual(np.exp(at)[:, None])[0][:, 0], table


def _nodes() -> F64:
    return np.geomspace(brdf.ROUGHNESS_MIN, 1.0, NODES)


def _noise(left: F64, degrees: F64) -> float:
    """Variance of an observation's relative error: the median texel's."""
    enough = degrees >= 1
    if not enough.any():
        return 0.01**2
    return max(float(np.median(left[enough] / degrees[enough])), NOISE_FLOOR**2)


def _fit(chunk: _Chunk, best: tuple[F64, F64, F64], counts: F64, typical: float) -> Fit:
    """What the texels are, and how sure; counts: (N, P) good observations."""
    r, left, table = best
    degrees = np.maximum(counts.sum(-1) - (counts > 0).sum(-1) - 1, 0)
    variance = (NOISE_PRIOR * typical + left) / (NOISE_PRIOR + degrees)  # (N,)
    nodes, beside = _nodes(), np.array([-0.02, 0.0, 0.02])
    near = np.clip(r[:, None] * (1 + beside), brdf.ROUGHNESS_MIN, 1.0)
    around, bases = chunk.residual(near)
    spread = np.maximum(np.diff(near).mean(-1), 1e-9)
    bend = (around[:, 0] - 2 * around[:, 1] + around[:, 2]) / spread**2
    narrow = np.sqrt(2 * variance / np.maximum(bend, 1e-12))
    worse = table - np.minimum(table.min(1), left)[:, None]
    chance = np.exp(-worse / (2 * variance[:, None])) * nodes  # a node is as wide as it is high
    own = np.sqrt(2 * np.pi) * np.minimum(narrow, WORST_SIGMA) * NODES / np.log(1 / brdf.ROUGHNESS_MIN)
    wide = (chance * (nodes - r[:, None]) ** 2).sum(1) / (chance.sum(1) + own)
    sigma = np.minimum(np.sqrt(np.maximum(narrow**2, wide)), WORST_SIGMA)
    share = (counts > 0) / np.maximum((counts > 0).sum(-1, keepdims=True), 1)
    base = (bases * share[:, :, None, None]).sum(1)  # (N, 3 roughnesses, 3)
    total = np.maximum(counts.sum(-1), 1e-6)
    slope = (base[:, 2] - base[:, 0]).mean(-1) / np.maximum(near[:, 2] - near[:, 0], 1e-9)
    base_sigma = np.sqrt(variance / total * base[:, 1].mean(-1) ** 2 + (slope * sigma) ** 2)
    if chunk.lambert:
        r, sigma = np.ones_like(r), np.zeros_like(sigma)
    return Fit(r, sigma, base[:, 1], np.minimum(base_sigma, WORST_SIGMA), np.sqrt(left / total),
               counts.sum(-1) / np.maximum((counts > 0).sum(-1), 1))
