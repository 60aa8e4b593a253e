"""Texels without a scene: observations as arrays, kernels run on them, and the fit of the solver in float64."""

from __future__ import annotations

import gc
from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.tables import principled_table
from irpso_addon.gpu.device.context import Device, Inputs
from irpso_addon.gpu.observe.observation_atlas import ArraySource, ObservationAtlas, ObservedTexels, Tilts
from tests.support import texel_problem as bench

HERE = Path(__file__).parent


def finish(steps: Generator[Any, Any, Any]) -> Any:
    """What a generator returns."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


KINDS = (moderngl.Texture, moderngl.Framebuffer, moderngl.Buffer, moderngl.VertexArray, moderngl.Program)


def held(device: Device) -> frozenset[Any]:
    """Objects that Python still holds and that were not released, and those it dropped without release.

    Programs are kept for good, each with a vertex array: draw everything once before.  Compare with ``<=``: what
    earlier tests left may be freed at any time.
    """
    gc.collect()
    alive = [owner.mglo for owner in gc.get_objects() if isinstance(owner, KINDS) and owner.ctx is device.ctx]
    return frozenset(mglo for mglo in [*alive, *device.ctx.objects] if not isinstance(mglo, moderngl.InvalidObject))


@dataclass(frozen=True)
class Texels:
    """Observations of h x w texels, as ArraySource takes them; ``edge``: where they are a shadow's or silhouette's."""

    rgb: np.ndarray  # (h, w, K, 3); layer k observes channel ``groups[k] % channels`` where channels is 3
    quality: np.ndarray
    cos_v: np.ndarray
    lobes: np.ndarray
    groups: tuple[int, ...]
    edge: np.ndarray | None = None
    channels: int = 1
    normal: np.ndarray | None = None  # (h, w, 3) unit; with lamps: normals are known roughly
    lamps: np.ndarray | None = None  # (K, lights, 4) place and 1, or direction and 0; texels are at (1, 1, 1)

    def source(self, device: Device) -> ArraySource:
        """The same for the solver."""
        source = ArraySource(device, ObservedTexels(self.rgb, self.quality, self.cos_v, self.lobes, self.groups),
                             principled_table())
        h, w, count = self.quality.shape
        first = source.blocks.reshape(count, -1, h, w, 4)[:, 0]
        first[..., 0] = np.moveaxis(self.observed(), -1, 0)
        if self.edge is not None:
            first[..., 3] += np.moveaxis(self.edge, -1, 0)
        source.layers = replace(source.layers, channels=self.channels)
        if self.normal is not None and self.lamps is not None:
            source.tilts = Tilts(device.texture(w, h, 3, self.normal.astype(np.float32)),
                                 device.texture(*self.lamps.shape[1::-1], 4, self.lamps.astype(np.float32)))
        return source

    def observed(self) -> np.ndarray:
        """What each layer observes, (h, w, K)."""
        if self.channels == 1:
            return self.rgb.mean(-1)
        return np.stack([self.rgb[:, :, k, group % 3] for k, group in enumerate(self.groups)], -1)


def of_problem(problem: bench.Problem) -> Texels:
    """The observations of a benchmark's problem."""
    return Texels(problem.rgb, problem.quality, problem.cos_v, problem.lobes, problem.groups)


def by_channel(texels: Texels) -> Texels:
    """The same where each channel is observed by itself."""
    groups = tuple(3 * group + channel for group in dict.fromkeys(texels.groups) for channel in range(3)
                   for other in texels.groups if other == group)
    order = [k for group in dict.fromkeys(texels.groups) for _ in range(3)
             for k, other in enumerate(texels.groups) if other == group]
    return Texels(texels.rgb[:, :, order], texels.quality[:, :, order], texels.cos_v[:, :, order],
                  texels.lobes[:, :, order], groups, channels=3)


