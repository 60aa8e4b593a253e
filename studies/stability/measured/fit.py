"""One value for a whole material, by the loss: Levenberg-Marquardt on observations of all texels, in float64.

The product's own loss is that of shaders/solve/observations.glsl; the others are those by which measured materials
have been fitted.  f is compared times cos_l where a loss does not make it relative, because that is what is seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from irpso_addon.core.data import F64
from irpso_addon.core.shading import brdf, tables

from .merl import fresnel, v_grooves
from .rig import NORMAL, View

LOSSES = ("relative", "squares", "log", "cube root", "robust")
NEAR, FAR = 600, 600  # observations: nearest to the highlight, and of the rest
STEPS = 15
CUBE_FLOOR = 1e-3  # 1/sr: the cube root's slope is not steeper than here
CAUCHY = 2.385  # standard deviations: 95 % efficient on normal errors


@dataclass(frozen=True)
class Samples:
    """Observations of one material, n of them."""

    L: F64  # (n, 3)
    V: F64
    f: F64  # (n, 3)
    weight: F64  # (n,)


def samples(views: Sequence[View], rgb: np.ndarray, quality: np.ndarray, seed: int = 0) -> Samples:
    """The observations nearest to the half vector, and some of the others, which count for all of them."""
    seen = [view.seen for view in views]
    L, V = (np.concatenate([getattr(v, name)[s] for v, s in zip(views, seen, strict=True)]) for name in "LV")
    f = np.concatenate([rgb[..., k, :][s] for k, s in enumerate(seen)]).astype(np.float64)
    weight = np.concatenate([quality[..., k][s] for k, s in enumerate(seen)]).astype(np.float64)
    order = np.argsort(brdf.angles(L, V, NORMAL).sin2h)
    rest = order[NEAR:]
    chosen = np.random.default_rng(seed).permutation(rest)[:FAR]
    keep = np.concatenate([order[:NEAR], chosen])
    more = np.ones(len(keep))
    more[NEAR:] = len(rest) / max(len(chosen), 1)
    return Samples(L[keep], V[keep], f[keep], weight[keep] * more)


# ---- models: by_channel (p, 3) and shared (q,) numbers, each between bounds

Evaluate = Callable[[brdf.Angles, F64, F64], F64]


@dataclass(frozen=True)
class Model:
    """What is fitted."""

    evaluate: Evaluate  # (angles, by channel (p, 3), shared (q,)) -> f (n, 3)
    by_channel: tuple[tuple[float, float], ...]  # bounds
    shared: tuple[tuple[float, float], ...]
    starts: tuple[tuple[float, ...], ...]  # of the shared


def _one_lobe(at: brdf.Angles, base: F64, shared: F64) -> F64:
    r, level = shared if len(shared) == 2 else (shared[0], 0.5)
    comp, taken = tables.energy(tables.energy_nodes(), np.full_like(at.cos_v, r), at.cos_v, level).T
    lobe = _masked(at, r) * brdf.F_level(at.cos_vh, level) * comp
    return np.asarray(base[0] * ((1 - taken) / np.pi)[:, None] + lobe[:, None])


def _metal(at: brdf.Angles, base: F64, shared: F64) -> F64:
    """Principled with Metallic 1: Schlick's Fresnel about the base colour, Kulla and Conty's multiple scattering."""
    r, nodes = shared[0], tables.energy_nodes()
    lobe = tables.bilinear(nodes.albedo, np.full_like(at.cos_v, r), at.cos_v)[:, None]
    mean = np.interp(r, np.linspace(0, 1, len(nodes.mean)), nodes.mean)
    single = base + (1 - base) / 21
    multiple = single * mean / (1 - single * (1 - mean))
    schlick = base + (1 - base) * (1 - at.cos_vh[:, None]) ** 5
    return np.asarray(_masked(at, r)[:, None] * schlick * (1 + multiple * (1 / lobe - 1)))


def _metallic(at: brdf.Angles, base: F64, shared: F64) -> F64:
    metallic = shared[2]
    return np.asarray(metallic * _metal(at, base, shared[:1]) + (1 - metallic) * _one_lobe(at, base, shared[:2]))


def _masked(at: brdf.Angles, r: float) -> F64:
    """D G2 / (4 cos_l cos_v)."""
    a2 = r**4
    roots = brdf.lambda_root(a2, 1 / at.cos_l**2 - 1) + brdf.lambda_root(a2, 1 / at.cos_v**2 - 1)
    return np.asarray(brdf.D_ggx(a2, at.sin2h) / (2 * at.cos_l * at.cos_v * roots))


def _cook_torrance(at: brdf.Angles, scales: F64, shared: F64) -> F64:
    m, eta = shared
    cos2h = np.maximum(1 - at.sin2h, 1e-12)
    D = np.exp(-at.sin2h / (m * m * cos2h)) / (m * m * cos2h**2)
    lobe = D * fresnel(at.cos_vh, eta) * v_grooves(np.sqrt(cos2h), at.cos_l, at.cos_v, at.cos_vh)
    return np.asarray(scales[0] / np.pi + scales[1] * (lobe / (np.pi * at.cos_l * at.cos_v))[:, None])


ROUGH, LEVEL = (0.05, 1.0), (0.001, 1.0)
MODELS = {
    "one-lobe": Model(_one_lobe, ((0, 1),), (ROUGH,), ((0.12,), (0.3,), (0.6,))),
    "one-lobe-specular": Model(_one_lobe, ((0, 1),), (ROUGH, LEVEL), ((0.12, 0.5), (0.3, 0.5), (0.6, 0.5))),
    "metal": Model(_metal, ((0, 1),), (ROUGH,), ((0.12,), (0.3,), (0.6,))),
    "metallic": Model(_metallic, ((0, 1),), (ROUGH, LEVEL, (0, 1)),
                      ((0.12, 0.5, 0.3), (0.3, 0.5, 0.3), (0.6, 0.5, 0.3))),
    "cook-torrance": Model(_cook_torrance, ((0, 1.5), (0, 50)), ((0.003, 1.0), (1.05, 20)),
                           ((0.02, 1.5), (0.1, 1.5), (0.4, 1.5))),
}


def fit(name: str, of: Samples, loss: str, scale: float = 0.0) -> Fitted:
    """The best of a model's starts; ``scale``: of the loss "robust", see ``scale_of``."""
    model, at = MODELS[name], brdf.angles(of.L, of.V, NORMAL)
    compare = _compare(loss, at, of, scale)
    found = []
    for start in model.starts:
        by_channel = np.zeros((len(model.by_channel), 3))
        by_channel[0] = np.clip(np.pi * np.percentile(of.f, 25, axis=0), 1e-3, 0.9)
        by_channel[1:] = 0.2
        found.append(_descend(model, at, compare, by_channel, np.array(start)))
    return Fitted(name, *min(found, key=lambda x: x[2]))


