"""The tone curve of JPEG and TIFF files: its two numbers are found before all else (core/images/response.py).

The two fit fifteen curves of cameras to 3 % of the radiance in the median, an exponent alone to 11 % (decision 0055).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..data import F64, View
from ..evaluation.folds import Folds
from ..images.colour import SPACES, known_space
from ..images.oiio_reader import JPEG, TIFF
from ..images.response import straight
from ..job import Steps, share_of
from .contest import GIVEN, SURE, Contest
from .finish import Judged
from .rig import RigChange
from .rig_fit import RigFound, fit_rig
from .rig_numbers import Free
from .rig_sample import LEAST_LIGHT, RigSample

ROUNDS = 10  # a curve is far from the straight line where the fit begins
LEAST_SHOULDER = 0.4  # logarithm
DEVELOPED = JPEG | TIFF  # by cameras, and by raw developers: for viewing, unless a user has asked for linear light


@dataclass(frozen=True)
class ToneCurve:
    """The curve of all files."""

    log_response: float
    log_shoulder: float
    error: RigChange  # standard errors of both
    given: PredictionError  # of left-out views, as the scene is given
    changed: PredictionError

    @classmethod
    def of(cls, judged: Judged) -> ToneCurve:
        """That of an earlier change."""
        change = judged.found.change
        return cls(change.log_response, change.log_shoulder, judged.error, judged.given, judged.changed)

    def corrected(self, sample: RigSample) -> RigSample:
        """A sample as if the curve of its views were undone."""
        texels, file = sample.texels, sample.geometry.file[..., None]
        response, shoulder = float(np.exp(self.log_response)), float(np.exp(self.log_shoulder))

        def undone(radiance: F64) -> F64:
            return np.asarray(straight(radiance * file, response, shoulder) / file)

        light = np.maximum(texels.irradiance, LEAST_LIGHT)
        views = tuple(replace(view, response=response, shoulder=shoulder) for view in sample.rig.views)
        return replace(sample, rig=replace(sample.rig, views=views),
                       texels=replace(texels, reflected=undone(texels.reflected * light) / light),
                       shade=None if sample.shade is None else undone(sample.shade))

    def beside(self, change: RigChange, error: RigChange) -> tuple[RigChange, RigChange]:
        """A change of the corrected rig as one of the given rig, and its standard errors."""
        own = self.error
        return (replace(change, log_response=change.log_response + self.log_response, log_shoulder=self.log_shoulder),
                replace(error, log_response=max(error.log_response, own.log_response), log_shoulder=own.log_shoulder))


def tone_curve(sample: RigSample, folds: Folds, first: RigFound) -> Steps[ToneCurve | None]:
    """The curve that files have beyond doubt, if left-out views are predicted better without it.

    A diffuse that is not Lambert's bends brightness too: the curve must predict better than all that it may be.
    ``first``: the materials of the sample.
    """
    if not all(may_have_one(view) for view in sample.rig.views):
        return None
    free = Free(False, False, levels=not sample.scale_known, response=True, shoulder=True)
    found = yield from share_of(fit_rig(sample, free, rounds=ROUNDS), 0.0, 0.05)
    change, error = found.change, found.error
    if change.log_shoulder < max(SURE * error.log_shoulder, LEAST_SHOULDER):
        return None
    contest = Contest(sample, found, folds)
    for each in (free, replace(free, shoulder=False), replace(free, response=False, shoulder=False, diffuse=True)):
        own = found if each == free else (yield from share_of(fit_rig(sample, each), 0.05, 0.1))
        contest.add(str(each), (yield from share_of(contest.predictions(each, own), 0.05, 0.1)))
        if each != free and not contest.beats(str(free), str(each)):
            return None
    if not contest.worth(free, GIVEN):
        return None
    return ToneCurve(change.log_response, change.log_shoulder, error, contest.judge.error(GIVEN),
                     contest.judge.error(str(free)))


def may_have_one(view: View) -> bool:
    """Whether a picture may be developed for viewing, as far as its file's type and what is given say."""
    linear = view.colorspace is not None and SPACES[known_space(view.colorspace) or "sRGB"][2] == "linear"
    return view.image.suffix.lower() in DEVELOPED and not linear and view.response == view.shoulder == 1.0
