"""How many directions an environment needs: radiance of a sphere against the sum over all pixels of the picture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from irpso_addon.core.data import F64, Environment
from irpso_addon.core.shading import brdf, environment
from studies.environment.hdris import KINDS, radiance

HEIGHT, PLACES, BASE = 256, 60, 0.5
# Directions, whether they divide:
SETTINGS = ((1024, False), (4096, False), (256, True), (environment.COUNT, True), (1024, True))


@dataclass(frozen=True)
class Convergence:
    """Relative error of radiance at 90 % of the places, at each of NODE_ROUGHNESS, of the worst environment."""

    count: int
    divided: bool
    errors: tuple[float, ...]


def convergence() -> Iterator[Convergence]:
    """Of each setting."""
    toward, solid = environment.texel_directions(HEIGHT, 2 * HEIGHT)
    skies = [Environment(kind, radiance(toward, kind).astype(np.float32), np.eye(3)) for kind in KINDS]
    places = list(_places())
    points = np.zeros(solid.size * toward.shape[1])
    exact = [environment.Directions(
        toward.reshape(-1, 3), (sky.radiance * solid[..., None]).reshape(-1, 3).astype(float), points) for sky in skies]
    truth = [[_radiance(of, *place) for place in places] for of in exact]
    for count, divided in SETTINGS:
        worst = np.zeros(environment.NODES)
        for sky, wanted in zip(skies, truth, strict=True):
            light = environment.directions(sky, count)
            light = light if divided else replace(light, parts=None)
            found = np.array([_radiance(light, *place) for place in places])
            worst = np.maximum(worst, np.quantile(np.abs(found / np.array(wanted) - 1), 0.9, axis=0))
        yield Convergence(count, divided, tuple(worst.tolist()))


def _places() -> Iterator[tuple[F64, F64]]:
    """Normals of a sphere, and the direction to the camera."""
    rng, view = np.random.default_rng(0), np.array([0, -1.0, 0.2]) / np.linalg.norm([0, -1.0, 0.2])
    normals = rng.normal(size=(4 * PLACES, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for normal in normals[normals @ view > 0.15][:PLACES]:
        yield normal, view


def _radiance(light: environment.Directions, normal: F64, view: F64) -> F64:
    """(NODES,) mean of the channels."""
    irradiance, sent, _ = environment.node_values(light, normal, view)
    gain, taken = np.moveaxis(brdf.principled_energy(np.array(environment.NODE_ROUGHNESS), float(normal @ view)), -1, 0)
    return np.asarray(BASE * (1 - taken) / np.pi * irradiance.mean() + gain * sent.mean(-1))