@dataclass(frozen=True)
class Fitted:
    """A fit, as something that can be shown."""

    model: str
    by_channel: F64  # (p, 3)
    shared: F64  # (q,)
    loss: float

    def __call__(self, L: F64, V: F64) -> F64:
        """The BRDF, 1/sr, of (n, 3) directions."""
        return MODELS[self.model].evaluate(brdf.angles(L, V, NORMAL), self.by_channel, self.shared)


def _descend(model: Model, at: brdf.Angles, compare: Callable[[F64], F64], by_channel: F64, shared: F64,
             ) -> tuple[F64, F64, float]:
    """Levenberg-Marquardt between bounds; derivatives by differences, all channels' at once."""
    low, high = _bounds(model)
    p = by_channel.size
    x = np.concatenate([by_channel.ravel(), shared])

    def residual(x: F64) -> F64:
        return compare(model.evaluate(at, x[:p].reshape(-1, 3), x[p:]))

    here, damping = residual(x), 1e-2
    cost = (here**2).sum()
    for _ in range(STEPS):
        J = _jacobian(residual, x, here, p)
        A, g = J.T @ J, J.T @ here.ravel()
        for _ in range(6):
            step = np.linalg.solve(A + np.diag(damping * np.diag(A) + 1e-12), -g)
            trial = np.clip(x + step, low, high)
            there = residual(trial)
            if (there**2).sum() < cost:
                break
            damping *= 6
        else:
            break
        gain = 1 - (there**2).sum() / cost
        x, here, cost, damping = trial, there, (there**2).sum(), damping / 4
        if gain < 1e-6:
            break
    return x[:p].reshape(-1, 3), x[p:], float(cost)


def _jacobian(residual: Callable[[F64], F64], x: F64, here: F64, p: int) -> F64:
    """(3 n, p + q); a number by channel moves its channel alone, so three are tried at once."""
    J = np.zeros((*here.shape, len(x)))
    for k in range(0, p, 3):
        h = 1e-6 * np.maximum(x[k:k + 3], 1e-2)
        moved = x.copy()
        moved[k:k + 3] += h
        slope = (residual(moved) - here) / h
        for c in range(3):
            J[:, c, k + c] = slope[:, c]
    for k in range(p, len(x)):
        h = 1e-6 * max(x[k], 1e-2)
        moved = x.copy()
        moved[k] += h
        J[..., k] = (residual(moved) - here) / h
    return J.reshape(-1, len(x))


def _bounds(model: Model) -> tuple[F64, F64]:
    rows = [b for b in model.by_channel for _ in range(3)] + list(model.shared)
    low, high = np.array(rows, np.float64).T
    return low, high


def _compare(loss: str, at: brdf.Angles, of: Samples, scale: float) -> Callable[[F64], F64]:
    """Residuals (n, 3), whose squares are summed."""
    root = np.sqrt(of.weight / of.weight.sum())[:, None]
    cosine = at.cos_l[:, None]
    if loss == "squares":
        return lambda f: root * cosine * (f - of.f)
    if loss == "log":
        return lambda f: root * (np.log1p(np.maximum(f, 0) * cosine) - np.log1p(np.maximum(of.f, 0) * cosine))
    if loss == "cube root":
        def cube(f: F64) -> F64:
            return np.asarray(np.cbrt(np.maximum(f, 0) * cosine + CUBE_FLOOR))
        return lambda f: root * (cube(f) - cube(of.f))
    unit = np.maximum(of.f.mean(-1), typical(of))[:, None]
    relative = root / unit
    if loss == "relative":
        return lambda f: relative * (f - of.f)
    return lambda f: root * CAUCHY * scale * np.sqrt(np.log1p(((f - of.f) / (unit * CAUCHY * scale)) ** 2))


def typical(of: Samples) -> float:
    """The signal below which errors are no longer relative, as shaders/solve/observations.glsl finds it."""
    f, value = np.maximum(of.f.mean(-1), 0), 1.0
    for step in range(4):
        w = of.weight / (1.0 if step == 0 else np.maximum(f, value))
        value = max(float((w * f).sum() / w.sum()), 1e-4)
    return value


def scale_of(fitted: Fitted, of: Samples) -> float:
    """Standard deviation of the relative errors that a fit leaves in most observations."""
    off = np.abs(fitted(of.L, of.V) - of.f) / np.maximum(of.f.mean(-1), typical(of))[:, None]
    return max(1.4826 * float(np.median(off)), 1e-3)
