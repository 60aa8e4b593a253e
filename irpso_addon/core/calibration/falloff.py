"""Vignetting, by what cameras show of the same texels.

A fit of the rig gives each camera its own base colours, because its pixels cover the texture differently.  They take up
what darkens a picture towards its edges.  So vignetting is fitted once more, after lamps and exposures, with one base
colour for all cameras: a power of the cosine to the camera's axis, beside each view's brightness and shapes of a
diffuse that is not Lambert's, because an object's outline faces away from the camera and lies near the picture's edge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..data import F64
from ..evaluation.folds import FOLDS, Folds
from ..vignetting import corner_stops
from .contest import GIVEN, SURE, Contest
from .rig_fit import RigFound, left_over
from .rig_numbers import CAUCHY
from .rig_round import OUTLYING, in_common
from .rig_sample import RigSample
from .standard_errors import COMMON

LEAST_STOPS = 0.1  # in the corners: less is not told from what surfaces do at grazing light
# Of what neighbours have in common, or of what predictions are off by: where more is left of both, it may be what the
# model of the material lacks.
PAYS = 0.95
LEAST_CAMERAS = 2
ROUNDS = 6
SWEEPS = 8
LEAST = 1e-12
LEAST_SCATTER = 1e-4
WITHOUT, EVEN = "without", "even"


@dataclass(frozen=True)
class Falloff:
    """A power of the cosine that all pictures have."""

    power: float
    error: float  # its standard error
    given: PredictionError  # of left-out cameras, as the scene is given
    changed: PredictionError

    def beside(self, found: RigFound) -> RigFound:
        """With vignetting among what was found."""
        return replace(found, change=replace(found.change, vignetting=self.power),
                       error=replace(found.error, vignetting=self.error))


def edge_falloff(sample: RigSample, found: RigFound) -> Falloff | None:
    """Vignetting beyond doubt that predicts left-out cameras better.  ``found``: what is off beside it."""
    cameras = np.unique(sample.texels.camera)
    if len(cameras) < LEAST_CAMERAS or found.change.vignetting or any(group.carried for group in sample.rig.groups):
        return None
    power, error, left = _fitted(sample, found)
    if abs(power) < SURE * error or abs(corner_stops([view.camera for view in sample.rig.views], power)) < LEAST_STOPS:
        return None
    count = min(len(cameras), FOLDS)
    folds = Folds(tuple(np.isin(sample.texels.camera, cameras[n::count]) for n in range(count)), "cameras")
    contest = Contest(sample, found, folds)
    contest.add(WITHOUT, contest.of_whole(found))
    contest.add(EVEN, contest.of_whole(replace(found, change=replace(found.change, vignetting=power))))
    if not contest.shows(EVEN, WITHOUT) or min(left, contest.scale(EVEN) / contest.scale(WITHOUT)) > PAYS:
        return None
    return Falloff(power, error, contest.judge.error(GIVEN), contest.judge.error(EVEN))


def _fitted(sample: RigSample, found: RigFound) -> tuple[float, float, float]:
    """The power, its standard error, and what it leaves over of what neighbours have in common."""
    left = left_over(sample, found)
    known = np.isfinite(left)
    if not known.any():
        return 0.0, np.inf, 1.0
    seen = sample.geometry.under(found.change)
    facing = np.log(np.clip(seen.texels.cos_v, 0.01, 1.0))
    columns = np.stack([sample.geometry.cosine, *seen.diffuse, facing, np.where(known, left, 0.0)])
    weight = known.astype(np.float64)
    for _ in range(ROUNDS):
        *shapes, rest = _apart(columns, weight, sample.view)
        first, *others = (shape.ravel() for shape in shapes)
        matrix, root = np.stack(others, -1), np.sqrt(weight).ravel()
        own = first - matrix @ np.linalg.lstsq(matrix * root[:, None], first * root, rcond=None)[0]
        rest = rest.ravel() - matrix @ np.linalg.lstsq(matrix * root[:, None], rest.ravel() * root, rcond=None)[0]
        information = max(float((weight.ravel() * own**2).sum()), LEAST)
        power = float((weight.ravel() * own * rest).sum()) / information
        without = rest.reshape(left.shape)
        rest = (rest - power * own).reshape(left.shape)
        spread = 1.4826 * float(np.median(np.abs(rest[known]))) + LEAST_SCATTER
        weight = known / (1 + (rest / (CAUCHY * spread)) ** 2)
    score = (weight * rest * own.reshape(left.shape)).sum(1)
    of = np.unique(sample.cluster, return_inverse=True)[1]
    told = np.bincount(of, (weight * own.reshape(left.shape) ** 2).sum(1))
    few = _few(told, len(columns) - 1)
    after, before = (in_common(each, known, sample.cluster, 2 * OUTLYING * spread) for each in (rest, without))
    return (power, few * COMMON * float(np.sqrt((np.bincount(of, score) ** 2).sum())) / information,
            after / max(before, LEAST))


def _few(told: F64, numbers: int) -> float:
    """Factor of standard errors where few clusters tell anything: a fit of as many numbers leaves none of them over.

    ``told``: information that each cluster has of the power.  A few may have nearly all of it, so that they are counted
    as by Kish, *Survey Sampling*, 1965.
    """
    count = float(told.sum()) ** 2 / max(float((told**2).sum()), LEAST**2)
    return float(np.sqrt(count / (count - numbers))) if count > numbers else np.inf


def _apart(columns: F64, weight: F64, view: np.ndarray) -> F64:
    """(n, T, V) without the means of texels and of views."""
    of_texel = np.maximum(weight.sum(1), LEAST)
    places, of = np.unique(view, return_inverse=True)
    own = np.eye(len(places))[of]  # (V, views)
    of_view = np.maximum(weight.sum(0) @ own, LEAST)
    for _ in range(SWEEPS):
        columns = columns - ((weight * columns).sum(2) / of_texel)[..., None]
        columns -= ((weight * columns).sum(1) @ own / of_view)[:, None, of]
    return columns
