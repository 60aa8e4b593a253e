"""The coat that explains all texels of a sample, with the one roughness, Specular IOR Level and Metallic below it.

By descent from the material without a coat and a few coats (decision 0015): nodes of five numbers would be too many.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..data import F64, I32, Bool, Coat
from ..shading import brdf
from ..vectors import over_layers
from .descent import LEAST_NUMBER, Descent
from .joint_material import LEVELS, ROUGHNESS, Joint, JointSearch, OneMaterial, weight_of
from .lobe_values import LobePlaces, coat_values
from .sampled_texels import LEAST, SampledTexels

# (weight, roughness) of coats, and (roughness, level) of what lies below where that is not the material without one.
STARTS: tuple[tuple[float, float, tuple[float, float] | None], ...] = (
    (0.3, 0.1, None), (0.3, 0.3, None), (0.1, 0.6, None), (0.5, 0.2, (0.7, 0.3)))
SOME = 4  # one texel in so many takes part until the end is near
RACE, KEPT, STEPS, LAST_STEPS = 5, 2, 10, 8  # steps from every start; of those kept; at most; and with all texels
AGAIN = 2  # descents by what the one before predicts
SEEN = 0.01  # share of the texels that must see a coat's highlight, or its tails
SAME_LOBE, HALF = 1.25, 0.5  # ratio of roughnesses up to which two lobes are one; of a body's highlight without a coat
ROUGHER = 1.03  # cost of a coat that is rougher than what it covers, relative to one that is not
METAL_NUMBERS, PLAIN_NUMBERS = (0, 1, 2, 3, 4), (0, 1, 3, 4)  # of those of a descent: with and without Metallic
PLAIN, METAL, APART = "plain", "metal", "apart"  # below the coat: one value; and Metallic; a roughness a texel
WEIGHTS, COATS = np.array([0.1, 0.3, 0.6, 1.0]), 8  # of APART: weights, number of roughnesses, first of all
WIDEST, ROUNDS = 0.7, 3  # the largest of these; how often each of the two is found again between its neighbours


class CoatSearch:
    """Of a sample's texels, from any part of their layers."""

    def __init__(self, search: JointSearch, sample: SampledTexels) -> None:
        """``sample``: that of the search, which may have taken some of its texels alone."""
        # A coat is the same everywhere: it is seen where half vectors come near the normals of some texels.  At an
        # angle whose sine is its roughness, GGX is 1 / pi: a few percent of a diffuse.
        sharpest = max(float(np.quantile(search.nearest, SEEN)) ** 0.5, brdf.ROUGHNESS_MIN)
        low = np.array([brdf.ROUGHNESS_MIN, LEAST_NUMBER, LEAST_NUMBER, LEAST_NUMBER, sharpest, 0.0])
        texels = _informed(search, sample)
        self.some, self.all = (Descent(part, weight_of(part), low) for part in (
            texels.part(np.arange(0, len(texels.cos_v), SOME, dtype=np.int32)), texels))
        self.apart = _Apart(search, sharpest)

    def fit(self, kind: str, known: Bool, joint: Joint, level: float) -> OneMaterial:
        """From the layers that are ``known``, (V,), and the material without a coat; ``level``: of APART.

        That material itself where a coat would only be its lobe under another name.
        """
        if kind == APART:
            return OneMaterial(joint.apart.roughness, level, coat=self.apart.coat(known, level))
        metal = kind == METAL
        free, plain = (METAL_NUMBERS, joint.metal) if metal else (PLAIN_NUMBERS, joint.specular)
        self.some.layers, self.all.layers = (known, free), (known, free)
        tried = []
        for weight, roughness, below in STARTS:
            of = replace(plain, roughness=below[0], level=below[1]) if below else plain
            x = np.array([of.roughness, of.level, of.metallic, weight, roughness, 0.0])
            tried.append(self.some.run(x, RACE))
        tried.sort(key=lambda found: found[1])
        best = min((self.some.run(x, STEPS) for x, _ in tried[:KEPT]), key=lambda found: found[1])[0]
        # A wide lobe below a narrow one explains nearly what the narrow one below the wide does: all texels decide.
        ends = [self.all.run(x, LAST_STEPS) for x in (best, self.some.run(_swapped(best), STEPS)[0])]
        ends = [found for found in ends if not _takes_place(found[0], plain)]
        if not ends:
            return plain
        found = self._settled(min(ends, key=_plausible)[0], known, free)
        r, level, metallic, weight, roughness = (float(x) for x in found[:5])
        return OneMaterial(r, level, metallic if metal else 0.0, coat=Coat(weight, roughness))

    def _settled(self, x: F64, known: Bool, free: tuple[int, ...]) -> F64:
        """Where the descent rests if errors of what is predicted bright count by their cube roots, too."""
        root = self.all.root
        for _ in range(AGAIN):
            self.all.root = np.sqrt(weight_of(self.all.texels, self.all.shown(x)))
            self.all.layers = known, free
            x, _cost = self.all.run(x, LAST_STEPS)
        self.all.root = root
        return x


