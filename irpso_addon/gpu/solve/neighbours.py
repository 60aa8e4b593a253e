"""What texels tell their neighbours: how noisy the data are, and which roughnesses explain them.

Residual tables are summed up a pyramid and estimates handed down as priors: docs/decisions/0004.
"""

from __future__ import annotations

from dataclasses import dataclass

import moderngl
import numpy as np

from ...core.data import F32, Bool
from ...core.tiled.tiled_plan import Noise, PriorKnowledge, Typical
from ..device.context import Device, Inputs
from .typical import UNKNOWN

NOISE_FLOOR = 1e-4  # relative: float32 and the forward model's own error
NOISE_LEVELS = 4  # noise is averaged over 16 x 16 texels
LEAST_KNOWN = 0.1  # of 1: how far the noise of a cell must be known
PRIOR_CUT = 15.0  # an edge in the map costs no more than this, in nats
LEAST_DEGREES = 3.0  # of freedom from which on a texel says something of the noise, where there are such texels
TAIL, TAIL_Z = 0.9, 1.2816  # share of texels below the upper tail, and its place under a normal distribution
FAR = 2.0  # log of a variance: outliers make their texels' so much larger, ...
GROSS = 0.01  # ... and leave relative errors of this size: finer ones are the model's, and alike in neighbours
NOISE_MOST = 0.06  # relative: more is not noise, but outliers in every texel: then ...
NOISE_GUESS = 0.02  # ... this much is taken for a start
ALIKE = 0.5  # how much four texels say that share the model's error, in units of what they would say if they did not
COMMON = 0.25  # the same where errors are seen to be alike, or normals are refined, which are still off alike: as one
REFINED_ERROR = 0.003  # relative: what that makes of an observation, at least
EVIDENCE = 0.8  # how much of tables counts where kinds are told apart: a texel is in many cells, some part by chance
APART = 4  # texels of the map between those whose errors are compared: pixels are mostly smaller
OUTLYING = 4.5  # times the median size: three standard deviations
ROUGHNESS_SLOPE = 3.0  # expected change of roughness across the UV square: a cell may differ so much from its parent
TABLE_TILES = 4  # across a texture that holds the 16 tables of both kinds
NOTHING = PriorKnowledge()
Textures = tuple[moderngl.Texture, ...]


