"""One value for a material, settled by what is predicted of layers when they are left out.

What explains a material's texels best (`JointSearch`) lets the base colour of each take up what the lobe lacks, and
does not see what that costs under another lamp.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..data import F64, I32, Bool, Coat
from .folds import Folds, Judge, limited
from .joint_material import LEVELS, ROUGHNESS, OneMaterial
from .sampled_texels import Lobes, SampledTexels, one_lobe, predicted_apart

ROUGH, LEVEL, METALLIC, COAT_WEIGHT, COAT_ROUGH, DIFFUSE = range(6)  # numbers of a material
LOW = np.array([ROUGHNESS[0], LEVELS[0], 0.0, 0.0, ROUGHNESS[0], 0.0])
MOST = 700  # texels that take part
STEPS = 5  # of Levenberg-Marquardt
TRIALS = 3  # of a step, each shorter
STILL = 2e-3  # relative gain of a step below which the descent is at rest
SLOPE = 1e-3  # step of the differences that slopes are taken by


class ValueDescent:
    """Of the texels of a sample, with base colours found as those of a candidate are."""

    def __init__(
        self, texels: SampledTexels, folds: Folds, clusters: I32, drawn: float = 0.0, by_light: float = 0.0,
        without: int | None = None,
    ) -> None:
        """``clusters``: as of `Judge`.  ``drawn``, ``by_light``: as of `predicted`.

        ``without``: a fold whose layers are not seen at all.
        """
        if len(clusters) > MOST:
            some = np.linspace(0, len(clusters) - 1, MOST).astype(np.int32)
            texels, clusters = texels.part(some), clusters[some]
        if without is not None:
            texels = _hidden(texels, folds.left_out[without])
            folds = replace(folds, left_out=tuple(out for n, out in enumerate(folds.left_out) if n != without))
        self.texels, self.folds, self.drawn, self.by_light = texels, folds, drawn, by_light
        self.judge = Judge(texels, folds, clusters)
        self.judge.add_apart("lambert", self._predicted(None))

    def run(self, one: OneMaterial, free: tuple[int, ...]) -> Iterator[OneMaterial]:
        """What is found after each step, from ``one`` on."""
        x, at, damping = numbers_of(one), np.array(free), 1e-2
        units = self._units(x)
        here = self._residual(x, units)
        for _ in range(STEPS):
            slopes = np.stack([self._slope(x, k, here, units) for k in free])
            gradient, normal, cost = slopes @ here, slopes @ slopes.T, float(here @ here)
            for _trial in range(TRIALS):
                moved = x.copy()
                moved[at] -= np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-12), gradient)
                moved = np.clip(moved, LOW, 1.0)
                there = self._residual(moved, units)
                if there @ there < cost:
                    x, here, damping = moved, there, damping / 4
                    break
                damping *= 6
            yield material_of(x, one)
            if here @ here > (1 - STILL) * cost:
                break

    def _predicted(self, lobes: Lobes | None) -> F64:
        return predicted_apart(self.texels, lobes, self.folds.left_out, self.drawn, self.by_light)

    def _off(self, x: F64) -> tuple[F64, F64]:
        lobes = lobes_of(material_of(x, OneMaterial(1.0)), len(self.texels.cos_v))
        return self.judge.off(self._predicted(lobes), np.ones(len(self.texels.camera), bool))

    def _units(self, x: F64) -> tuple[F64, F64]:
        """(T, 1) factors by which texels' errors of radiance and of L* count: each kind as much as the other."""
        found = []
        for off in self._off(x):
            squares = (off**2).sum((1, 2))
            some = limited(squares, self.judge.clusters)
            found.append(np.sqrt(some / np.maximum(squares, 1e-30) / max(float(some.sum()), 1e-30))[:, None, None])
        return found[0], found[1]

    def _residual(self, x: F64, units: tuple[F64, F64]) -> F64:
        """(n,) of both errors."""
        return np.concatenate([(unit * off).ravel() for unit, off in zip(units, self._off(x), strict=True)])

    def _slope(self, x: F64, k: int, here: F64, units: tuple[F64, F64]) -> F64:
        h = -SLOPE if x[k] > 0.5 else SLOPE
        moved = x.copy()
        moved[k] += h
        return (self._residual(moved, units) - here) / h


def _hidden(texels: SampledTexels, layers: Bool) -> SampledTexels:
    """Without what some layers show."""
    clipped = texels.clipped
    return replace(texels, quality=np.where(layers, 0.0, texels.quality),
                   clipped=None if clipped is None else np.where(layers, 0.0, clipped))


def numbers_of(one: OneMaterial) -> F64:
    """(6,) of a material."""
    coat = one.coat or Coat(0.0, 1.0)
    return np.array([one.roughness, one.level, one.metallic, coat.weight, coat.roughness, one.diffuse])


def material_of(numbers: F64, like: OneMaterial) -> OneMaterial:
    """The reverse."""
    rough, level, metallic, weight, coat, diffuse = (float(value) for value in numbers)
    return replace(like, roughness=rough, level=level, metallic=metallic, diffuse=diffuse,
                   coat=Coat(weight, coat) if weight > 0 else None)


def lobes_of(one: OneMaterial, count: int) -> Lobes:
    """Of so many texels under one value for the material."""
    return one_lobe(np.full(count, one.roughness), one.level, one.metallic, one.coat, one.diffuse)
