"""Held-out errors: the sphere, lamps and cameras of studies/stability/measured, a third of the lamps left out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from irpso_addon.core.change_records import PredictionError
from irpso_addon.core.data import F64
from irpso_addon.core.evaluation.folds import FOLDS, WHITE, lightness
from studies.stability.measured import merl, rig

from .fit import RUNGS, Samples, climb
from .model import Geometry, Numbers, principled

TEXELS = 32  # width of the sphere's maps
NEAR, FAR = 200, 200  # observations of a fit: nearest to the highlight, and of the rest, which count for all of them


@dataclass(frozen=True)
class Shoot:
    """All observations of the sphere, n of them."""

    geometry: Geometry
    L: F64  # (n, 3)
    V: F64
    irradiance: F64  # (n,)
    weight: F64  # (n,) as the product's quality
    lamp: F64  # (n,) number


@dataclass(frozen=True)
class Found:
    """One material at one rung."""

    error: PredictionError  # of the held-out lamps, all folds together
    numbers: tuple[Numbers, ...]  # of each fold
    loss: float  # mean over the folds


def shoot(texels: int = TEXELS) -> Shoot:
    """The sphere, its maps so wide."""
    seen = rig.geometry(rig.views(rig.sphere(texels), rig.CAMERAS, rig.lamps(rig.LAMPS)))
    L, V, E, lamp = (np.concatenate(parts) for parts in zip(*[
        (v.L[v.seen], v.V[v.seen], v.irradiance[v.seen], np.full(v.seen.sum(), v.lamp)) for v in seen.views],
        strict=True))
    weight = np.concatenate([seen.quality[..., k][v.seen] for k, v in enumerate(seen.views)]).astype(np.float64)
    return Shoot(Geometry.of(L, V, np.broadcast_to(rig.NORMAL, L.shape)), L, V, E, weight, lamp)


def samples(of: Shoot, f: F64, known: np.ndarray, seed: int = 0) -> Samples:
    """What a fit sees of the observations ``known`` (n,) bool."""
    places = np.flatnonzero(known)
    order = places[np.argsort(of.geometry.at.sin2h[places])]
    rest = order[NEAR:]
    keep = np.concatenate([order[:NEAR], np.random.default_rng(seed).permutation(rest)[:FAR]])
    weight = of.weight[keep].copy()
    weight[NEAR:] *= len(rest) / max(len(keep) - NEAR, 1)
    return Samples(Geometry.of(of.L[keep], of.V[keep], np.broadcast_to(rig.NORMAL, (len(keep), 3))), f[keep], weight)


def measure(of: Shoot, truth: F64, table: F64 | None, noise: float, folds: int = FOLDS,
            names: Sequence[str] = tuple(RUNGS)) -> dict[str, Found]:
    """Rung -> what it predicts.  ``truth``: (n, 3), 1/sr; noise is relative and only in what fits see."""
    f = truth * (1 + noise * np.random.default_rng(1).standard_normal(truth.shape))
    white = np.percentile(f * of.irradiance[:, None], WHITE)
    shown: dict[str, list[tuple[Numbers, float]]] = {name: [] for name in names}
    squares = {name: np.zeros(3) for name in names}  # of errors of radiance, of radiance, of L*
    count = 0
    for fold in range(folds):
        out = of.lamp % FOLDS == fold
        held = Geometry.of(of.L[out], of.V[out], np.broadcast_to(rig.NORMAL, (int(out.sum()), 3)))
        light, count = of.irradiance[out][:, None], count + 3 * int(out.sum())
        for name, found in climb(samples(of, f, ~out, fold), table, tuple(names)).items():
            radiance = principled(held, found[0], table) * light
            off = lightness(radiance / white) - lightness(truth[out] * light / white)
            squares[name] += [((radiance - truth[out] * light) ** 2).sum(), ((truth[out] * light) ** 2).sum(),
                              (off**2).sum()]
            shown[name].append(found)
    return {name: Found(PredictionError(float(np.sqrt(s[0] / s[1])), float(np.sqrt(s[2] / count))),
                        tuple(n for n, _ in shown[name]), float(np.mean([c for _, c in shown[name]])))
            for name, s in squares.items()}


def one(network: merl.Network, table: F64, noises: dict[float, int],
        ) -> tuple[str, float, dict[float, dict[str, Found]]]:
    """A measured material: name, seconds, and by noise what each rung predicts; ``noises``: how many folds at each."""
    start, scene = time.process_time(), shoot()
    truth = network(scene.L, scene.V)
    found = {noise: measure(scene, truth, table, noise, folds) for noise, folds in noises.items()}
    return network.name, time.process_time() - start, found
