"""The tilt of each texel's normal that explains what is observed of it.

Gauss-Newton on radiance, each texel's base colour eliminated, and its roughness or its level where they are not held
(variable projection, Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973).  Errors count relative to the radiance and a
part of what is typical of the texel: noise and light that bounces do not vanish where the light is grazing.  Cauchy
weights: shadows that the mesh does not cast.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from ..calibration.paint import paints_of, quotients
from ..data import F64, Bool
from ..evaluation.lobe_values import fresnel_ratio
from ..evaluation.sampled_texels import Lobes, energy_of
from ..shading import brdf, environment
from ..vectors import dot, mean, summed
from .tilt_sample import LEAST, LEAST_COSINE, LEAST_LOG, MOST_LOG, TiltedWorlds, TiltSample

CAUCHY = 2.4  # standard deviations at which an observation has lost half its weight
ROUNDS = 5
WIDE = 0.5  # radians: standard deviation of a tilt before anything is known of it
STEP = 1e-3  # radians: for derivatives
LONGEST = 0.2  # radians: a step
STEEPEST = 1.2  # tangent of the steepest tilt
TYPICAL = 0.3  # of the median radiance: errors below count as much as there
LEAST_SCATTER = 1e-3
ALIKE = 4  # observations for which counts, in a texel's scatter, that of all
SILENT = 6.0  # of that of all: a texel that scatters more says nothing of its tilt, because its light is another
NUMBERS = 3  # that are found in each texel, its roughness aside, which few observations say anything of


class Beside(Enum):
    """What is found of each texel beside its base colour and its tilt."""

    NOTHING = "nothing"
    ROUGHNESS = "roughness"
    LEVEL = "level"  # Specular IOR Level


@dataclass(frozen=True)
class _Lobe:
    """Of the logarithm of what is found of a lobe."""

    deviation: float
    step: float
    least: float  # of what it is the logarithm of
    most: float


LOBE = {Beside.ROUGHNESS: _Lobe(0.5, 0.3, 0.05, 1.0), Beside.LEVEL: _Lobe(1.0, 0.5, 0.02, 1.0)}


@dataclass(frozen=True)
class TiltsFound:
    """What the observations say of T tilts: as a normal distribution, of weight ``information``."""

    information: F64  # (T, 2, 2) 1/radians^2
    pull: F64  # (T, 2) information times the tilt that the observations alone say
    scatter: float  # relative: what observations leave over, robust
    lobes: Lobes  # of each texel, under the tilts from which the last round began

    def under(self, deviation: float) -> tuple[F64, F64]:
        """(tilts (T, 2), their covariances (T, 2, 2)) where tilts are known to have a standard deviation."""
        (a, b), (c, d) = np.moveaxis(self.information + np.eye(2) / max(deviation, LEAST) ** 2, 0, -1)
        covariance = np.moveaxis(np.array([[d, -b], [-c, a]]) / (a * d - b * c), -1, 0)
        return np.einsum("tij,tj->ti", covariance, self.pull), covariance

    def deviation(self) -> float:
        """Standard deviation of tilts, radians: that under which what was found is likeliest (empirical Bayes)."""
        deviation, before, known = 0.1, 0.0, np.linalg.eigvalsh(self.information)[:, 0]
        for _ in range(60):
            if deviation == before:  # at rest
                break
            tilt, covariance = self.under(deviation)
            seen = known > 0.1 / deviation**2  # the others say what is assumed
            if not seen.any():
                return 0.0
            square = ((tilt**2).sum(-1) + np.trace(covariance, axis1=1, axis2=2))[seen] / 2
            before, deviation = deviation, float(np.sqrt(np.mean(np.minimum(square, np.quantile(square, 0.98)))))
        return deviation


def fit_tilts(
    sample: TiltSample, lobes: Lobes, known: Bool | None = None, start: F64 | None = None,
    scatter: float | None = None, rounds: int = ROUNDS, beside: Beside = Beside.ROUGHNESS, deviation: float = WIDE,
) -> TiltsFound:
    """``known``: (V,) layers to go by.  ``start``: (T, 2) tilts.  ``scatter``: of a larger sample.

    What is found ``beside`` the tilt starts from ``lobes``, which hold otherwise.  ``deviation``: of tilts, as far as
    it is known; 0: they stay where they start.
    """
    fit = _Fit(sample, lobes, np.ones(len(sample.rig.view), bool) if known is None else known, beside, deviation)
    tilt = np.zeros((len(sample.first), 2)) if start is None else start
    for n in range(rounds):
        found = fit.round(tilt, scatter, n + 1 == rounds)
        if n + 1 < rounds and deviation:
            tilt = _stepped(tilt, found.under(deviation)[0])
    return found


def _stepped(tilt: F64, to: F64) -> F64:
    step = to - tilt
    step *= np.minimum(1.0, LONGEST / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), LEAST))
    tilt = tilt + step
    return np.asarray(tilt * np.minimum(1.0, STEEPEST / np.maximum(np.linalg.norm(tilt, axis=1, keepdims=True), LEAST)))


class TiltModel:
    """What one lobe reflects under tilted normals, over the irradiance that the given ones have.

    The energy that the lobe takes from the diffuse is that at the given normals: it changes little.
    """

    def __init__(self, sample: TiltSample, lobes: Lobes) -> None:
        self.sample = sample
        texels = sample.texels
        cos_v = np.clip(texels.cos_v, LEAST_COSINE, 1.0)
        roughness, level = lobes.roughness[:, 0], lobes.level
        gain, taken = energy_of(texels, roughness, level)
        self.white = (1 - taken) / np.pi
        self.alpha2 = (roughness**4)[:, None, None]
        ratio = 1.0 if np.all(level == 0.5) else fresnel_ratio(texels.lobes, cos_v, level[:, None, None])
        self.factor = texels.lobes[..., 3] * (gain * cos_v)[..., None] * ratio  # V.H stays as it is
        self.around = None if sample.worlds is None else self._around(sample.worlds, lobes, cos_v, gain)

    def at(self, tilt: F64) -> tuple[F64, F64]:
        """(T, V) each: what is reflected for each unit of base colour, and whatever that is."""
        sample = self.sample
        cos_l, sin2h, cos_v = sample.cosines(tilt)
        lit = np.clip(cos_l, LEAST_COSINE, 1.0)
        tan2_v = (1 / cos_v**2 - 1)[..., None]
        roots = brdf.lambda_root(self.alpha2, 1 / lit**2 - 1) + brdf.lambda_root(self.alpha2, tan2_v)
        shape = brdf.D_ggx_disc(self.alpha2, sin2h, sample.texels.lobes[..., 1]) / roots
        specular = summed(np.where(cos_l > 0, self.factor * shape, 0.0)) / cos_v
        if self.around is not None:
            given, slope = self.around
            specular = specular + given * np.exp(np.clip(dot(slope, tilt[:, None]), LEAST_LOG, MOST_LOG))
        return self.white * np.maximum(sample.brighter(tilt, cos_l), 0.0), specular

    def _around(self, worlds: TiltedWorlds, lobes: Lobes, cos_v: F64, gain: F64) -> tuple[F64, F64]:
        """(T, V) of an environment's lobe, and (T, V, 2) slopes of its logarithm: what is between nodes is linear."""
        texels, roughness = self.sample.texels, lobes.roughness[:, 0]
        assert texels.nodes is not None
        logs = texels.nodes[..., 0, :]
        given, *tilted = (np.maximum(environment.at_roughness_of_logs(each, roughness[:, None]), LEAST) for each in (
            logs, *(logs + worlds.lobe[..., axis] for axis in (0, 1))))
        slope = np.stack([np.log(each / given) for each in tilted], -1)
        ratio = fresnel_ratio(texels.lobes, cos_v, lobes.level[:, None, None], texels.nodes, roughness)[..., -1]
        return given * gain * ratio, slope


