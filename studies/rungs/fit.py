"""One material for all observations: Levenberg-Marquardt between bounds, from smaller rungs' fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from irpso_addon.core.data import F64
from studies.stability.measured.fit import CUBE_FLOOR

from .model import Geometry, Numbers, principled

STEPS, TRIALS = 20, 5
STILL = 1e-4  # relative gain of a step below which a fit is at rest
SMALLEST = 0.05  # roughness of any lobe
COLOURS = ("base", "tint")
PARENTS = {"coat and diffuse roughness": 1, "all sockets": 1}  # smaller rungs from whose fits one starts; else both
ROUGH = 0.12, 0.3, 0.6  # where roughness starts


@dataclass(frozen=True)
class Rung:
    """Numbers beside those of the smaller rung, and where they start."""

    name: str
    below: str | None
    adds: tuple[str, ...]
    starts: tuple[dict[str, float], ...]


LEVEL, METALLIC = "level", "metallic"
COAT_STARTS = tuple({"coat": w, "coat_roughness": r, **more} for w, r, more in (
    (0.3, 0.1, {}), (0.3, 0.3, {}), (0.1, 0.6, {}), (0.5, 0.2, {"roughness": 0.7, "level": 0.3})))
SHEEN_STARTS = tuple({"sheen": 0.1, "sheen_roughness": r} for r in (0.2, 0.5, 0.8))
RUNGS = {rung.name: rung for rung in (
    Rung(LEVEL, None, ("base", "roughness", "level"),
         tuple({"roughness": r, "level": s} for r in ROUGH for s in (0.1, 0.6))),
    Rung(METALLIC, LEVEL, ("metallic",),
         ({"metallic": 0.02}, {"metallic": 0.3}, *({"metallic": 0.8, "roughness": r} for r in ROUGH))),
    Rung("diffuse roughness", METALLIC, ("diffuse_roughness",),
         ({"diffuse_roughness": 0.1}, {"diffuse_roughness": 0.7}, {"diffuse_roughness": 0.5, "level": 0.3})),
    Rung("the same, no Metallic", LEVEL, ("diffuse_roughness",),
         ({"diffuse_roughness": 0.1}, {"diffuse_roughness": 0.7})),
    Rung("coat", METALLIC, ("coat", "coat_roughness"), COAT_STARTS),
    Rung("sheen", METALLIC, ("sheen", "sheen_roughness"), SHEEN_STARTS),
    Rung("specular tint", METALLIC, ("tint",), ({"tint": 0.98}, {"tint": 0.6}, {"tint": 0.6, "level": 0.8})),
    Rung("second lobe", METALLIC, ("second", "second_roughness"),
         tuple({"second": w, "second_roughness": r} for w, r in ((0.2, 0.15), (0.2, 0.4), (0.3, 0.8)))),
    Rung("coat and diffuse roughness", "coat", ("diffuse_roughness",),
         ({"diffuse_roughness": 0.1}, {"diffuse_roughness": 0.7})),
    Rung("all sockets", "coat and diffuse roughness", ("tint", "sheen", "sheen_roughness"),
         ({"tint": 0.95, "sheen": 0.1, "sheen_roughness": 0.5}, {"tint": 0.4, "sheen": 0.3, "sheen_roughness": 0.3})),
)}


@dataclass(frozen=True)
class Samples:
    """n observations of one material."""

    geometry: Geometry
    f: F64  # (n, 3), 1/sr
    weight: F64  # (n,)


def below(name: str) -> tuple[str, ...]:
    """The smaller rungs that a rung contains."""
    next_one = RUNGS[name].below
    return (next_one, *below(next_one)) if next_one else ()


def free(name: str) -> tuple[str, ...]:
    """What a rung searches."""
    rung = RUNGS[name]
    return (free(rung.below) if rung.below else ()) + rung.adds


def climb(of: Samples, table: F64 | None, names: tuple[str, ...] = tuple(RUNGS)) -> dict[str, tuple[Numbers, float]]:
    """Each rung's numbers and its loss; ``names`` from the smallest on.  A rung's loss is not above its smaller's."""
    found: dict[str, tuple[Numbers, float]] = {}
    dark = np.clip(np.pi * np.percentile(of.f, 25, axis=0), 1e-3, 0.9)
    for name in names:
        rung = RUNGS[name]
        smaller = [found[each][0] for each in below(name)[:PARENTS.get(name, 2)]] or [Numbers(base=dark)]
        tried = [descend(of, table, started(at, start), free(name)) for at in smaller for start in rung.starts]
        if rung.below:
            tried.append(found[rung.below])
        found[name] = min(tried, key=lambda x: x[1])
    return found


def started(at: Numbers, start: dict[str, float]) -> Numbers:
    """Numbers where a search starts; a grey tint."""
    return replace(at, **{name: np.full(3, value) if name in COLOURS else value for name, value in start.items()})


def descend(of: Samples, table: F64 | None, start: Numbers, names: tuple[str, ...]) -> tuple[Numbers, float]:
    """(numbers, loss): weighted mean square of the differences of cube roots of f cos_l."""
    root = np.sqrt(of.weight / of.weight.sum() / 3)[:, None]
    cosine = of.geometry.at.cos_l[:, None]
    target = np.cbrt(np.maximum(of.f, 0) * cosine + CUBE_FLOOR)

    def residual(x: F64) -> F64:
        f = principled(of.geometry, _unpack(x, names, start), table)
        return np.asarray(root * (np.cbrt(f * cosine + CUBE_FLOOR) - target))

    low = np.concatenate([np.full(3 if n in COLOURS else 1, SMALLEST if "roughness" in n and n != "diffuse_roughness"
                                  else 1e-4) for n in names])
    x = np.clip(np.concatenate([np.ravel(getattr(start, n)) for n in names]), low, 1)
    here, damping = residual(x), 1e-2
    cost = float((here**2).sum())
    for _ in range(STEPS):
        J = _jacobian(residual, x, here)
        g = J.T @ here.ravel()
        moves = ~(((x <= low) & (g > 0)) | ((x >= 1) & (g < 0)))  # the others rest on their bounds
        A = (J.T @ J)[np.ix_(moves, moves)]
        for _ in range(TRIALS):
            trial = x.copy()
            trial[moves] -= np.linalg.solve(A + np.diag(damping * np.diag(A) + 1e-12), g[moves])
            trial = np.clip(trial, low, 1)
            there = residual(trial)
            if (there**2).sum() < cost:
                break
            damping *= 6
        else:
            break
        gain = 1 - float((there**2).sum()) / cost
        x, here, cost, damping = trial, there, float((there**2).sum()), damping / 4
        if gain < STILL:
            break
    return _unpack(x, names, start), cost


def _unpack(x: F64, names: tuple[str, ...], start: Numbers) -> Numbers:
    values, k = {}, 0
    for name in names:
        wide = 3 if name in COLOURS else 1
        values[name] = x[k:k + 3] if wide == 3 else float(x[k])
        k += wide
    return replace(start, **values)


def _jacobian(residual: Callable[[F64], F64], x: F64, here: F64) -> F64:
    """(3 n, p) by differences; the base colour, x[:3], moves its own channel alone."""
    J = np.zeros((*here.shape, len(x)))
    h = np.where(x > 0.5, -1e-5, 1e-5)
    moved = x.copy()
    moved[:3] += h[:3]
    slope = (residual(moved) - here) / h[:3]
    for c in range(3):
        J[:, c, c] = slope[:, c]
    for k in range(3, len(x)):
        moved = x.copy()
        moved[k] += h[k]
        J[..., k] = (residual(moved) - here) / h[k]
    return J.reshape(-1, len(x))
