"""Rival: scipy.optimize.least_squares, one texel after the other, on a sample of texels.

All parameters, bounds, numerical Jacobian, relative errors: what one writes first.  The time of all texels is that of
the sample, scaled.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.tables import SIZE
from tests.support.texel_problem import Errors, Estimate, Problem

LEAST = 0.05
ONE = ((0.35,), (0.14,), (0.22,), (0.60,))  # roughness of the starts; the first alone, or all
TWO = ((0.25, 0.50), (0.14, 0.30), (0.20, 0.60), (0.35, 0.45))


def solve(problem: Problem, starts: int, sample: int) -> tuple[float, Errors]:
    """(seconds for all texels, errors on the sample)."""
    n = problem.spec.size**2
    chosen = np.random.default_rng(0).choice(n, sample, replace=False)
    two = problem.spec.model == "two-lobe"
    models = [_texel(problem, int(i)) for i in chosen]
    found = []
    start = time.perf_counter()
    for residual in models:
        found.append(_best(residual, TWO[:starts] if two else ONE[:starts]))
    seconds = time.perf_counter() - start
    values, truth = np.array(found), problem.truth

    def at(a: np.ndarray) -> np.ndarray:
        return np.asarray(a.reshape(n, -1)[chosen].squeeze(-1) if a.ndim == 2 else a.reshape(n, -1)[chosen])

    estimate = Estimate(values[:, :3], *values[:, 3:].T)
    lobes = [at(truth.roughness)] if truth.roughness2 is None else [at(truth.roughness), at(truth.roughness2)]
    error = np.abs(estimate.lobes() - Estimate(at(truth.base), *lobes).lobes()).max(-1)
    albedo = np.sqrt(((values[:, :3] - at(truth.base)) ** 2).mean())
    return seconds * n / sample, Errors(float(albedo), float(error.mean()), float((error > 0.1).mean()))


def _texel(problem: Problem, i: int) -> Callable[[np.ndarray], np.ndarray]:
    """The residual of one texel as a function of (R, G, B, roughness) or (R, G, B, r1, r2, weight)."""
    y, x = divmod(i, problem.spec.size)
    seen = problem.quality[y, x] > 0
    f, cos_v, lobe = (a[y, x][seen].astype(np.float64) for a in (problem.rgb, problem.cos_v, problem.lobes))
    sin2h, _, cos_l, factor = lobe[:, 0].T
    tan2l, tan2v = 1 / cos_l**2 - 1, 1 / cos_v**2 - 1
    nodes = np.linspace(0, 1, SIZE)
    table = brdf.principled_energy(nodes[:, None], cos_v[None])  # (SIZE, K, 2), made once a texel
    unit = np.maximum(f.mean(1), f.mean())[:, None]

    def reflect(r: float) -> tuple[np.ndarray, np.ndarray]:
        a2 = r**4
        at = min(r * (SIZE - 1), SIZE - 1.001)
        below = int(at)
        comp, dim = (table[below] + (at - below) * (table[below + 1] - table[below])).T
        q = sin2h * (1 - a2) + a2
        roots = np.sqrt(1 + a2 * tan2l) + np.sqrt(1 + a2 * tan2v)
        return (1 - dim) / np.pi, factor * comp * a2 / (np.pi * q * q * roots)

    def residual(p: np.ndarray) -> np.ndarray:
        a, s = reflect(p[3])
        if len(p) > 4:
            a2, s2 = reflect(p[4])
            a, s = p[5] * a + (1 - p[5]) * a2, p[5] * s + (1 - p[5]) * s2
        return np.asarray(((a[:, None] * p[:3] + s[:, None] - f) / unit).ravel())

    return residual


def _best(residual: Callable[[np.ndarray], np.ndarray], starts: tuple[tuple[float, ...], ...]) -> np.ndarray:
    two = len(starts[0]) > 1
    low, high = ([0.0] * 3 + [LEAST] * 2 + [0.0], [1.0] * 6) if two else ([0.0] * 3 + [LEAST], [1.0] * 4)
    results = [least_squares(residual, [0.5] * 3 + list(start) + [0.5] * two, bounds=(low, high)) for start in starts]
    return np.asarray(min(results, key=lambda r: r.cost).x)
