"""One value for a material, settled by what it predicts of lamps or cameras that are left out."""

from __future__ import annotations

from collections.abc import Generator

from ...core.data import ONE_VALUE
from ...core.evaluation.folds import ALIKE
from ...core.evaluation.joint_material import OneMaterial
from ...core.evaluation.sampled_texels import predicted
from ...core.evaluation.value_descent import (
    COAT_ROUGH,
    COAT_WEIGHT,
    DIFFUSE,
    LEVEL,
    METALLIC,
    ROUGH,
    ValueDescent,
    lobes_of,
)
from ...core.job import Progress
from .drawn_base_trials import DrawnBaseTrials
from .prediction_trials import Trial, settled
from .trial_runs import PREDICTING

OFF_RMS, OFF_LIGHTNESS = 0.1, 2.0  # errors from which on: less may be what pixels blur, which other values only hide


class SettledTrials(DrawnBaseTrials):
    """What may become of the trial that is to be taken."""

    def _with_settled_values(self, taken: str, by_light: float) -> Generator[Progress, None, str]:
        """``taken``, or the same with values by which the other folds predict each fold clearly better."""
        trial = self.trials.get(taken)
        if trial is None or trial.strength != ONE_VALUE:
            return taken
        left = self.judge.error(taken)
        if left.relative_rms < OFF_RMS and left.lightness < OFF_LIGHTNESS:
            return taken
        new, count = settled(trial), len(self.places)
        for n, (left_out, joint) in enumerate(zip(self.folds.left_out, self.joints, strict=True)):
            one = yield from self._settled_values(new, trial.material(joint), by_light, without=n)
            self._keep(new.name, lobes := lobes_of(one, count), predicted(
                self.observed, lobes, ~left_out, drawn=trial.base_strength, by_light=by_light))
        self.judge.add(new.name, self.predictions[new.name])
        if not self.judge.leads(new.name, ALIKE[0], [taken]) or not self._no_worse(new.name, left):
            return taken
        self.trials[new.name] = new
        return new.name

    def _settled_values(
        self, trial: Trial, start: OneMaterial, by_light: float, without: int | None = None,
    ) -> Generator[Progress, None, OneMaterial]:
        """By which folds are predicted best, from a ``start`` on.  ``without``: a fold that takes no part."""
        clusters = self.judge.clusters
        descent = ValueDescent(self.observed, self.folds, clusters, trial.base_strength, by_light, without)
        found = start
        for step in descent.run(start, _free(trial, start)):
            yield PREDICTING
            found = step
        return found


def _free(trial: Trial, one: OneMaterial) -> tuple[int, ...]:
    """Numbers that are to be found anew."""
    return (ROUGH, LEVEL, *([METALLIC] if one.metallic > 0 else []),
            *([COAT_WEIGHT, COAT_ROUGH] if one.coat is not None else []), *([DIFFUSE] if trial.rough else []))
