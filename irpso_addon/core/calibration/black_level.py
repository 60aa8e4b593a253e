"""The black level that files hold beside radiance, as places show it that face away from all lamps of a view.

Light from all around, and light that bounces, is dark on dark paint.  A black level is the same on all paint.  So what
the files hold in the shade is fitted twice: by a black level and light from all around, and by light from all around
and light that has bounced to and fro, without a black level.  Cauchy weights; standard errors from clusters of
neighbouring texels.  Where all paint is alike, nothing tells the two apart: base colours that differ by errors of lamps
alone leave the light from all around to the black level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..data import F64
from ..evaluation.folds import Folds, Judge
from ..evaluation.sampled_texels import predicted
from ..job import Steps
from ..shading import brdf
from .contest import GIVEN, SURE, WORSE
from .rig import RigChange, with_more
from .rig_fit import RigFound, base_of, fit_rig
from .rig_numbers import CAUCHY, Free
from .rig_round import OUTLYING, in_common
from .rig_sample import COLOURS, LEAST_LIGHT, SHEEN, RigSample
from .shade import FACING, LEAST_OPEN, shows_shade
from .standard_errors import COMMON
from .texel_materials import lobes_of

LEAST_LEVEL = 1e-3  # of the files' typical value
# Standard deviation of the logarithm of base colours: less is no paint of another colour, but errors of the scene.
# Lamps, cameras and a mesh that are off as those of a shoot are make 0.04 to 0.07 of one paint.
LEAST_PAINT = 0.15
VARIES = 3.0  # the same, times what neighbours leave over in common: of scenes that are off by more
WITHIN_90 = 3.29  # standard deviations, of a normal distribution
PAYS = 0.8  # of what neighbours in the shade have in common
ROUNDS = 12
LEAST = 1e-12
CHANGED = "changed"


@dataclass(frozen=True)
class BlackLevel:
    """Values that all files hold where no light falls; (3,) linear Rec.709."""

    level: F64
    error: F64  # standard errors
    given: PredictionError  # of left-out views, as the scene is given
    changed: PredictionError

    def corrected(self, sample: RigSample) -> RigSample:
        """A sample as if its views had this black level."""
        return without_black(sample, self.level)

    def beside(self, change: RigChange, error: RigChange) -> tuple[RigChange, RigChange]:
        """A change of the corrected rig as one of the given rig, and its standard errors."""
        return replace(change, black_level=self.level), replace(error, black_level=self.error)


def without_black(sample: RigSample, level: F64) -> RigSample:
    """A sample whose files hold less by ``level``, (3,); not those of which a picture without lamps was subtracted."""
    texels, radiance = sample.texels, _radiance(sample, level)
    views = tuple(replace(view, black_level=with_more(view.black_level, level)) if view.ambient is None else view
                  for view in sample.rig.views)
    return replace(
        sample, rig=replace(sample.rig, views=views),
        texels=replace(texels, reflected=texels.reflected - radiance / np.maximum(texels.irradiance, LEAST_LIGHT)),
        shade=None if sample.shade is None else sample.shade - radiance)


def black_level(sample: RigSample, folds: Folds, first: RigFound) -> Steps[BlackLevel | None]:
    """What the shade shows beyond doubt, unless left-out views are then predicted worse.

    ``first``: the materials of the sample.
    """
    found = _in_shade(sample, first)
    if found is None:
        return None
    level, error = found
    under = without_black(sample, level)
    then = yield from fit_rig(under, Free(False, False, levels=not sample.scale_known), rounds=1)
    judge, more = Judge(sample.texels, folds), sample.texels.reflected - under.texels.reflected
    given, changed = (lobes_of(each, each.texels, by.materials) for each, by in ((sample, first), (under, then)))
    judge.add("lambert", [predicted(sample.texels, None, ~out) for out in folds.left_out])
    judge.add(GIVEN, [predicted(sample.texels, given, ~out) for out in folds.left_out])
    judge.add(CHANGED, [predicted(under.texels, changed, ~out) + more for out in folds.left_out])
    before, after = judge.error(GIVEN), judge.error(CHANGED)
    if max(after.relative_rms / before.relative_rms, after.lightness / before.lightness) > WORSE:
        return None
    return BlackLevel(level, error, before, after)


def _in_shade(sample: RigSample, first: RigFound) -> tuple[F64, F64] | None:
    """The level and its standard errors, if it is there beyond doubt."""
    if not _can_be_seen(sample) or not shows_shade(sample):
        return None
    fits = [_Shade(sample.channel(n), first) for n in range(COLOURS)]
    if not min(fit.known.sum() for fit in fits):
        return None
    if _rms([fit.paint for fit in fits]) < max(LEAST_PAINT, VARIES * first.common[0]):
        return None
    level, error = (np.array(values) for values in zip(*(fit.level for fit in fits), strict=True))
    if _rms([fit.left for fit in fits]) > PAYS * _rms([fit.left_without for fit in fits]):
        return None
    texels = sample.texels
    value = ((texels.reflected * texels.irradiance).mean(-1) * sample.geometry.file)[texels.usable()]
    least = max(LEAST_LEVEL * float(np.median(value)), SURE * error.mean()) if len(value) else np.inf
    return (level, error) if abs(level.mean()) > least else None


def _can_be_seen(sample: RigSample) -> bool:
    """Whether files are in proportion to radiance as given, and their channels are together."""
    return sample.texels.reflected.shape[-1] == COLOURS and all(view.response == 1.0 for view in sample.rig.views)


class _Shade:
    """What the files hold in the shade, of one channel; (T, V) arrays."""

    def __init__(self, sample: RigSample, first: RigFound) -> None:
        assert sample.shade is not None
        shade, openness, file = sample.shade[..., 0], sample.geometry.open, sample.geometry.file
        self.sample, self.known = sample, np.isfinite(shade) & (openness > 0)
        known, base = self.known, base_of(sample, first)
        sheen = brdf.principled_energy(SHEEN, np.clip(sample.texels.cos_v[known], FACING, 1.0))[..., 1]
        around = (base[known] * (1 - sheen) + sheen) * np.maximum(openness[known], LEAST_OPEN) * file[known]
        value = shade[known] * file[known]
        some = np.log(np.maximum(base[known], LEAST))
        self.paint = float(np.diff(np.quantile(some, (0.05, 0.95)))[0]) / WITHIN_90 if len(some) else 0.0
        cluster = np.unique(sample.cluster[np.nonzero(known)[0]], return_inverse=True)[1]
        black = _fitted(np.stack([np.ones_like(around), around], -1), value, cluster)
        other = _fitted(np.stack([around, around * base[known]], -1), value, cluster)
        if other.values[1] < 0:  # what bounces only adds
            other = _fitted(around[:, None], value, cluster)
        self.level = float(black.values[0]), COMMON * float(black.errors[0])
        self.left, self.left_without = (self._common(fit) for fit in (black, other))

    def _common(self, fit: _Fit) -> float:
        rest = np.zeros(self.known.shape)
        rest[self.known] = fit.left
        return in_common(rest, self.known, self.sample.cluster, OUTLYING * fit.scatter)


@dataclass(frozen=True)
class _Fit:
    values: F64
    errors: F64  # standard errors
    left: F64  # (N,)
    scatter: float  # robust standard deviation of it


def _fitted(columns: F64, value: F64, cluster: np.ndarray) -> _Fit:
    """Of (N, n) columns to (N,) values."""
    weight, scatter = np.ones(len(value)), 0.0
    for _ in range(ROUNDS if len(value) else 0):
        root = np.sqrt(weight)
        values = np.linalg.lstsq(columns * root[:, None], value * root, rcond=None)[0]
        left = value - columns @ values
        scatter = 1.4826 * float(np.median(np.abs(left))) + LEAST
        weight = 1 / (1 + (left / (CAUCHY * scatter)) ** 2)
    if not len(value):
        return _Fit(np.zeros(columns.shape[1]), np.full(columns.shape[1], np.inf), value, scatter)
    score = np.zeros((int(cluster.max()) + 1, columns.shape[1]))
    np.add.at(score, cluster, columns * (weight * left)[:, None])
    inverse = np.linalg.pinv((columns * weight[:, None]).T @ columns)
    return _Fit(values, np.sqrt((inverse @ score.T @ score @ inverse).diagonal()), left, scatter)


def _radiance(sample: RigSample, level: F64) -> F64:
    """(T, V, 3) what a black level adds."""
    raised = np.array([view.ambient is None for view in sample.rig.views])[sample.view]
    return np.asarray(np.where(raised[:, None], level / sample.geometry.file[..., None], 0.0))


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
