"""Levenberg-Marquardt in the numbers that texels of a sample share; base colour, which is linear, is eliminated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..data import F64, I32, Bool
from ..shading import brdf
from ..vectors import dot, over_layers
from .lobe_values import LobePlaces, fresnel_ratio, metal_values
from .lower_bounds import bound_weight
from .sampled_texels import LEAST, SampledTexels

METAL_BASE = 0.6  # base colour for which a metal's multiple scattering is taken at first
SOME_METALLIC = 0.03  # less changes nothing
COSINES = np.linspace(0.0, 1.0, 65)
# Roughness, Specular IOR Level, Metallic, weight of a coat, its roughness, Diffuse Roughness:
ALL_NUMBERS = (0, 1, 2, 3, 4, 5)
TRIALS = 5  # of a step, each shorter
STILL = 1e-3  # relative gain of a step below which a search is at rest
LEAST_NUMBER = 1e-4  # of level, Metallic and weight: slopes of the level have no bound at 0
KEPT_VALUES = 24  # lobes that are kept for the next evaluations


class AmongCosines:
    """Cosines, (T, V), among COSINES: what is known there is looked up for all of them, many times."""

    def __init__(self, cosines: F64) -> None:
        cell = np.clip(cosines, 0, 1) * (len(COSINES) - 1)
        self.below = np.minimum(cell.astype(np.intp), len(COSINES) - 2)
        self.along = cell - self.below

    def values(self, curves: F64, curve: I32 | None = None) -> F64:
        """(T, V) of a curve through COSINES, or of (N, COSINES) of them; that of `np.interp`, in a third of its time.

        ``curve``: (T, 1) each texel's, of N.
        """
        at = self.below if curve is None else curve * len(COSINES) + self.below
        low = curves.take(at)
        return np.asarray(low + self.along * (curves.take(at + 1) - low))


class Descent:
    """Levenberg-Marquardt between bounds, in a material's numbers (6,)."""

    def __init__(self, texels: SampledTexels, weight: F64, low: F64) -> None:
        self.texels, self.root, self.low = texels, np.sqrt(weight), low
        self.cos_v = np.clip(texels.cos_v, 1e-3, 1.0)
        self.among, self.places = AmongCosines(self.cos_v), LobePlaces(texels.lobes, self.cos_v, texels.nodes)
        self.layers = np.ones(len(texels.camera), bool), ALL_NUMBERS
        # Base colour for which a metal's multiple scattering is taken, (T, V, C) or (1, 1, 1): it changes the gain by
        # some per cent.
        self.base = np.full((1, 1, 1), METAL_BASE)
        self._kept: dict[tuple[str, float], tuple[F64, ...]] = {}

    @property
    def layers(self) -> tuple[Bool, tuple[int, ...]]:
        """Known layers, and free numbers."""
        return self._layers

    @layers.setter
    def layers(self, layers: tuple[Bool, tuple[int, ...]]) -> None:
        self._layers, channel = layers, self.texels.channel
        self._known = np.flatnonzero(layers[0])
        bounds = bound_weight(self.texels, layers[0])
        self._bounds = None if bounds is None else np.sqrt(bounds).take(self._known, 1)
        # Of each channel its layers, those of them that are known, and the weights of these:
        self._channels = [(np.flatnonzero(channel == one), seen := np.flatnonzero((channel == one) & layers[0]),
                           self.root.take(seen, 1) ** 2) for one in np.unique(channel)]

    def shown(self, x: F64) -> F64:
        """(T, V, C) radiance over irradiance that numbers predict, with the base colour that explains them best."""
        white, off, base = self._explained(x)
        return np.asarray(self.texels.reflected - off + base * white)

    def run(self, start: F64, steps: int) -> tuple[F64, float]:
        """(numbers, cost) after so many steps, or at rest; of a metal once more with the base colour that it has."""
        self._use_base(np.full((1, 1, 1), METAL_BASE))
        x, cost = self._descended(np.clip(start, self.low, 1.0), steps)
        if 2 in self.layers[1] and x[2] > SOME_METALLIC:
            self._use_base(self._explained(x)[2])
            x, cost = self._descended(x, steps)
        return x, cost

    def _use_base(self, base: F64) -> None:
        if not np.array_equal(base, self.base):
            self.base = base
            self._kept = {key: values for key, values in self._kept.items() if key[0] != "metal"}

    def _descended(self, x: F64, steps: int) -> tuple[F64, float]:
        here, damping = self._residual(x), 1e-2
        cost = float(here @ here)
        for _ in range(steps):
            found = self._step(x, here, damping)
            if found is None:
                break
            x, here, damping = found
            before, cost = cost, float(here @ here)
            if cost > (1 - STILL) * before:
                break
        return x, cost

    def _step(self, x: F64, here: F64, damping: float) -> tuple[F64, F64, float] | None:
        """(numbers, residual, next damping) of a shorter and shorter step that gains; None: none does."""
        at = np.array(self.layers[1])
        slopes = self._slopes(x, here)
        gradient = slopes @ here
        moves = ~(((x[at] <= self.low[at]) & (gradient > 0)) | ((x[at] >= 1) & (gradient < 0)))
        if not moves.any():
            return None
        normal = slopes[moves] @ slopes[moves].T
        for _ in range(TRIALS):
            trial = x.copy()
            trial[at[moves]] -= np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-12), gradient[moves])
            trial = np.clip(trial, self.low, 1.0)
            there = self._residual(trial)
            if there @ there < here @ here:
                return trial, there, damping / 4
            damping *= 6
        return None

    def _slopes(self, x: F64, here: F64) -> F64:
        """(free numbers, n) by differences."""
        rows = []
        for k in self.layers[1]:
            h = -1e-5 if x[k] > 0.5 else 1e-5
            moved = x.copy()
            moved[k] += h
            rows.append((self._residual(moved) - here) / h)
        return np.stack(rows)

    def _residual(self, x: F64) -> F64:
        """(n,) weighted, of the known layers, with the base colour that explains them best."""
        return self.weighted(*self._explained(x)).ravel()

    def weighted(self, white: F64, off: F64, base: F64) -> F64:
        """(T, known layers, C) residual, of what `with_base` gives."""
        left = off - base * white
        result = (self.root * left).take(self._known, 1)
        return result if self._bounds is None else result + self._bounds * np.maximum(left.take(self._known, 1), 0)

    def _explained(self, x: F64) -> tuple[F64, F64, F64]:
        """As of `with_base`."""
        free = self.layers[1]
        roughness, level, metallic, weight, rough, diffuse = (float(value) for value in x)
        white, rest = self._body(roughness, level, metallic if 2 in free else 0.0)
        if diffuse > 0:
            white = white * self._keep("diffuse", diffuse, lambda: (self.texels.diffuse_gain(diffuse),))[0]
        if 3 in free:
            shape, gain, taken = self._coat(rough)
            left = 1 - weight * taken
            white, rest = left * white, left * rest + weight * shape * gain
        return self.with_base(white, rest)

    def with_base(self, white: F64, rest: F64) -> tuple[F64, F64, F64]:
        """(for each unit of base colour; what base colour has to explain; base colour as known layers have it)."""
        off = self.texels.reflected - rest
        base = np.empty_like(off)
        for layers, seen, weight in self._channels:
            of = white.take(seen, 1)
            weighted = weight * of
            total = over_layers(weighted, off.take(seen, 1)) / np.maximum(over_layers(weighted, of), LEAST)
            base[:, layers] = np.clip(total, 0, 1)[:, None]
        return white, off, base

    def _body(self, roughness: float, level: float, metallic: float) -> tuple[F64, F64]:
        """(T, V, 1) each, of a metal (T, V, C): for each unit of base colour, and whatever that is."""
        lobes, nodes = self.texels.lobes, self.texels.nodes
        (shape,) = self._keep("lobe", roughness, lambda: (self.places.values(self._all(roughness)),))
        (ratio,) = self._keep("level", level, lambda: (fresnel_ratio(lobes, self.cos_v, np.asarray(level), nodes),))
        energy = brdf.principled_energy_level(roughness, COSINES, level)
        gain, taken = (self.among.values(energy[:, k]) for k in (0, 1))
        white, rest = ((1 - taken) / np.pi)[..., None], (dot(shape, ratio) * gain)[..., None]
        if metallic > 0:
            own, edge = self._keep("metal", roughness, lambda: self._metal(roughness))
            white, rest = (1 - metallic) * white + metallic * own, (1 - metallic) * rest + metallic * edge
        return white, rest

    def _metal(self, roughness: float) -> tuple[F64, F64]:
        own, edge = metal_values(self.texels.lobes, self.cos_v, self._all(roughness), self.texels.nodes)
        along = brdf.metal_energy(roughness, COSINES)
        energy = np.stack([self.among.values(along[:, k]) for k in (0, 1)], -1)
        gain = brdf.metal_gain(self.base, energy[:, :, None])
        return own[..., None] * gain, edge[..., None] * gain

    def _coat(self, roughness: float) -> tuple[F64, ...]:
        """(T, V, 1) each of a coat of weight 1: its lobe, the gain of that, and what is taken from below."""
        def values() -> tuple[F64, ...]:
            energy = brdf.principled_energy(roughness, COSINES)
            shape = self.places.values(self._all(roughness)).sum(-1)
            return shape[..., None], *(self.among.values(energy[:, k])[..., None] for k in (0, 1))

        return self._keep("coat", roughness, values)

    def _all(self, roughness: float) -> F64:
        return np.full(len(self.cos_v), roughness)

    def _keep(self, kind: str, value: float, make: Callable[[], tuple[F64, ...]]) -> tuple[F64, ...]:
        """Steps change one number at a time: what the others give is the same."""
        if (kind, value) not in self._kept:
            if len(self._kept) >= KEPT_VALUES:
                del self._kept[next(iter(self._kept))]
            self._kept[kind, value] = make()
        return self._kept[kind, value]
