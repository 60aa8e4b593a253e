"""The one roughness, Specular IOR Level and Metallic that explain all texels of a sample, each with its base colour.

A material whose texels hardly differ is told best by all of them: where no highlight passes a texel, its own numbers
only bend to what the diffuse does not explain.

What a texel reflects is b A + S with base colour b.  Under Metallic m, A and S are (1 - m) and m times those of a
dielectric and of a metal.  So the squared residual is a polynomial in b and m, whose coefficients are sums over layers.
They are taken once for all nodes of roughness and level, as products of matrices.  One value for all texels is then
found between the nodes by descent: where pictures are exact, a parabola through nodes is not (decision 0015).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations_with_replacement

import numpy as np

from ..data import F64, I32, Bool, Coat
from ..shading import brdf
from ..vectors import dot, over_layers, summed
from .apart_descent import HELD_TOGETHER, ApartDescent
from .descent import COSINES, LEAST_NUMBER, METAL_BASE, AmongCosines, Descent
from .lobe_values import LobePlaces, fresnel_ratio, metal_values
from .lower_bounds import NodeBounds, bound_weight
from .sampled_texels import LEAST, SampledTexels, metal_gain

ROUGHNESS = np.geomspace(0.05, 1.0, 18)  # nodes of the search
DIFFUSE = np.linspace(0.0, 1.0, 11)  # Diffuse Roughness
LEVELS = np.array([0.02, 0.06, 0.12, 0.25, 0.5, 0.75, 1.0])
METALLIC = np.linspace(0.0, 1.0, 11)
PURE = 0.999  # a Metallic above it is 1
PLAIN = 4  # of LEVELS: Blender's default
EVERY, PLAIN_ALONE = slice(None), slice(PLAIN, PLAIN + 1)  # of LEVELS
MOST = 10_000  # observations of the sample
Sums = list[tuple[dict[str, F64], NodeBounds | None]]  # of each channel
UNSEEN = 0.25  # alpha squared over the least squared sine of the half vector: sharper lobes pass by a texel
STEPS = 10  # of a descent from the nodes


@dataclass(frozen=True)
class OneMaterial:
    """A material as one, base colour aside."""

    roughness: float
    level: float = 0.5  # Specular IOR Level
    metallic: float = 0.0
    others: tuple[float, ...] = ()  # roughness of further parts
    coat: Coat | None = None
    diffuse: float = 0.0  # Diffuse Roughness


@dataclass(frozen=True)
class Joint:
    """What explains a material's texels together, by what is free."""

    plain: OneMaterial  # roughness
    specular: OneMaterial  # and Specular IOR Level
    metal: OneMaterial  # and Metallic
    # By nodes alone until they are `settled`:
    apart: OneMaterial  # the level where each texel has its own roughness, and what those lie about
    apart_metal: OneMaterial  # and Metallic
    parts: tuple[OneMaterial, ...]  # two and three parts, each of one roughness: a texel belongs to the one that suits
    coated: Mapping[str, OneMaterial] = field(default_factory=dict)  # by a word for what is free, see coat_search.py
    rough: Joint | None = None  # the same with a rough diffuse, without Metallic
    # With one base colour for all, by least squares of radiance; without and with Metallic.  (): not sought
    constant: tuple[OneMaterial, ...] = ()