def as_metal(problem: bench.Problem, metallic: float, level: float = 0.5) -> Texels:
    """What one lobe of the problem's roughness and base colour reflects where it is in part a metal."""
    sin2h, radius2, cos_l, _ = np.moveaxis(problem.lobes[..., 0, :].astype(np.float64), -1, 0)
    cos_v, r = problem.cos_v.astype(np.float64), problem.truth.roughness[..., None]
    cos_vh = np.minimum((cos_l + cos_v) / (2 * np.sqrt(1 - sin2h)), 1)
    base = problem.truth.base[:, :, None]
    energy = brdf.principled_energy_level(r, cos_v, level)
    lobe = brdf.lobe_ggx(r, sin2h, radius2, cos_l, cos_v)
    dielectric = base * ((1 - energy[..., 1]) / np.pi)[..., None] + (
        lobe * brdf.F_level(cos_vh, level) * energy[..., 0])[..., None]
    rgb = (1 - metallic) * dielectric + metallic * brdf.metal(base, r, sin2h, radius2, cos_l, cos_v, cos_vh)
    rgb = np.where(problem.quality[..., None] > 0, rgb, 0).astype(np.float32)
    return Texels(rgb, problem.quality, problem.cos_v, problem.lobes, problem.groups)


def exact(**spec: Any) -> tuple[bench.Problem, Texels]:
    """A problem of the benchmark (a bumpy patch, 32 x 32 unless told), and its observations."""
    problem = bench.make(bench.Spec(**{"views": 12, "size": 32, **spec}))
    return problem, of_problem(problem)


def evaluate(device: Device, texels: Texels, kernel: str, at: np.ndarray, outputs: int, slack: float = 0.0,
             level: float | None = None, metallic: float = 0.0, **defines: str) -> list[np.ndarray]:
    """Outputs (h, w, 4) of a kernel beside this file at given numbers ``at`` (h, w, up to 4) of each texel."""
    source = texels.source(device)
    atlas = ObservationAtlas(device, source)
    for _ in source.gather(atlas, (0, 0), False):
        pass
    h, w = texels.quality.shape[:2]
    padded = np.zeros((h, w, 4), np.float32)
    padded[..., :at.shape[-1]] = at
    given = {"u_at": device.texture(w, h, 4, padded)}
    if level is not None:
        given["u_level"] = device.texture(w, h, 1, np.full((h, w), level, np.float32))
        defines["SPECULAR"] = "1"
    if source.tilts is not None:
        given |= source.tilts.textures()
        defines["TILTS"] = "1"
    tilt = {} if source.tilts is None else {"u_tilt": source.tilts.deviation}
    uniforms = {**tilt, **atlas.uniforms, "u_group_slack": slack, "u_tile": (0, 0)}
    if metallic:
        uniforms["u_metallic"] = metallic
        defines["METALLIC"] = "1"
    made = [device.texture(w, h) for _ in range(outputs)]
    target = device.framebuffer(made)
    device.kernel(str(HERE / kernel), target, Inputs(textures={
        "u_texel_position": source.position, "u_observations": atlas.texture,
        "u_principled_table": source.principled_table, **given,
    }, uniforms=uniforms, defines={**source.layers.defines(), "LOBES": "1", **defines}), region=(0, 0, w, h))
    result = [device.read(texture).astype(np.float64) for texture in made]
    for thing in (target, atlas, source, *made, *given.values()):
        thing.release()
    return result


