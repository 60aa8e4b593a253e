"""The level and Metallic that texels share, which differ in roughness, by Levenberg-Marquardt.

A roughness acts on the residuals of its own texels alone, one or those of a part.  So the normal equations are solved
for what is shared, with the roughnesses eliminated (Schur complement; Triggs et al. 2000, "Bundle Adjustment - A Modern
Synthesis", section 6.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data import F64, I32, Bool
from ..shading import brdf
from .descent import LEAST_NUMBER, SOME_METALLIC, TRIALS, Descent
from .lobe_values import fresnel_ratio, metal_values
from .sampled_texels import LEAST, SampledTexels

HELD_TOGETHER = 1.0  # nats per squared log ratio: how far texels may depart while their level is sought
STEPS = 10
STILL = 1e-3  # relative gain of a step below which a search is at rest
SLOPE = 1e-5  # step of the differences that slopes are taken by


@dataclass(frozen=True)
class _Held:
    """What residuals and roughnesses cost."""

    noise: float  # variance of a weighted residual
    pull: float  # towards the centre of the logarithms of roughness
    centre: float

    def cost(self, residual: F64, log: F64) -> float:
        """In nats, times 2."""
        return float((residual**2).sum() / self.noise + self.pull * ((log - self.centre) ** 2).sum())


class ApartDescent:
    """Of the texels of a sample and the weights of their squared residuals, from its ``known`` layers, (V,).

    ``group``: (T,) whose roughness a texel has; None: its own.  ``diffuse``: (T, V, C) gain of a diffuse, 1 of a smooth
    one, or what broadcasts to that.  ``least``: roughness.
    """

    def __init__(
        self, texels: SampledTexels, weight: F64, known: Bool, diffuse: F64, group: I32 | None = None,
        least: float = brdf.ROUGHNESS_MIN,
    ) -> None:
        self.descent = Descent(texels, weight, np.zeros(0))
        self.descent.layers = known, ()
        self.group = np.arange(len(texels.cos_v), dtype=np.int32) if group is None else group
        self.diffuse, self.least = diffuse, np.log(least)
        self.low = np.array([LEAST_NUMBER, 0.0])

    def run(self, start: F64, roughness: F64, centre: float | None = None) -> tuple[F64, F64]:
        """((level, Metallic), roughness), from a ``start``; a Metallic of 0 is kept.

        ``roughness``: (G,) to begin with.  ``centre``: about which they lie; None: anywhere.
        """
        free = [0, 1] if start[1] > SOME_METALLIC else [0]
        x, log = start.copy(), np.log(roughness)
        here = self._residual(log, x)
        if len(free) > 1:
            self.descent.base = self._explained(log, x)[2]
            here = self._residual(log, x)
        known = self.descent.layers[0]
        degrees, damping = np.maximum((self.descent.root[:, known] > 0).sum((1, 2)) - 2, 1), 1e-2
        pull = 0.0 if centre is None else 2 * HELD_TOGETHER
        for _ in range(STEPS):
            noise = max(float(np.median((here**2).sum(1) / degrees)), LEAST)
            held = _Held(noise, pull, np.log(centre or 1.0))
            found = self._step(log, x, here, held, damping, free)
            if found is None:
                break
            log, x, here, damping, gain = found
            if gain < STILL:
                break
        return x, np.exp(log)

    def _step(
        self, log: F64, x: F64, here: F64, held: _Held, damping: float, free: list[int],
    ) -> tuple[F64, F64, F64, float, float] | None:
        """(log roughness, numbers, residual, next damping, relative gain) of a step that gains; None: none does."""
        cost = held.cost(here, log)
        own = (self._residual(log + SLOPE, x) - here) / SLOPE  # (T, n)
        shared = np.stack([self._slope(log, x, here, k) for k in free])  # (k, T, n)
        bend = self._summed(own**2, len(log)) / held.noise + held.pull
        slope = self._summed(here * own, len(log)) / held.noise + held.pull * (log - held.centre)
        both = np.stack([self._summed(each * own, len(log)) for each in shared]) / held.noise  # (k, G)
        normal = np.einsum("ktn,jtn->kj", shared, shared) / held.noise
        gradient = (shared * here).sum((1, 2)) / held.noise
        for _ in range(TRIALS):
            damped = np.maximum(bend * (1 + damping), LEAST)
            system = normal + np.diag(damping * np.diag(normal) + 1e-9) - (both / damped) @ both.T
            moved = x.copy()
            moved[free] -= np.linalg.solve(system, gradient - (both / damped) @ slope)
            moved = np.clip(moved, self.low, 1.0)
            apart = np.clip(log - (slope + both.T @ (moved - x)[free]) / damped, self.least, 0.0)
            there = self._residual(apart, moved)
            if (less := held.cost(there, apart)) < cost:
                return apart, moved, there, damping / 4, 1 - less / cost
            damping *= 6
        return None

    def _summed(self, values: F64, groups: int) -> F64:
        """(G,) of (T, n)."""
        return np.bincount(self.group, values.sum(1), groups)

    def _slope(self, log: F64, x: F64, here: F64, k: int) -> F64:
        moved, h = x.copy(), -SLOPE if x[k] > 0.5 else SLOPE
        moved[k] += h
        return (self._residual(log, moved) - here) / h

    def _residual(self, log: F64, x: F64) -> F64:
        """(T, n) weighted, of the known layers."""
        return self.descent.weighted(*self._explained(log, x)).reshape(len(self.group), -1)

    def _explained(self, log: F64, x: F64) -> tuple[F64, F64, F64]:
        return self.descent.with_base(*self._body(np.exp(log)[self.group], float(x[0]), float(x[1])))

    def _body(self, roughness: F64, level: float, metallic: float) -> tuple[F64, F64]:
        """As of `Descent`; ``roughness``: (T,)."""
        texels, cos_v = self.descent.texels, self.descent.cos_v
        lobes, nodes = texels.lobes, texels.nodes
        energy = brdf.principled_energy_level(roughness[:, None], cos_v, level)
        shape = self.descent.places.values(roughness) * fresnel_ratio(lobes, cos_v, np.asarray(level), nodes, roughness)
        white = ((1 - energy[..., 1]) / np.pi)[..., None] * self.diffuse
        rest = (shape.sum(-1) * energy[..., 0])[..., None]
        if metallic > 0:
            own, edge = (part[..., None] for part in metal_values(lobes, cos_v, roughness, nodes))
            gain = brdf.metal_gain(self.descent.base, brdf.metal_energy(roughness[:, None], cos_v)[:, :, None])
            white, rest = (1 - metallic) * white + metallic * own * gain, (1 - metallic) * rest + metallic * edge * gain
        return white, rest