class JointSearch:
    """The model at all nodes, so that any part of the layers can be fitted at once."""

    def __init__(self, texels: SampledTexels, metals: bool = True, levels: slice = EVERY) -> None:
        """``metals``: whether Metallic may differ from 0, which takes several times as long.

        ``levels``: of LEVELS; for `plain` alone that of PLAIN is enough.
        """
        count, layers = texels.cos_v.shape
        most = max(MOST // max(layers, 1), 32)
        if count > most:
            texels = texels.part(np.linspace(0, count - 1, most).astype(np.int32))
        self.texels = texels
        self.nodes, self.metallic = Nodes.of(texels, metals, levels), METALLIC if metals else METALLIC[:1]
        self.at_plain = PLAIN - (levels.start or 0)  # which of the levels is Blender's default
        # Half vectors come as near to a texel's normal as this, in the median: lobes that are half as wide stay unseen.
        self.nearest = texels.nearest()  # (T,)
        self.seen: Bool = ROUGHNESS**4 >= UNSEEN * min(float(np.median(self.nearest)), 1.0)
        self.weight = weight_of(texels)
        self.descent = Descent(texels, self.weight, np.array([ROUGHNESS[0], LEAST_NUMBER, 0.0, 0.0, ROUGHNESS[0], 0.0]))
        self._gains: dict[float, F64] = {}  # by Diffuse Roughness

    def fit(self, known: Bool, diffuse: float = 0.0) -> Joint:
        """From the layers that are ``known``, (V,); ``diffuse``: Diffuse Roughness, with which there is no Metallic."""
        sums = self._sums(known, diffuse)
        plain = _costs(sums, 0.0)
        tried = self._tried(sums, plain, known, METALLIC[:1] if diffuse else self.metallic)
        whole, apart = np.stack([t.whole for t in tried]), np.stack([t.apart for t in tried])
        together = whole.min(2)
        free = (5,) if diffuse else ()
        specular = self._settled(_best(together[:1], tried), known, (0, 1, *free), diffuse)
        found = Joint(plain=self._plain(tried[0].whole, known, (0, *free), diffuse),
                      specular=specular,
                      metal=self._settled(_best(together, tried), known, (0, 1, 2)) if len(tried) > 1 else specular,
                      apart=_best(apart[:1], tried), apart_metal=_best(apart, tried), parts=_parts(plain, self.seen))
        if not diffuse:
            return found
        return replace(found, apart=replace(found.apart, diffuse=diffuse),
                       parts=tuple(replace(one, diffuse=diffuse) for one in found.parts))

    def plain(self, known: Bool) -> OneMaterial:
        """Of `fit`, the roughness that explains all texels together at Blender's default level."""
        return self._plain(_costs(self._sums(known, 0.0), 0.0).sum(2), known, (0,), 0.0)

    def apart(self, known: Bool) -> OneMaterial:
        """Of what is `settled`, `apart_metal` alone, in half the time; it is `apart` where there are no metals."""
        sums = self._sums(known, 0.0)
        tried = self._tried(sums, _costs(sums, 0.0), known, self.metallic)
        costs = np.stack([t.apart for t in tried])
        metal = _best(costs, tried)
        if metal.metallic > 0:
            metal = self._settled_apart(metal, sums, known)
        return metal if metal.metallic > 0 else self._settled_apart(_best(costs[:1], tried), sums, known)

    def _tried(self, sums: Sums, plain: F64, known: Bool, metallic: F64) -> list[_Tried]:
        """Costs under each of ``metallic``; ``plain``: those without."""
        degrees = np.maximum((self.weight[:, known] > 0).sum((1, 2)) - 2, 1)
        least = plain[plain.sum(2).min(1).argmin()].min(0)  # (T,) at the best level
        noise = max(float(np.median(least / degrees)), LEAST)
        return [_Tried.of(plain if one == 0 else _costs(sums, one), noise) for one in metallic]

    def _plain(self, whole: F64, known: Bool, free: tuple[int, ...], diffuse: float) -> OneMaterial:
        """``whole``: (levels, roughnesses) costs where all texels have one roughness."""
        return self._settled(OneMaterial(_roughness(whole[self.at_plain])), known, free, diffuse)

    def settled(self, joint: Joint, known: Bool) -> Joint:
        """Of `fit`, with what is found where texels differ in roughness settled between the nodes, too."""
        sums = self._sums(known, joint.apart.diffuse)
        apart = metal = self._settled_apart(joint.apart, sums, known)
        if joint.apart_metal.metallic > 0:
            metal = self._settled_apart(joint.apart_metal, sums, known)
        return replace(joint, apart=apart, apart_metal=metal if metal.metallic > 0 else apart,
                       parts=tuple(self._settled_parts(one, sums, known) for one in joint.parts))

    def with_constant(self, joint: Joint, known: Bool) -> Joint:
        """Of `fit`, also what explains the texels together with one base colour for all.

        By squares of radiance itself, in which highlights count most: a lobe that flashes costs more than a lost one.
        """
        texels = self.texels
        weight = np.where(texels.usable()[..., None], texels.quality[..., None] * texels.irradiance**2, 0.0)
        sums = [{name: of.sum(2) for name, of in self._sums_over(nodes, known, 0.0, weight).items()}
                for nodes in self.nodes]
        costs = np.stack([_alike(sums, metallic) for metallic in self.metallic])
        found = []
        for some in (costs[:1], costs):
            m, level, rough = np.unravel_index(some.argmin(), some.shape)
            found.append(OneMaterial(_roughness(some[m, level]), _level(_lowest(LEVELS, some[m, :, rough])),
                                     float(self.metallic[m])))
        return replace(joint, constant=tuple(found))

    def diffuse_roughness(self, known: Bool) -> float:
        """The one that explains the texels best, each at its own roughness, without Metallic."""
        costs = np.array([_costs(self._sums(known, diffuse), 0.0).min(1).sum(-1).min() for diffuse in DIFFUSE])
        return float(np.clip(_lowest(DIFFUSE, costs), 0, 1))

    def _settled(self, one: OneMaterial, known: Bool, free: tuple[int, ...], diffuse: float = 0.0) -> OneMaterial:
        """Where a descent from ``one`` comes to rest in its ``free`` numbers, of those of a descent."""
        self.descent.layers = known, free
        found, _ = self.descent.run(np.array([one.roughness, one.level, one.metallic, 0.0, 1.0, diffuse]), STEPS)
        roughness, level, metallic, _, _, diffuse = (float(number) for number in found)
        return replace(one, roughness=roughness, level=level, metallic=_pure(metallic), diffuse=diffuse)

    def _settled_apart(self, one: OneMaterial, sums: Sums, known: Bool) -> OneMaterial:
        """Where level and Metallic come to rest if each texel begins at its best node and goes its own way."""
        cost = _costs(sums, float(METALLIC[np.abs(METALLIC - one.metallic).argmin()]))[_nearest(LEVELS, one.level)]
        descent = ApartDescent(self.texels, self.weight, known, self._gain(one.diffuse))
        (level, metallic), _ = descent.run(
            np.array([one.level, one.metallic]), ROUGHNESS[cost.argmin(0)], one.roughness)
        return replace(one, level=float(level), metallic=_pure(metallic))

    def _settled_parts(self, one: OneMaterial, sums: Sums, known: Bool) -> OneMaterial:
        """Where level and the roughness of each part come to rest; a texel belongs to the part of the best node.

        None becomes sharper than what a texel can tell from no lobe.
        """
        nodes = np.array([one.roughness, *one.others])
        cost = _costs(sums, 0.0)[_nearest(LEVELS, one.level)]
        group = cost[[_nearest(ROUGHNESS, node) for node in nodes]].argmin(0).astype(np.int32)
        descent = ApartDescent(self.texels, self.weight, known, self._gain(one.diffuse), group,
                               float(ROUGHNESS[self.seen][0]))
        (level, _), roughness = descent.run(np.array([one.level, 0.0]), nodes)
        first, *others = (float(value) for value in roughness)
        return replace(one, roughness=first, level=float(level), others=tuple(others))

    def _sums(self, known: Bool, diffuse: float) -> Sums:
        """As of `_sums_over` the known layers of each channel, and their clipped pixels."""
        weight, gain = bound_weight(self.texels, known), self._gain(diffuse)
        return [(self._sums_over(nodes, known, diffuse), None if weight is None else NodeBounds.of(
            self.texels, weight, nodes.layers, nodes.products, gain)) for nodes in self.nodes]

    def _sums_over(
        self, nodes: Nodes, known: Bool, diffuse: float, weight: F64 | None = None,
    ) -> dict[str, F64]:
        """Weighted sums over layers of products of what a dielectric (a, s), a metal (A, S) and the data (f) show.

        (levels, roughnesses, T, C) each, or (1, ...) where no level is in it; of a rough diffuse those of a, s and f.
        ``weight``: (T, V, C) of squared residuals; None: as of `weight_of`.
        """
        every = self.weight if weight is None else weight
        # What is not known weighs nothing: to leave it out would copy all nodes, which takes longer than the sums.
        weight = np.where(known[nodes.layers, None], every.take(nodes.layers, 1), 0.0)
        f = self.texels.reflected.take(nodes.layers, 1)
        result = {"ff": over_layers(weight * f, f)[None, None]}
        for name, values in nodes.products.items():
            factor = weight * f if len(name) == 1 else weight
            if diffuse and name.lower() != name:
                continue
            if diffuse and "a" in name:
                factor = factor * self._gain(diffuse).take(nodes.layers, 1) ** name.count("a")
            total = np.moveaxis(values @ factor, 0, 1)  # (nodes, T, C)
            result[name if len(name) == 2 else name + "f"] = total.reshape(-1, len(ROUGHNESS), *total.shape[1:])
        return result

    def _gain(self, diffuse: float) -> F64:
        """(T, V, C) as of `SampledTexels.diffuse_gain`; (1, 1, 1) of a smooth one."""
        if not diffuse:
            return np.ones((1, 1, 1))
        if diffuse not in self._gains:
            self._gains[diffuse] = self.texels.diffuse_gain(diffuse)
        return self._gains[diffuse]


def weight_of(texels: SampledTexels, shown: F64 | float = 0.0) -> F64:
    """(T, V, C) of squared residuals: errors of the cube root of radiance, which lightness is made of.

    ``shown``: (T, V, C) what is predicted.  Without it, what is predicted bright and is dark costs more than its cube
    root, and a lobe that lies beside its place comes out too weak.
    """
    unit = np.maximum(np.maximum(texels.reflected, texels.typical()), shown)
    return np.where(texels.usable()[..., None], texels.quality[..., None] * texels.irradiance ** (2 / 3)
                    / unit ** (4 / 3), 0.0)


@dataclass(frozen=True)
class Nodes:
    """The model at all nodes, of the layers of one channel."""

    layers: I32  # (V,)
    products: dict[str, F64]  # (T, levels roughnesses or roughnesses, V) each: a, s, A, S and their products in pairs

    @classmethod
    def of(cls, texels: SampledTexels, metals: bool, levels: slice) -> list[Nodes]:
        """Of each channel of a sample; without A and S, unless there may be ``metals``.  ``levels``: of LEVELS."""
        single = dict(zip("as", _dielectric(texels, levels), strict=True))
        if metals:
            single |= zip("AS", _metallic(texels), strict=True)
        channels = np.unique(texels.channel)
        result = []
        for channel in channels:
            layers = np.flatnonzero(texels.channel == channel).astype(np.int32)
            own = single if len(channels) == 1 else {name: value.take(layers, 3) for name, value in single.items()}
            pairs = {one + other: own[one] * own[other] for one, other in combinations_with_replacement(own, 2)}
            result.append(cls(layers, {name: value.reshape(len(value), -1, len(layers))
                                       for name, value in (own | pairs).items()}))
        return result


def _dielectric(texels: SampledTexels, levels: slice) -> tuple[F64, F64]:
    """a and s, (T, levels, roughnesses, V) each."""
    count, layers = texels.cos_v.shape
    a, s = (np.empty((count, len(LEVELS[levels]), len(ROUGHNESS), layers)) for _ in range(2))
    cos_v, among = np.clip(texels.cos_v, 1e-3, 1.0), AmongCosines(texels.cos_v)
    energies, places = _energies()[levels], LobePlaces(texels.lobes, cos_v, texels.nodes)
    ratios = [fresnel_ratio(texels.lobes, cos_v, np.asarray(level), texels.nodes) for level in LEVELS[levels]]
    for j, roughness in enumerate(ROUGHNESS):
        lobe = places.values(np.full(count, roughness))
        for i, ratio in enumerate(ratios):
            gain, taken = (among.values(energy) for energy in energies[i, j])
            a[:, i, j] = (1 - taken) / np.pi
            s[:, i, j] = dot(lobe, ratio) * gain
    return a, s


@cache
def _energies() -> F64:
    """(levels, roughnesses, 2, COSINES) as of `brdf.principled_energy_level`."""
    return np.array([[brdf.principled_energy_level(roughness, COSINES, level).T for roughness in ROUGHNESS]
                     for level in LEVELS])


def _metallic(texels: SampledTexels) -> tuple[F64, F64]:
    """A and S, (T, 1, roughnesses, V) each."""
    count, layers = texels.cos_v.shape
    A, S = (np.empty((count, 1, len(ROUGHNESS), layers)) for _ in range(2))
    cos_v, base = np.clip(texels.cos_v, 1e-3, 1.0), np.full((count, 1), METAL_BASE)
    for j, roughness in enumerate(ROUGHNESS):
        rough = np.full(count, roughness)
        gain = metal_gain(rough, texels.cos_v, base)[..., 0]
        A[:, 0, j], S[:, 0, j] = (part * gain for part in metal_values(texels.lobes, cos_v, rough, texels.nodes))
    return A, S


def _costs(sums: Sums, metallic: float) -> F64:
    """(levels, roughnesses, T) weighted squared residual, base colour in closed form for each channel."""
    total = np.zeros(1)
    for of, bounds in sums:
        cost, base = _residual(*_polynomial(of, metallic))
        total = total + cost + (0.0 if bounds is None else bounds.costs(base, metallic))
    return total


def _alike(sums: list[dict[str, F64]], metallic: float) -> F64:
    """(levels, roughnesses) the same with one base colour for all texels, of sums over these; clipped pixels aside."""
    return np.asarray(sum(_residual(*_polynomial(of, metallic))[0] for of in sums))


def _polynomial(of: dict[str, F64], metallic: float) -> tuple[F64, F64, F64, F64]:
    """As `_residual` takes it."""
    x, m = 1 - metallic, metallic
    if m == 0:
        return of["ff"], of["aa"], of["af"] - of["as"], of["ss"] - 2 * of["sf"]
    white_data = x * of["af"] + m * of["Af"]
    rest_data = x * of["sf"] + m * of["Sf"]
    white = x * x * of["aa"] + 2 * x * m * of["aA"] + m * m * of["AA"]
    both = x * x * of["as"] + x * m * (of["aS"] + of["sA"]) + m * m * of["AS"]
    rest = x * x * of["ss"] + 2 * x * m * of["sS"] + m * m * of["SS"]
    return of["ff"], white, white_data - both, rest - 2 * rest_data


def _residual(ff: F64, white: F64, slope: F64, rest: F64) -> tuple[F64, F64]:
    """(..., T) least of ff + rest + b^2 white - 2 b slope over b in [0, 1], summed over channels; (..., T, C) of b."""
    base = np.clip(slope / np.maximum(white, LEAST), 0, 1)
    return summed(np.maximum(ff + rest + base * (base * white - 2 * slope), 0.0)), base


def _parts(cost: F64, seen: Bool) -> tuple[OneMaterial, ...]:
    """Two and three roughnesses at one level, of (levels, roughnesses, T) costs of which each texel has its least.

    ``seen``: of ROUGHNESS; a texel alone cannot tell a sharper lobe from none.
    """
    cost, nodes = cost[:, seen], ROUGHNESS[seen]
    pairs = np.stack([np.minimum(at[:, None], at[None]).sum(-1) for at in cost])
    level, first, second = np.unravel_index(pairs.argmin(), pairs.shape)
    two = np.minimum(cost[level, first], cost[level, second])
    third = np.minimum(cost[level], two).sum(-1).argmin()
    free = _level(_lowest(LEVELS, pairs[:, first, second]))
    one, *others = (float(nodes[k]) for k in (first, second, third))
    return OneMaterial(one, free, others=(others[0],)), OneMaterial(one, free, others=tuple(others))


@dataclass(frozen=True)
class _Tried:
    """Costs under one Metallic."""

    whole: F64  # (levels, roughnesses) where all texels have one roughness
    apart: F64  # (levels,) where each has its own

    @classmethod
    def of(cls, cost: F64, noise: float) -> _Tried:
        """``cost``: (levels, roughnesses, T); ``noise``: its unit, of one observation."""
        whole = cost.sum(2)
        centre = np.array([_lowest(np.log(ROUGHNESS), costs) for costs in whole])
        pull = 2 * HELD_TOGETHER * (np.log(ROUGHNESS) - centre[:, None]) ** 2
        return cls(whole, (cost / noise + pull[..., None]).min(1).sum(1))

    def roughness(self, level: int) -> float:
        """Of all texels, at one of LEVELS."""
        return _roughness(self.whole[level])


def _roughness(whole: F64) -> float:
    """Of (roughnesses,) costs where all texels have one."""
    return float(np.exp(_lowest(np.log(ROUGHNESS), whole)))


def _best(costs: F64, tried: list[_Tried]) -> OneMaterial:
    """The best of (metallics, levels) costs; one metallic: that is not free."""
    m, level = np.unravel_index(costs.argmin(), costs.shape)
    metallic = float(np.clip(_lowest(METALLIC, costs[:, level]), 0, 1)) if len(costs) > 1 else 0.0
    return OneMaterial(tried[m].roughness(int(level)), _level(_lowest(LEVELS, costs[m])), metallic)


def _pure(value: float) -> float:
    """A metal that is one to rounding has no diffuse at all."""
    return 1.0 if value > PURE else float(value)


def _nearest(nodes: F64, value: float) -> int:
    return int(np.abs(nodes - value).argmin())


def _level(level: float) -> float:
    return float(np.clip(level, LEVELS[0], 1.0))


def _lowest(nodes: F64, costs: F64) -> float:
    """Where the parabola through the lowest of (N,) costs and its neighbours has its bottom."""
    at = int(np.clip(costs.argmin(), 1, len(nodes) - 2))
    if at != costs.argmin():
        return float(nodes[costs.argmin()])
    x, y = nodes[at - 1:at + 2], costs[at - 1:at + 2]
    bend, slope, _ = np.polyfit(x - x[1], y, 2)
    return float(x[1] + np.clip(-0.5 * slope / bend, x[0] - x[1], x[2] - x[1])) if bend > 0 else float(x[1])