def _informed(search: JointSearch, sample: SampledTexels) -> SampledTexels:
    """As many texels of a sample as those of a search: those to whose normals half vectors come nearest.

    The others hardly see a narrow coat.  Of few that do, each one's luck decides its weight.
    """
    if sample.nodes is not None:
        return search.texels
    return sample.part(np.sort(np.argsort(sample.nearest(), kind="stable")[:len(search.weight)]).astype(np.int32))


def _takes_place(x: F64, plain: OneMaterial) -> bool:
    """Whether a coat is the lobe of the material without one, and little is left of the highlight below it.

    That explains the texels as well, but nothing shows the roughness of what would lie below.
    """
    _, level, metallic, _, rough, _ = x
    same = 1 / SAME_LOBE < rough / plain.roughness < SAME_LOBE
    return bool(same and level < HALF * plain.level and metallic <= max(HALF * plain.metallic, LEAST_NUMBER))


def _plausible(found: tuple[F64, float]) -> float:
    """The cost; what coats cover is rougher than they are, unless the texels clearly say otherwise."""
    (roughness, *_, rough, _), cost = found
    return cost * ROUGHER if rough > roughness else cost


def _swapped(x: F64) -> F64:
    """Both lobes in each other's place; a coat of weight 1 reflects what level 0.5 does."""
    roughness, level, metallic, weight, rough, diffuse = x
    return np.array([rough, weight / 2, metallic, 2 * level, roughness, diffuse])


@dataclass(frozen=True)
class _Known:
    """The known layers of one channel."""

    layers: I32  # (n,)
    nodes: dict[str, F64]  # (T, roughnesses, n) of `JointSearch`, at one level
    weight: F64  # (T, n, C)
    reflected: F64  # (T, n, C)


class _Apart:
    """The coat above texels of which each has its own roughness: it takes its best of the nodes."""

    def __init__(self, search: JointSearch, sharpest: float) -> None:
        self.search, self.sharpest = search, min(sharpest, WIDEST / 2)
        self.cos_v = np.clip(search.texels.cos_v, 1e-3, 1.0)
        self.places = LobePlaces(search.texels.lobes, self.cos_v, search.texels.nodes)

    def coat(self, known: Bool, level: float) -> Coat:
        """At a Specular IOR Level."""
        channels = self._known(known, level)

        def cost(weight: float, log_roughness: float) -> float:
            return self._cost(channels, Coat(weight, float(np.exp(log_roughness))))

        rough = np.log(np.geomspace(self.sharpest, WIDEST, COATS))
        costs = np.array([[cost(w, r) for r in rough] for w in WEIGHTS])
        i, j = np.unravel_index(costs.argmin(), costs.shape)
        best, steps = np.array([WEIGHTS[i], rough[j]]), np.array([0.15, (rough[1] - rough[0]) / 2])
        for _ in range(ROUNDS):
            for k in (0, 1):
                best[k] = _between(best, k, steps[k], cost, (LEAST_NUMBER, rough[0])[k])
            steps /= 2
        return Coat(float(best[0]), float(np.exp(best[1])))

    def _known(self, known: Bool, level: float) -> list[_Known]:
        """Taken once: tens of coats are tried on them."""
        at = int(np.abs(LEVELS - level).argmin()) * len(ROUGHNESS)
        result = []
        for of in self.search.nodes:
            own = known[of.layers]
            nodes = {name: of.products[name][:, at:at + len(ROUGHNESS)].compress(own, 2)
                     for name in ("a", "s", "aa", "as", "ss")}
            layers = of.layers[own]
            result.append(_Known(layers, nodes, self.search.weight.take(layers, 1),
                                 self.search.texels.reflected.take(layers, 1)))
        return result

    def _cost(self, channels: list[_Known], coat: Coat) -> float:
        above, left = coat_values(self.places, self.cos_v, coat)
        total = np.zeros(1)
        for of in channels:
            off, w = of.reflected - above.take(of.layers, 1)[..., None], of.weight
            covered = w * left.take(of.layers, 1)[..., None]
            white, both = covered * left.take(of.layers, 1)[..., None], covered * off
            sums = {name: values @ (white if len(name) == 2 else both) for name, values in of.nodes.items()}
            pull = sums["a"] - sums["as"]
            base = np.clip(pull / np.maximum(sums["aa"], LEAST), 0, 1)
            cost = over_layers(w, off**2)[:, None] - 2 * sums["s"] + sums["ss"] + base * (base * sums["aa"] - 2 * pull)
            total = total + np.maximum(cost, 0).sum(-1)
        return float(total.min(1).sum())


def _between(best: F64, k: int, step: float, cost: Callable[[float, float], float], low: float) -> float:
    """Number ``k`` where the parabola through three places has its bottom, not farther than a step away."""
    places = np.clip(best[k] + step * np.array([-1.0, 0.0, 1.0]), low, 1.0 if k == 0 else 0.0)
    costs = []
    for place in places:
        moved = best.copy()
        moved[k] = place
        costs.append(cost(*moved))
    if len(np.unique(places)) < 3 or costs[1] >= min(costs[0], costs[2]):
        return float(places[int(np.argmin(costs))])
    bend, slope, _ = np.polyfit(places - places[1], costs, 2)
    return float(np.clip(places[1] - 0.5 * slope / bend, places[0], places[2]))