class _Fit:
    """One sample's rounds."""

    def __init__(self, sample: TiltSample, lobes: Lobes, known: Bool, beside: Beside, deviation: float) -> None:
        texels, self.deviation = sample.texels, deviation
        self.sample, self.lobes, self.beside, self.observed = sample, lobes, beside, mean(texels.reflected)
        self.more = np.zeros(len(texels.cos_v))  # (T,) logarithm of what is found of the lobe, over that of ``lobes``
        self.paints = paints_of(texels)
        self.good: Bool = texels.usable() & known
        # Radiance over that which a surface facing the light would have its irradiance of:
        facing = np.clip(dot(texels.lobes[..., 2], sample.share) + sample.around, 0.05, 1.0)
        shown = np.where(self.good, np.maximum(self.observed, 0.0) * facing, np.nan)
        some = self.good.any(1)
        typical = np.ones(len(shown))
        typical[some] = np.nanmedian(shown[some], axis=1)
        unit = (np.maximum(self.observed, 0.0) * facing + TYPICAL * typical[:, None]) / (1 + TYPICAL)
        self.root = np.where(self.good, np.sqrt(np.clip(texels.quality, 0, 1)) * facing / np.maximum(unit, LEAST), 0.0)
        self.weight = self.root**2  # robust weights come on top

    def round(self, tilt: F64, scatter: float | None, last: bool) -> TiltsFound:
        """The observations, linearised at a tilt.  ``last``: what they say is not a step on the way.

        What is found of the lobe is eliminated, and stepped: of a highlight that is too wide for a roughness, tilts
        would take up a part.
        """
        lobes = self._lobes(0.0)
        model = TiltModel(self.sample, lobes)
        white, rest = model.at(tilt)
        left = self._left(white, self.observed - rest)
        spread = self._scatter(left) if scatter is None else scatter
        own = spread if self.sample.worlds is None else self._own_scatter(left, spread)[:, None]
        robust = 1 / (1 + (left * self.root / (CAUCHY * own)) ** 2)
        self.weight = self.root**2 * robust
        base = self._bases(white, self.observed - rest)
        left = self.observed - rest - base * white
        columns = []
        changed = [model.at(tilt + axis) for axis in np.eye(2) * STEP]
        if self.beside is not Beside.NOTHING:
            changed.append(TiltModel(self.sample, self._lobes(STEP)).at(tilt))
        for more_white, more_rest in changed:
            slope = (base * (more_white - white) + more_rest - rest) / STEP
            columns.append(slope - self._bases(white, slope) * white)
        slopes = np.stack(columns, -1)  # (T, V, 2 or 3)
        told = np.where(last & (own > SILENT * spread), 0.0, self.weight / own**2)
        across = (slopes * told[..., None]).transpose(0, 2, 1)
        normal, pull = across @ slopes, (across @ left[..., None])[..., 0]
        information, turn = (normal, pull) if self.beside is Beside.NOTHING else self._tilts_alone(normal, pull)
        return TiltsFound(information, turn + np.einsum("tij,tj->ti", information, tilt), spread, lobes)

    def _tilts_alone(self, normal: F64, pull: F64) -> tuple[F64, F64]:
        """(T, 2, 2) and (T, 2) of the tilts, of the equations of all; the lobe is eliminated, and stepped."""
        of = LOBE[self.beside]
        pull[:, 2] -= self.more / of.deviation**2
        own = normal[:, 2, 2] + 1 / of.deviation**2
        taken = normal[:, :2, 2] / own[:, None]
        information = normal[:, :2, :2] - taken[:, :, None] * normal[:, None, 2, :2]
        turn = pull[:, :2] - taken * pull[:, 2:]
        by = np.zeros_like(turn)
        if self.deviation:
            by = np.einsum("tij,tj->ti", np.linalg.inv(information + np.eye(2) / self.deviation**2), turn)
        self.more += np.clip((pull[:, 2] - (normal[:, 2, :2] * by).sum(-1)) / own, -of.step, of.step)
        return information, turn

    def _lobes(self, more: float) -> Lobes:
        """Of the texels now, and ``more`` in the logarithm of what is found of them."""
        if self.beside is Beside.NOTHING:
            return self.lobes
        of, factor = LOBE[self.beside], np.exp(self.more + more)
        if self.beside is Beside.LEVEL:
            return replace(self.lobes, level=np.clip(self.lobes.level * factor, of.least, of.most))
        return replace(self.lobes, roughness=np.clip(self.lobes.roughness * factor[:, None], of.least, of.most))

    def _left(self, white: F64, rest: F64) -> F64:
        return rest - self._bases(white, rest) * white

    def _bases(self, white: F64, rest: F64) -> F64:
        """(T, V) least squares: base colours that explain ``rest``; or what they take of a slope."""
        return quotients(self.paints, self.weight * white * rest, self.weight * white**2)

    def _scatter(self, left: F64) -> float:
        """Robust standard deviation of relative errors, of texels that have more observations than numbers."""
        count = self.good.sum(1)
        some = self.good & (count > NUMBERS + 1)[:, None]
        if not some.any():
            return 1.0
        relative = np.abs(left * self.root)[some]
        lost = float(np.mean(1 - NUMBERS / count[count > NUMBERS + 1]))
        return float(1.4826 * np.median(relative) / np.sqrt(max(lost, 0.1))) + LEAST_SCATTER

    def _own_scatter(self, left: F64, scatter: float) -> F64:
        """(T,) the same of each texel, where it is more than that of all: no tilt explains what some show.

        Shadows of light from all around that are wrong spoil all of a texel's observations, those of lamps one each.
        """
        count = self.good.sum(1)
        degrees = np.maximum(count - NUMBERS, 0)
        relative = np.sort(np.where(self.good, np.abs(left * self.root), np.inf), axis=1)
        middle = relative[np.arange(len(count)), np.maximum(count - 1, 0) // 2]
        square = (1.4826 * np.where(degrees > 0, middle, 0.0)) ** 2 * count / np.maximum(degrees, 1)
        return np.asarray(np.sqrt(np.maximum(
            (ALIKE * scatter**2 + degrees * square) / (ALIKE + degrees), scatter**2)))
