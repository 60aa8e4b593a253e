"""Observations -> roughness per texel: gather, search, share with neighbours, polish.

The search of a texel is one draw of one fused kernel (shaders/solve/search.kernel), tile by tile (tile_passes.py).
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import moderngl
import numpy as np

from ...core.data import F32, Bool, JointPrior
from ...core.errors import BadInput
from ...core.job import Progress
from ...core.params import SolveSettings
from ...core.tiled.tiled_plan import Noise, PriorKnowledge, Typical
from ..device.context import Device, Inputs, Textures
from ..observe.observation_atlas import CAMERA_SLACK, Source, Tile, tiles
from . import neighbours
from .texel_records import RoughnessMaps, read_residual, read_support
from .tile_passes import KernelPass, TilePasses, Uniforms
from .typical import UNKNOWN, typical

FIRST_SLACK = 300.0  # between-camera variance of albedo in units of the noise's, before the noise is known
QUIET = 3e-4  # relative noise below which ...
SURE = 0.02  # ... texels this sure of their roughness ...
UNSURE_SHARE = 0.05  # ... but for this share of them, need no neighbours
ROBUST_SEARCHES = 4  # at most
SQUARE, SAMPLED = 32, 4096  # texels: width of a square, of which each fourth is searched first; so many at least
POLISH_STEPS = 4  # Levenberg-Marquardt, from each valley
LEVEL_STEPS = 3  # the same at each Specular IOR Level that a texel tries
CONTRADICTS = 10.0  # strength of a material's prior from which on it may contradict observations
STRIDES = (1, 2, 1)  # two lobes: how far away the neighbours are whose pairs a texel tries, pass by pass
QUIET_PASSES = 1  # of them, without noise
TAU = 0.03  # two lobes: how much the roughnesses of neighbours differ
METHODS = {  # knobs of the search kernel: particles, moves of the swarm, refinement steps of all and of the best two
    "refined": {"u_particles": 6, "u_moves": 0, "u_race_steps": 2, "u_final_steps": 6},
    "draft": {"u_particles": 4, "u_moves": 0, "u_race_steps": 2, "u_final_steps": 4},
    "swarm": {"u_particles": 16, "u_moves": 10, "u_race_steps": 0, "u_final_steps": 4},
}
TWO_LOBES = {  # the valleys of two lobes are long and curved: more steps
    "refined": {"u_particles": 8, "u_moves": 0, "u_race_steps": 4, "u_final_steps": 16},
    "draft": {"u_particles": 6, "u_moves": 0, "u_race_steps": 2, "u_final_steps": 6},
    "swarm": {"u_particles": 16, "u_moves": 25, "u_race_steps": 0, "u_final_steps": 4},
}
STARTED = {  # the same where a texel's last roughness is known and is the first particle
    "refined": {"u_started": 3}, "draft": {"u_started": 2}, "swarm": {"u_started": 6},
}
GIVEN: Uniforms = {"u_particles": 1, "u_moves": 0, "u_race_steps": 0, "u_final_steps": 0, "u_started": 1}
STARTED_TWO = {"refined": {"u_started": 3}, "draft": {"u_started": 2}, "swarm": {"u_started": 6}}


@dataclass(frozen=True)
class Searched:
    """Where the search of one lobe has ended.  Its textures belong to the scope in which it was made."""

    tiles: list[Tile]  # that are done: fewer than were asked for when stopped
    outputs: list[moderngl.Texture]  # of the search kernel
    variance: float  # of the noise, relative


class Solver(TilePasses):
    """Roughness of every texel that a source observes."""

    def __init__(
        self, device: Device, source: Source, settings: SolveSettings, tile: tuple[int, int] | None = None,
        start: moderngl.Texture | None = None, before: PriorKnowledge | None = None,
    ) -> None:
        """``start``: where each texel's search begins, as EarlierResult.lobes; it is the caller's.

        ``before``: what is known already, and not to be taken from this part of a map.
        """
        super().__init__(device, source, settings, tile, start)
        self.before = before or PriorKnowledge()
        self.slack = FIRST_SLACK
        self.covered = device.read(source.position)[..., 3] > 0.5
        self.robust = False  # whether the last solve of one lobe disbelieved outliers
        self.noise_of: dict[int, Noise] = {}  # by lobes, of the last solve
        self.noise = 0.0  # relative, as the last solve found it (median)
        self.joint: JointPrior | None = None  # of one lobe; None: texels know their neighbours alone
        self.noise_map: moderngl.Texture | None = None  # log variance of it, see neighbours.noise_map
        method = settings.method if settings.method in METHODS else "refined"
        self.knobs: dict[int, Uniforms] = {1: METHODS[method], 2: TWO_LOBES[method]}  # by lobes
        if start is not None:
            self.knobs = {1: METHODS[method] | STARTED[method], 2: TWO_LOBES[method] | STARTED_TWO[method]}

    def solve(self, only: list[Tile] | None = None) -> Generator[Progress, None, RoughnessMaps]:
        """One lobe: search every texel alone, pool what texels say, and polish each under its neighbours' prior.

        ``only``: these tiles.
        """
        chosen = tiles(self.atlas, self.covered) if only is None else only
        roughness, detail = self.textures(2)
        with self.device.scope() as owned, self._given():
            searched = yield from self.searched(chosen)
            yield from self._finish(searched, [roughness, detail])
            owned.hand_over(self.noise_map)
        return RoughnessMaps(roughness, detail)

    def alone(self, searched: Searched) -> RoughnessMaps:
        """What each texel's own search has found."""
        roughness, detail = self.textures(2)
        self._last_word(searched, [roughness, detail], -1.0)
        return RoughnessMaps(roughness, detail)

    def among_neighbours(self, searched: Searched) -> Generator[Progress, None, RoughnessMaps]:
        """The rest of `solve`."""
        roughness, detail = self.textures(2)
        yield from self._finish(searched, [roughness, detail])
        return RoughnessMaps(roughness, detail)

    @contextmanager
    def _given(self) -> Iterator[None]:
        """Where the material has one roughness: what a search of that alone says of noise and base colour."""
        if self.joint is None or not self.joint.one_value:
            yield
            return
        knobs, start = self.knobs, self.start
        width, height = self.source.size
        value = np.array([self.joint.roughness, self.joint.roughness, 1.0, 1.0], np.float32)
        self.knobs, self.start = {**knobs, 1: GIVEN}, self.device.texture(
            width, height, data=np.broadcast_to(value, (height, width, 4)))
        try:
            yield
        finally:
            self.knobs, self.start = knobs, start

    def under_priors(self, priors: Sequence[JointPrior | None]) -> Generator[Progress, None, list[F32]]:
        """(h, w) roughness of one lobe under each prior of the material, from one search."""
        results = []
        with self.device.scope() as owned:
            searched = yield from self.searched(tiles(self.atlas, self.covered))
            outputs = self.textures(2)
            for prior in priors:
                self.joint = prior
                yield from self._finish(searched, outputs)
                results.append(self.device.read(outputs[0])[..., 0].copy())
            self.joint = None
            owned.hand_over(self.noise_map)
        return results

    def levels_under(
        self, priors: Sequence[JointPrior], only: list[Tile] | None = None,
    ) -> Generator[Progress, None, list[tuple[F32, F32]]]:
        """Each texel's Specular IOR Level under each prior of the material; all priors are about the same level.

        (h, w) each: the level, and the variance that not knowing it adds to that of the roughness.  The level in use is
        another one afterwards.  ``only``: of these tiles.
        """
        levels = []
        with self.device.scope() as owned:
            self.use_level(np.full(self.source.size[::-1], priors[0].level, np.float32))
            self.joint = priors[0]  # outliers are believed, as of `_believed`
            searched = yield from self.searched(only)
            outputs = self.textures(1)
            for prior in priors:
                self.joint = prior
                yield from self.run(searched.tiles, (0.5, 1.0), KernelPass(
                    "solve/level.kernel", outputs, self._valleys(searched.outputs), {
                        **self._floor(searched.variance), **self._joint(), "u_joint_level": prior.level,
                        "u_level_strength": prior.level_strength, "u_steps": LEVEL_STEPS}))
                found = self.device.read(outputs[0])
                levels.append((found[..., 0].copy(), found[..., 1].copy()))
            self.joint = None
            owned.hand_over(self.noise_map)
        return levels

    def searched(self, chosen: list[Tile] | None = None) -> Generator[Progress, None, Searched]:
        """Search every texel alone, for one lobe.  ``chosen``: these tiles."""
        chosen, outputs = tiles(self.atlas, self.covered) if chosen is None else chosen, self.textures(3)
        done = yield from self._search(chosen, outputs, 1)
        chosen = chosen[:done]  # fewer when stopped: these are finished, the rest is filled from them
        variance = self._noise(outputs[0], outputs[1], 1)
        outputs, variance = yield from self._believed(chosen, outputs, variance)
        if self.source.misfit > 0:  # outliers are those of the noise itself
            variance = self._noise(outputs[0], outputs[1], 1, self.source.misfit)
        self.noise_of[1] = self.before.noise.get(
            1, Noise(variance, self._unsure(variance, outputs[1]), tilt=self._tilt()))
        return Searched(chosen, outputs, variance)

    def _finish(self, searched: Searched, outputs: list[moderngl.Texture]) -> Generator[Progress, None, None]:
        """From what the search has found to roughness and detail."""
        given = self.joint is not None and self.joint.one_value
        if not given and (self.noise_of[1].neighbours or self.joint is not None):
            yield from self._with_neighbours(searched.tiles, searched.outputs, searched.variance, outputs)
        else:
            self._last_word(searched, outputs, self.joint.sigma if self.joint is not None else -1.0)

    def _last_word(self, searched: Searched, outputs: list[moderngl.Texture], given_sigma: float) -> None:
        """Without neighbours.  ``given_sigma``: standard error of a roughness that was given; -1: it was searched."""
        inputs = Inputs({**self._valleys(searched.outputs), "u_extra": searched.outputs[2]},
                        {**self._floor(searched.variance), "u_given_sigma": given_sigma})
        with self.device.target(outputs) as target:
            self.device.kernel("solve/finish.kernel", target, inputs, (0, 0, *self.source.size))

    def _valleys(self, searched: list[moderngl.Texture]) -> dict[str, Textures]:
        """What the search has found, and its noise, as later kernels read them."""
        return {"u_valleys": searched[0], "u_support": searched[1], "u_noise": self.noise_map}

    def _with_neighbours(
        self, chosen: list[Tile], searched: list[moderngl.Texture], variance: float, outputs: list[moderngl.Texture],
    ) -> Generator[Progress, None, None]:
        """Pool what texels say, and polish each under its neighbours' prior."""
        valleys, floor = self._valleys(searched), {**self._floor(variance), **self._joint()}
        with self.device.scope():
            judged = 1 not in self.before.noise and not self.metallic
            colour, *errors = own = self.textures(2 if judged else 1)
            tables = self.textures(8)
            yield from self.run(chosen, (0.5, 0.8), self._albedo(own, searched[0], 1), KernelPass(
                "solve/table.kernel", tables, valleys, floor, robust=self.robust))
            for texture in errors:
                self.noise_of[1] = replace(self.noise_of[1], alike=neighbours.alike(
                    self.device.read(texture), self.source.stride))
                texture.release()
            if 1 not in self.before.noise:
                self.noise_of[1] = replace(
                    self.noise_of[1], typical=self._typical(Searched(chosen, searched, variance), colour))
            # A metal's errors were not compared.
            noise = replace(self.noise_of[1], alike=0.0) if self.metallic else self.noise_of[1]
            estimate, prior = neighbours.pyramid(
                self.device, tuple(tables), colour,
                neighbours.shared_by(noise, self.source.shared_error, self.source.misfit > 0),
                self.source.extent, self.before, self.noise_of[1].typical or (UNKNOWN,))
            colour.release()
            yield from self.run(chosen, (0.8, 1.0), KernelPass(
                "solve/polish.kernel", outputs, {**valleys, "u_estimate": estimate, "u_prior": prior},
                {**floor, "u_prior_cut": neighbours.PRIOR_CUT, "u_steps": POLISH_STEPS}, robust=self.robust))

    def _typical(self, searched: Searched, colour: moderngl.Texture) -> tuple[Typical, ...]:
        """What texels say of others.  Blocks of a map have what the small map says, which is alike in all."""
        with self.device.scope():
            outputs = self.textures(2)
            self._last_word(searched, outputs, -1.0)
            roughness, sigma, _, solved = np.moveaxis(self.device.read(outputs[0]), -1, 0)
        known = solved > 0.5
        return typical(roughness[known], sigma[known], self.device.read(colour)[known, :3])

    def _joint(self) -> Uniforms:
        if self.joint is None:
            return {}
        values = (self.joint.roughness, *self.joint.others)
        return {"u_joint_roughness": (*values, *[values[0]] * (3 - len(values))),
                "u_joint_strength": self.joint.strength}

    def _believed(
        self, chosen: list[Tile], plain: list[moderngl.Texture], variance: float,
    ) -> Generator[Progress, None, tuple[list[moderngl.Texture], float]]:
        """Where the search has left outliers, search again without believing them: (what to go on from, noise).

        Where the model is wrong its errors look like outliers: then roughness becomes rougher from texel to texel,
        and the plain search stands.  Of a large map some squares may say that already.
        """
        self.robust, loss = False, self.settings.loss
        # Under a material's prior outliers are believed, as when it was judged: a lobe that flashes may not make
        # outliers of what it contradicts.  A weak prior contradicts nothing.  (Blocks have the loss that their plan has
        # judged, of texels without a prior.)
        strong = self.joint is not None and self.joint.strength >= CONTRADICTS
        if loss == "squares" or (strong and (loss == "auto" or 1 in self.before.noise)):
            return plain, variance
        if not self.finishes_robust():
            if loss == "auto":
                return plain, variance
            raise BadInput("loss robust: there are more views than it can take without a GPU; leave views out, or "
                           "choose loss auto")
        support = read_support(self.device, plain[1])
        observed = support.observed
        clean, outliers = neighbours.clean_noise(
            read_residual(self.device, plain[0], 1)[observed], support.degrees[observed], self.source.tilts is not None)
        if not outliers and loss == "auto":
            return plain, variance
        wary, share, smoother = self.textures(3), min(clean / variance, 1.0), True
        some = observed & _squares(observed.shape)
        if loss == "auto" and self.position is None and int(some.sum()) > SAMPLED:
            self.use_texels(some)
            _, smoother = yield from self._wary(chosen, plain, wary, share, some)
            self.use_texels(None)
        if smoother:
            variance, smoother = yield from self._wary(chosen, plain, wary, share, observed)
        self.robust = loss == "robust" or smoother
        for texture in plain if self.robust else wary:
            texture.release()  # now: the tables need the memory
        return (wary, variance) if self.robust else (plain, self._noise(plain[0], plain[1], 1))

    def _wary(
        self, chosen: list[Tile], plain: list[moderngl.Texture], wary: list[moderngl.Texture], share: float,
        texels: Bool,
    ) -> Generator[Progress, None, tuple[float, bool]]:
        """Search, into ``wary``, without believing outliers: (noise, whether neighbours differ less in roughness).

        ``share``: of the noise of the ``plain`` search that is not outliers'.  ``texels``: (h, w) those that are
        searched.
        """
        variance = self._noise(plain[0], plain[1], 1)
        for _ in range(ROBUST_SEARCHES):
            yield from self.run(chosen, (0.4, 0.5), KernelPass(
                "solve/search.kernel", wary, {"u_noise": self.noise_map},
                {**self._search_uniforms(1), "u_noise_share": share, **self._floor(variance)}, robust=True))
            before, share = share * variance, 1.0
            variance = self._noise(wary[0], wary[1], 1)
            if variance > 0.5 * before:  # else there were outliers in every texel, which hid each other
                break
        rough = [neighbours.scatter(self.device.read(maps[0])[..., 0], texels) for maps in (plain, wary)]
        return variance, rough[1] < rough[0]

    def solve_two(self, only: list[Tile] | None = None) -> Generator[Progress, None, RoughnessMaps]:
        """Two lobes: search every texel alone, then let it try its neighbours' pairs under a prior about their mean.

        ``detail`` of the result holds no residual without lobe.
        """
        chosen = tiles(self.atlas, self.covered) if only is None else only
        with self.device.scope() as owned:
            pairs, support, variances = self.textures(3)
            done = yield from self._search(chosen, [pairs, support, variances], 2)
            chosen = chosen[:done]
            variance = self._noise(pairs, support, 2, self.source.misfit)
            floor = {**self._floor(variance), "u_prior_cut": neighbours.PRIOR_CUT, "u_steps": 6}
            self.noise_of[2] = self.before.noise.get(2, Noise(
                variance, variance > QUIET**2, tilt=self._tilt()))
            pooled = self.noise_of[2].neighbours
            # The search's third output is curvature; the passes below want variances.
            self._invert(variances, support, variance)
            before, after = [pairs, variances, support], self.textures(3)  # pairs, variances, detail
            strides = STRIDES if pooled else STRIDES[:QUIET_PASSES]
            for i, stride in enumerate(strides):
                span = (0.5 + 0.5 * i / len(strides), 0.5 + 0.5 * (i + 1) / len(strides))
                yield from self.run(chosen, span, KernelPass(
                    "solve/polish_two.kernel", after,
                    {"u_pairs": before[0], "u_variance": before[1], "u_noise": self.noise_map},
                    {**floor, "u_stride": stride, "u_tau": TAU if pooled else 0.0}, lobes=2))
                before, after = after, before
            roughness = self._as_roughness(*before)
            owned.hand_over(roughness, before[0], before[2], self.noise_map)
            return RoughnessMaps(roughness, before[2], before[0])

    def search(self, only: list[Tile]) -> Generator[Progress, None, tuple[moderngl.Texture, moderngl.Texture]]:
        """One lobe, the search alone: (roughness and residual of the two best valleys, support), see search.kernel."""
        with self.device.scope() as owned:
            valleys, support, extra = self.textures(3)
            yield from self._search(only, [valleys, support, extra], 1)
            owned.hand_over(valleys, support)
            return valleys, support

    def _search(
        self, chosen: list[Tile], outputs: list[moderngl.Texture], lobes: int
    ) -> Generator[Progress, None, int]:
        self.slack = FIRST_SLACK if self.source.camera_slack else 0.0
        return (yield from self.run(chosen, (0.0, 0.5), KernelPass(
            "solve/search.kernel", outputs, {}, self._search_uniforms(lobes), lobes)))

    def _search_uniforms(self, lobes: int) -> Uniforms:
        return {"u_seed": self.settings.seed, **self.knobs[lobes]}

    def _floor(self, variance: float) -> Uniforms:
        """Variances of the noise that are assumed where the map of it says less, or nothing."""
        return {"u_noise_floor": max(neighbours.NOISE_FLOOR, self.source.shared_error),
                "u_noise_unknown": self.source.camera_slack**2 or variance}

    def albedo(self, lobe_map: moderngl.Texture, lobes: int = 1) -> Generator[Progress, None, moderngl.Texture]:
        """Base colour of each texel from its own observations alone; ``lobe_map``: roughness, or the pairs of lobes."""
        outputs = self.textures(1)
        yield from self.run(tiles(self.atlas, self.covered), (0.0, 1.0), self._albedo(outputs, lobe_map, lobes))
        return outputs[0]

    def _albedo(self, outputs: list[moderngl.Texture], lobe_map: moderngl.Texture, lobes: int) -> KernelPass:
        """Base colour and, where a second output is given, errors for `neighbours.alike`: of one lobe, of no metal."""
        robust = self.robust and lobes == 1
        return KernelPass(
            "solve/albedo.kernel", outputs, {"u_found": lobe_map, **({"u_noise": self.noise_map} if robust else {})},
            self._floor(self.noise**2) if robust else {}, lobes, colour=True, robust=robust)

    def _noise(
        self, valleys: moderngl.Texture, support: moderngl.Texture, lobes: int, misfit: float = 0.0,
    ) -> float:
        """Maps the noise; returns its median variance, by which the slack between cameras is set too.

        ``misfit``: as of `Source`.
        """
        # Under an environment noise is the scatter between cameras: what is typical where no texel can tell.
        scatter = CAMERA_SLACK if self.source.layers.environment else neighbours.NOISE_FLOOR
        unknown = (self.source.camera_slack or scatter)**2
        cells = None if self.before.roughness is None else self.before.roughness.shape[1]
        noise, variance = neighbours.noise_map(
            self.device, valleys, support, lobes, unknown, cells, misfit, self.source.tilts is not None)
        if lobes in self.before.noise:
            variance = self.before.noise[lobes].variance
        if self.noise_map is not None:
            self.noise_map.release()
        self.noise_map, self.noise = noise, float(np.sqrt(variance))
        if self.source.camera_slack:
            self.slack = float(np.clip(self.source.camera_slack**2 / variance, 1.0, 1e5))
        return variance

    def _tilt(self) -> float:
        return self.source.tilts.deviation if self.source.tilts is not None else 1.0

    def _unsure(self, variance: float, support: moderngl.Texture) -> bool:
        """Whether the noise leaves texels that need their neighbours."""
        if variance > QUIET**2:
            return True
        here = read_support(self.device, support)
        unsure = (here.observations < 2.5) | (here.curvature * SURE**2 < variance)
        return int(np.sum(unsure & here.observed)) > UNSURE_SHARE * max(int(np.sum(here.observed)), 1)

    def _invert(self, curvature: moderngl.Texture, support: moderngl.Texture, variance: float) -> None:
        """Curvatures (r1 r1, r1 r2, r2 r2) become variances of r1 and r2, and whether observed, in place."""
        bend = self.device.read(curvature).astype(np.float64) / max(variance, 1e-12)
        observed = self.device.read(support)[..., 3:]
        determinant = np.maximum(bend[..., 0] * bend[..., 2] - bend[..., 1] ** 2, 1e-6 * bend[..., 0] * bend[..., 2])
        result = np.stack([bend[..., 2], bend[..., 0]], axis=-1) / np.maximum(determinant, 1e-12)[..., None]
        result = np.concatenate([np.clip(result, 1e-8, 0.25), np.zeros_like(observed), observed], axis=-1)
        curvature.write(np.ascontiguousarray(result, np.float32).tobytes())

    def _as_roughness(
        self, pairs: moderngl.Texture, variances: moderngl.Texture, detail: moderngl.Texture,
    ) -> moderngl.Texture:
        """The result of two lobes in the form of one: the sharper roughness, the larger standard error."""
        device = self.device
        pair, variance, numbers = (device.read(texture) for texture in (pairs, variances, detail))
        sigma = np.sqrt(np.minimum(variance[..., 2], 0.25))
        roughness = np.stack([pair[..., 0], sigma, numbers[..., 2], variance[..., 3]], axis=-1)
        return device.texture(*self.source.size, data=roughness)

    def release(self) -> None:
        """Free the atlas and the map of the noise."""
        self.atlas.release()
        if self.noise_map is not None:
            self.noise_map.release()


def _squares(shape: tuple[int, ...]) -> Bool:
    """(h, w) each fourth square of SQUARE texels."""
    row, column = (np.arange(length) // SQUARE % 2 == 0 for length in shape)
    return np.asarray(row[:, None] & column)