def noise_map(
    device: Device, valleys: moderngl.Texture, support: moderngl.Texture, lobes: int, unknown: float,
    cells: int | None = None, misfit: float = 0.0, tilts: bool = False,
) -> tuple[moderngl.Texture, float]:
    """(log variance of the relative noise around each texel, at 1 / 2^NOISE_LEVELS of the size; its median variance).

    ``unknown``: variance where no camera has views enough to tell: only the scatter between cameras does then.
    ``cells``: in a row, of those that lie alike in neighbouring blocks: noise is averaged over no larger ones.
    ``misfit``: as of `Source`.  ``tilts``: as of `telling`.
    """
    levels = NOISE_LEVELS if cells is None else min(NOISE_LEVELS, (valleys.width // cells).bit_length() - 1)
    noise = _averaged_noise(device, valleys, support, lobes, levels)
    values = device.read(noise).copy()
    if tilts and not np.any(values[..., 3] > LEAST_KNOWN):  # two lamps a camera: tilts explain most of their difference
        noise.release()
        noise = _averaged_noise(device, valleys, support, lobes, levels, few=True)
        values = device.read(noise).copy()
    if misfit > 0:
        values[..., 0] = np.logaddexp(values[..., 0], 2 * np.log(misfit))
        noise.write(values.tobytes())
    known = values[values[..., 3] > LEAST_KNOWN, 0]
    variance = float(np.exp(np.median(known))) if len(known) else unknown
    return noise, max(variance, NOISE_FLOOR**2)


def _averaged_noise(
    device: Device, valleys: moderngl.Texture, support: moderngl.Texture, lobes: int, levels: int, few: bool = False,
) -> moderngl.Texture:
    """Log variance and how far it is known, over ever larger cells.  ``few``: degrees of freedom in all texels."""
    with device.scope() as owned:
        noise = device.texture(*valleys.size)
        with device.target([noise]) as target:
            device.draw("solve/noise.frag", target, Inputs(
                {"u_valleys": valleys, "u_support": support}, {"u_few": few}, {"LOBES": str(lobes)}))
        for _ in range(levels):
            finer = noise
            noise = device.texture((finer.width + 1) // 2, (finer.height + 1) // 2)
            with device.target([noise]) as target:
                device.draw("maps/fill_down.frag", target, Inputs({"u_map": finer}))
        owned.hand_over(noise)
    return noise


def telling(degrees: F32, tilts: bool) -> Bool:
    """(N,) texels of (N,) whose residuals tell the noise: LEAST_DEGREES.

    ``tilts``: those of normals have taken some of them.  Then as many as the best tenth has are enough, 1 at least.
    """
    most = float(np.quantile(degrees, 0.9)) if tilts and len(degrees) else LEAST_DEGREES
    return np.asarray(degrees >= min(LEAST_DEGREES, max(most, 1.0)))


def clean_noise(residual: F32, degrees: F32, tilts: bool = False) -> tuple[float, bool]:
    """(variance of the noise without outliers, whether there are outliers) from what fits leave, (N,) each.

    Infinite where no texel tells.  ``tilts``: as of `telling`.

    Texels that no outlier touched are the lower tail: its place under normal noise (chi-squared, by Wilson and
    Hilferty 1931) tells the variance.  There are outliers where the upper tail lies far above its own place.
    """
    informed = telling(degrees, tilts)
    if not informed.any():
        return np.inf, False
    log = np.log(np.maximum(residual[informed] / degrees[informed], 1e-12))
    step = 2 / (9 * degrees[informed])
    low, high = (np.quantile(log - 3 * np.log1p(-step + z * np.sqrt(step)), share)
                 for z, share in ((-TAIL_Z, 1 - TAIL), (TAIL_Z, TAIL)))
    if low > 2 * np.log(NOISE_MOST):
        return NOISE_GUESS**2, True
    return max(float(np.exp(low)), NOISE_FLOOR**2), bool(high - low > FAR and high > 2 * np.log(GROSS))


def alike(errors: F32, stride: int = 1) -> float:
    """0..1: how far errors of texels that are APART are alike (their correlation).

    ``errors``: (h, w, 4) three sums of each texel's errors with random signs (Hutchinson 1990, "A stochastic estimator
    of the trace of the influence matrix"), as of solve/albedo.kernel, and 1 where observed.
    ``stride``: as of `Source`.
    """
    seen = errors[..., 3] > 0
    if not seen.any():
        return 0.0
    limit = OUTLYING * float(np.median(np.abs(errors[seen, :3])))
    product = square = 0.0
    apart = max(APART // stride, 1)
    for i in range(3):
        sums = np.clip(errors[..., i], -limit, limit)
        for a, b in ((np.s_[:, apart:], np.s_[:, :-apart]), (np.s_[apart:], np.s_[:-apart])):
            both = seen[a] & seen[b]
            one, other = sums[a][both], sums[b][both]
            product += float(np.sum(one * other, dtype=np.float64))
            square += 0.5 * float(np.sum(one * one + other * other, dtype=np.float64))
    return min(max(product / square, 0.0), 1.0) if square > 0 else 0.0


@dataclass(frozen=True)
class Shared:
    """Which part of the noise's variance neighbours share, 0..1, and how much four say together if they share all."""

    part: float
    together: float = ALIKE

    def gain(self, level: int) -> float:
        """Of 1: how much four cells of a level say together, in units of what they say apart; texels are level 0.

        What is each texel's own is a quarter in the mean of four cells, and of the rest the variance is
        1 / (4 together) of theirs.  So the larger the cells are, the more is it that which is left.
        """
        own, common = (1 - self.part) * 4.0**-level, self.part * (4 * self.together) ** -level
        return (own + common) / (own + common / self.together)


def shared_by(noise: Noise, shared_error: float, refined: bool) -> Shared:
    """What neighbours share of some noise.  ``shared_error``: as of `Source`; ``refined``: normals are."""
    model = min(shared_error**2 / noise.variance, 1.0)
    common = max(noise.alike, min(REFINED_ERROR**2 / noise.variance, 1.0) if refined else 0.0)
    return Shared(common, COMMON) if common > model or refined else Shared(model)


def scatter(roughness: F32, observed: Bool) -> float:
    """Mean difference of roughness between neighbouring texels, (h, w) each; 0 where none are observed."""
    across = np.abs(np.diff(roughness, axis=1))[observed[:, 1:] & observed[:, :-1]]
    along = np.abs(np.diff(roughness, axis=0))[observed[1:] & observed[:-1]]
    both = np.concatenate([across, along])
    return float(both.mean(dtype=np.float64)) if len(both) else 0.0


@dataclass(frozen=True)
class Cells:
    """One level of the pyramid, as shaders/solve/cells.glsl reads it.

    The finest cells are texels: eight tables, and base colour.  The others hold two kinds of texels, which differ in
    base colour: one texture with the tables of both, and each kind's colour and count.
    """

    size: tuple[int, int]
    tables: Textures
    colours: Textures

    def inputs(self) -> dict[str, Textures | moderngl.Texture]:
        """By the sampler's name."""
        if len(self.colours) == 1:
            return {"u_table": self.tables, "u_colour": self.colours[0]}
        return {"u_table": self.tables[0], "u_colour": self.colours}

    def defines(self) -> dict[str, str]:
        """Of the shaders that read them."""
        return {"TEXELS": "1"} if len(self.colours) == 1 else {}


def pyramid(
    device: Device, tables: Textures, colour: moderngl.Texture, shared: Shared, extent: float = 1.0,
    before: PriorKnowledge = NOTHING, of_all: tuple[Typical, ...] = (UNKNOWN,),
) -> tuple[moderngl.Texture, moderngl.Texture]:
    """Tables summed upwards, estimates handed downwards: (estimate, prior) of every texel.

    ``colour``: base colour, 1 where observed.  ``shared``: between neighbours.  ``extent``: width of the grid in UV
    squares.  ``before``: its roughness stands in for all levels from its cells on, which lie alike in neighbouring
    blocks, so that no border shows between them.  ``of_all``: what is typical of texels, for
    all or by their colour.
    """
    with device.scope() as owned:
        typical = device.texture(len(of_all), 2, data=np.array(
            [[(*kind.colour, 0.0) for kind in of_all], [(kind.roughness, kind.variance, 0.0, 0.0) for kind in of_all]],
            np.float32))
        texels = Cells(colour.size, tables, (colour,))
        around = before.roughness
        levels = _summed(device, texels, shared, 8 if around is None else around.shape[1])
        parents: tuple[Cells, Textures] | None = None
        if around is not None:
            size = (around.shape[1], around.shape[0])
            colours = tuple(device.texture(*size, data=np.zeros_like(around)) for _ in range(2))
            parents = Cells(size, (), colours), tuple(device.texture(*size, data=around) for _ in range(2))
            levels.pop()
        for n, level in reversed(list(enumerate(levels))):
            # Texels that share a pixel are off together: four texels alone do not show that two kinds are apart.
            cell = parents[0].size[0] // around.shape[1] if before.apart and parents and around is not None else 0
            found = _handed_down(device, level, parents, extent, 0.0 if n == 1 else EVIDENCE, typical, cell)
            parents = level, found
            if n > 0:  # the largest textures of all
                level.tables[0].release()
        estimate, prior = found
        owned.hand_over(estimate, prior)
        return estimate, prior


def _summed(device: Device, texels: Cells, shared: Shared, most: int) -> list[Cells]:
    """The texels and ever larger cells, until there are no more than ``most`` of these in a row."""
    levels = [texels]
    while levels[-1].size[0] > most:
        below = levels[-1]
        width, height = (below.size[0] + 1) // 2, (below.size[1] + 1) // 2
        first, second, members = (device.texture(width, height) for _ in range(3))
        with device.target([first, second, members]) as target:
            device.draw("solve/kinds.frag", target, Inputs(below.inputs(), defines=below.defines()))
        table = device.texture(TABLE_TILES * width, TABLE_TILES * height)
        with device.target([table]) as target:
            device.draw("solve/pool.frag", target, Inputs(
                {**below.inputs(), "u_members": members}, {"u_gain": shared.gain(len(levels) - 1)}, below.defines()))
        members.release()
        levels.append(Cells((width, height), (table,), (first, second)))
    return levels


def _handed_down(
    device: Device, level: Cells, parents: tuple[Cells, Textures] | None, extent: float, evidence: float,
    typical: moderngl.Texture, cell: int,
) -> Textures:
    """Estimates of both kinds from a level's tables and the coarser one's estimates; of texels (estimate, prior).

    ``evidence``: 0..1, how much of the tables counts where it is judged whether a cell's kinds are apart.
    ``cell``: of so many parents in a row, those of others say nothing; 0: all do.
    """
    found = tuple(device.texture(*level.size) for _ in range(2))
    cells, estimates = parents or (level, level.colours)  # at the top nothing is read of them
    above = {"u_parent": estimates, "u_parent_colour": cells.colours} if len(estimates) == 2 else {}
    with device.target(found) as target:
        device.draw("solve/descend.frag", target, Inputs({**level.inputs(), **above, "u_typical": typical}, {
            "u_top": parents is None, "u_step": ROUGHNESS_SLOPE * extent / level.size[0], "u_prior_cut": PRIOR_CUT,
            "u_evidence": evidence, "u_cell": cell}, level.defines()))
    return found