class Twin:
    """The fit of solve/fit.glsl and solve/fit_two.glsl from their definition, float64; arrays are (texels, ...)."""

    def __init__(self, texels: Texels, slack: float, ndf: str = "ggx", level: float | None = None,
                 metallic: float = 0.0) -> None:
        self.slack, self.ndf, self.level, self.metallic = slack, ndf, level, metallic
        count = len(texels.groups)
        self.f = texels.observed().reshape(-1, count).astype(np.float64)
        self.cos_v = texels.cos_v.reshape(-1, count).astype(np.float64)
        self.lobes = texels.lobes.reshape(-1, count, *texels.lobes.shape[3:]).astype(np.float64)
        quality = texels.quality.reshape(-1, count).astype(np.float64)
        edge = np.zeros(quality.shape, bool) if texels.edge is None else texels.edge.reshape(-1, count) > 0
        self.good = ((quality > 0) & ~edge).sum(-1)
        self.whole = self._weights(quality, edge)
        names = list(dict.fromkeys(texels.groups))
        self.members = [np.array([n for n in range(count) if texels.groups[n] == name]) for name in names]
        self.channel = np.array([name % texels.channels for name in names])
        self.weight = self.whole if metallic else self._dropped(self.whole)
        self.taken = np.zeros(len(self.f))  # degrees of freedom, by tilts
        self.changes: list[np.ndarray] = []  # of each group (texels, k, 3): of whitened errors by a tilt
        self.tilts = self._tilts(texels) if texels.lamps is not None else []
        good = (quality > 0) & ~edge
        self.groups_seen = np.stack([good[:, members].any(-1) for members in self.members]).sum(0)

    def _weights(self, quality: np.ndarray, edge: np.ndarray) -> np.ndarray:
        """Relative to the observation where it is a highlight, else to the texel's typical one (docs/method.md)."""
        f = np.maximum(self.f, 0)
        typical = np.full(len(f), np.inf)
        for number in range(4):
            w = quality / (1.0 if number == 0 else np.maximum(f, typical[:, None]))
            typical = np.maximum((w * f).sum(-1) / np.maximum(w.sum(-1), 1e-12), 1e-4)
        self.typical = typical
        w = quality / np.maximum(f, typical[:, None]) ** 2
        return w * np.where(edge, 2.0 ** (-6.0 * np.minimum(self.good, 6))[:, None], 1.0)

    def _tilts(self, texels: Texels) -> list[np.ndarray]:
        """Of each group (texels, k, k): of whitened errors' covariance under unknown tilts the inverse's root."""
        assert texels.normal is not None and texels.lamps is not None
        normal = texels.normal.reshape(-1, 1, 1, 3).astype(np.float64)
        toward = texels.lamps[..., :3] - texels.lamps[..., 3:]  # of texels at (1, 1, 1)
        toward = toward / np.linalg.norm(toward, axis=-1, keepdims=True)
        sin2h, _, cos_l, factor = np.moveaxis(self.lobes, -1, 0)
        cos_v = self.cos_v[..., None]
        cos_vh = np.minimum((cos_l + cos_v) / (2 * np.sqrt(1 - sin2h)), 1)
        share = 2 * factor * cos_l * cos_v / brdf.F_dielectric(cos_vh)  # of the irradiance
        across = toward - (toward * normal).sum(-1, keepdims=True) * normal
        slope = (1 - self.metallic) * ((share / cos_l)[..., None] * across).sum(2)  # (texels, K, 3)
        roots = []
        for members in self.members:
            w, own = self.whole[:, members], slope[:, members]
            mean = np.einsum("tk,tki->ti", w, own) / np.maximum(w.sum(-1), 1e-300)[:, None]
            change = np.sqrt(w)[..., None] * self.typical[:, None, None] * (own - mean[:, None])
            self.changes.append(change)
            covariance = np.eye(len(members)) + np.einsum("tki,tli->tkl", change, change)
            inverse = np.linalg.inv(covariance)
            self.taken += len(members) - np.trace(inverse, axis1=1, axis2=2)
            values, vectors = np.linalg.eigh(inverse)
            roots.append(np.einsum("tki,ti,tli->tkl", vectors, np.sqrt(np.maximum(values, 0)), vectors))
        return roots

    def _dropped(self, weight: np.ndarray) -> np.ndarray:
        """Without those first of a group that weigh less than NEGLIGIBLE of what comes next: sums start there."""
        weight = weight.copy()
        for members in self.members:
            for i, n in enumerate(members):
                before = weight[:, members[:i]]
                weight[:, members[:i]] = np.where((before.sum(-1) < 1e-5 * weight[:, n])[:, None], 0, before)
        return weight

    def free(self) -> np.ndarray:
        """(texels,) degrees of freedom of the residual of one lobe: what is spent on albedos, tilts and the search."""
        within = np.maximum(self.good - self.groups_seen - self.taken, 0)
        between = np.maximum(self.groups_seen - 1, 0) / (1 + self.slack)
        return (within + between) * np.maximum(self.good - 2, 0.25) / np.maximum(self.good - 1, 0.5)

    def parts(self, r: np.ndarray, information: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """(a, s) of f = rho a + s at roughness r (texels); of a metal at the base colour that then comes out.

        ``information`` of its groups: frozen where given.
        """
        a, s = self.dielectric(r)
        if not self.metallic:
            return a, s
        black, white, energy = self.metal(r)
        base = np.full((len(r), self.channel.max() + 1), 0.5)
        for _ in range(300):
            gain = brdf.metal_gain(self.by_layer(base[:, self.channel]), energy)
            found = self.with_metal(a, s, black, white, gain)
            rho, own = self.groups(*found)[1:]
            said = self.between(rho, own if information is None else information, bounded=True)[1]
            base = 0.7 * base + 0.3 * np.clip(said, 0, 1)
        return found

    def with_metal(self, a: np.ndarray, s: np.ndarray, black: np.ndarray, white: np.ndarray, gain: np.ndarray,
                   ) -> tuple[np.ndarray, np.ndarray]:
        """(a, s) of the mixture from those of the dielectric, and what black and white metals return once."""
        m = self.metallic
        return (1 - m) * a + m * gain * (white - black), (1 - m) * s + m * gain * black

    def by_layer(self, values: np.ndarray) -> np.ndarray:
        """(texels, G) -> (texels, K)."""
        result = np.zeros_like(self.f)
        for group, members in enumerate(self.members):
            result[:, members] = values[:, [group]]
        return result

    def metal(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(black, white, energy): the lobe of a black and of a white metal without gain; (E1, Eavg)."""
        sin2h, radius2, cos_l, factor = np.moveaxis(self.lobes, -1, 0)
        alpha2, cos_v = r[:, None, None] ** 4, self.cos_v[..., None]
        roots = brdf.lambda_root(alpha2, 1 / cos_l**2 - 1) + brdf.lambda_root(alpha2, 1 / cos_v**2 - 1)
        cos_vh = np.minimum((cos_l + cos_v) / (2 * np.sqrt(1 - sin2h)), 1)
        lobe = factor / brdf.F_dielectric(cos_vh) * brdf.D_ggx_disc(alpha2, sin2h, radius2) / roots
        return (lobe * brdf.F_schlick(cos_vh)).sum(-1), lobe.sum(-1), brdf.metal_energy(r[:, None], self.cos_v)

    def dielectric(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(a, s) without metal."""
        r, cos_v = r[:, None], self.cos_v
        sin2h, radius2, cos_l, factor = np.moveaxis(self.lobes, -1, 0)
        alpha2 = r[..., None] ** 4
        slopes, root = {"ggx": (brdf.D_ggx_disc, brdf.lambda_root),
                        "beckmann": (brdf.D_beckmann_disc, brdf.lambda_root_beckmann)}[self.ndf]
        roots = root(alpha2, 1 / cos_l**2 - 1) + root(alpha2, 1 / cos_v[..., None] ** 2 - 1)
        s = factor * slopes(alpha2, sin2h, radius2) / roots
        if self.ndf == "beckmann":
            return np.full(cos_v.shape, 1 / np.pi), s.sum(-1)
        if self.level is None:
            energy = brdf.principled_energy(r, cos_v)
        else:
            energy = brdf.principled_energy_level(r, cos_v, self.level)
            cos_vh = np.minimum((cos_l + cos_v[..., None]) / (2 * np.sqrt(1 - sin2h)), 1)
            s = s * brdf.F_level_ratio(cos_vh, self.level)
        return (1 - energy[..., 1]) / np.pi, s.sum(-1) * energy[..., 0]

    def mixed(self, r1: np.ndarray, r2: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same of two lobes."""
        (a1, s1), (a2, s2) = self.parts(r1), self.parts(r2)
        return w[:, None] * a1 + (1 - w[:, None]) * a2, w[:, None] * s1 + (1 - w[:, None]) * s2

    def groups(self, a: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Errors within groups (texels, K), whitened; albedo of each group (texels, G) and its information.

        rho_group = rho + delta, delta normal with a variance of slack rho_group^2 in units of the noise's.
        """
        within, rho, information = np.zeros_like(self.f), [], []
        for members in self.members:
            w, d, own_a = self.weight[:, members], (self.f - s)[:, members], a[:, members]
            total = (w * own_a**2).sum(-1)
            own = (w * own_a * d).sum(-1) / np.where(total > 0, total, 1)
            within[:, members] = np.sqrt(w) * (d - own[:, None] * own_a)
            rho.append(own)
            of_own = np.where(total > 0, 1 / np.where(total > 0, total, 1), np.inf)
            information.append(1 / (of_own + self.slack * own**2))
        return within, np.stack(rho, -1), np.stack(information, -1)

    def between(self, rho: np.ndarray, information: np.ndarray, bounded: bool) -> tuple[np.ndarray, np.ndarray]:
        """Errors of groups about the one albedo of their channel (texels, G), whitened; those albedos (texels, C)."""
        off, best = np.zeros_like(rho), []
        for channel in np.unique(self.channel):
            mine = self.channel == channel
            w = information[:, mine]
            mean = (w * rho[:, mine]).sum(-1) / np.maximum(w.sum(-1), 1e-300)
            mean = np.clip(mean, 0, 1) if bounded else mean
            off[:, mine] = np.sqrt(w) * (rho[:, mine] - mean[:, None])
            best.append(mean)
        return off, np.stack(best, -1)

    def errors(self, a: np.ndarray, s: np.ndarray, information: np.ndarray | None = None,
               bounded: bool = True) -> np.ndarray:
        """All whitened errors (texels, K + G); ``information`` frozen (Kaufman 1975) where given."""
        within, rho, own = self.groups(a, s)
        for members, root in zip(self.members, self.tilts, strict=False):
            within[:, members] = np.einsum("tkl,tl->tk", root, within[:, members])
        return np.concatenate([within, self.between(rho, own if information is None else information, bounded)[0]], -1)


def slope(function: Any, at: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Central difference."""
    return np.asarray((function(at + step) - function(at - step)) / (2 * step))


def random_texels(groups: tuple[int, ...], channels: int = 1, lights: int = 2, spread: float = 0.05, size: int = 16,
                  seed: int = 3) -> Texels:
    """Observations that no material explains; some are not made, some are edges, one corner has none."""
    rng = np.random.default_rng(seed)
    shape = (size, size, len(groups))
    quality = rng.choice([0.0, 0.3, 1.0], shape, p=[0.2, 0.3, 0.5])
    quality[:3, :4] = 0.0
    quality[4, :, :2] = 0.0
    lobes = np.stack([rng.uniform(0.02, 0.4, (*shape, lights)), rng.uniform(0, spread, (*shape, lights)),
                      rng.uniform(0.2, 1, (*shape, lights)), rng.uniform(0.01, 0.2, (*shape, lights))], axis=-1)
    camera = np.array(groups) // channels
    cos_v = rng.uniform(0.2, 1.0, (size, size, camera.max() + 1))[:, :, camera]
    edge = (rng.random(shape) < 0.2).astype(np.float32)
    edge[..., (camera == 0) & (channels == 3)] = 0  # sums over groups refer to a channel's first
    return Texels(rng.uniform(0.02, 0.5, (*shape, 3)).astype(np.float32), quality.astype(np.float32),
                  cos_v.astype(np.float32), lobes.astype(np.float32), groups, edge, channels)


def known_roughly(texels: Texels, seed: int = 5) -> Texels:
    """The same with normals and lamps, of which some are suns."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((*texels.quality.shape[:2], 3))
    place = rng.uniform(-3, 5, (len(texels.groups), texels.lobes.shape[3], 4))
    place[..., 3] = rng.random(place.shape[:2]) < 0.7
    return replace(texels, normal=normal / np.linalg.norm(normal, axis=-1, keepdims=True), lamps=place)


def known(texels: Texels) -> np.ndarray:
    """Texels with an observation, flat."""
    return np.asarray((texels.quality > 0).any(-1).ravel())


def with_values(texels: Texels, f: np.ndarray) -> Texels:
    """The same geometry with other observations, (texels, K), the same in R, G and B."""
    shape = texels.quality.shape
    rgb = np.repeat(f.reshape(*shape, 1), 3, -1).astype(np.float32)
    return replace(texels, rgb=rgb)

