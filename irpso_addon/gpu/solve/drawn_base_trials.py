"""Trials of one value for a material whose texels' base colours are drawn to the material's."""

from __future__ import annotations

from collections.abc import Generator

from ...core.change_records import PredictionError
from ...core.data import ONE_VALUE, Bool
from ...core.evaluation.folds import ALIKE
from ...core.evaluation.joint_material import Joint
from ...core.evaluation.sampled_texels import one_lobe
from ...core.job import Progress
from .prediction_trials import (
    CONSTANT,
    CONSTANT_METAL,
    FITTED,
    OWN_DRAWN,
    Fitted,
    Trial,
    by_size,
    drawn_name,
    with_drawn_base,
)
from .trial_runs import PREDICTING, TrialRuns

CLEAR = 0.15  # of its loss: a fit that leads by so much over one value for the material needs no prior
HOPEFUL = 0.25  # the same: one value that is not worse than the best one value by more is tried a texel, too
WORSE = 1.05  # ratio of errors up to which they may be worse in one of the two
PLAIN_METALLIC = 0.03  # a Metallic so near to 0 is 0
STRONGER = ALIKE[0] / 2  # of its loss: a prior that is stronger may be worse by so much


class DrawnBaseTrials(TrialRuns):
    """What remains to be tried once all others were."""

    fitted: Fitted
    metals: bool

    def _with_drawn_base(self, taken: str) -> Generator[Progress, None, str]:
        """The one value whose texels' base colours are drawn to the material's that is to be taken instead, if any.

        Bumps that the mesh lacks change what texels show, and each takes them for its base colour.
        """
        alike = {trial.name: trial for trial in self.trials.values() if trial.strength == ONE_VALUE}
        (best,) = self.judge.near(list(alike), 0.0)[:1]
        drawn = with_drawn_base(alike[best])
        yield from self._folds(self._uniform, [*drawn, *(yield from self._constant())], race=True)
        if not self.solver.cancelled and any(self.judge.leads(trial.name, 0.0, [best]) for trial in drawn):
            for name in self.judge.near(list(alike), HOPEFUL):
                if name != best:
                    yield from self._folds(self._uniform, with_drawn_base(alike[name]), race=True)
        if self.solver.cancelled:
            return taken
        found = self._drawn_best(taken)
        if found is None:
            return taken
        own = taken in (FITTED[model] for model in OWN_DRAWN)
        differ = own and best not in self.judge.near([taken, best], CLEAR)
        return taken if differ and not (yield from self._better_than_own(taken, found)) else found.name

    def _drawn_best(self, taken: str) -> Trial | None:
        """The best that leads what would be ``taken``, under the strongest prior that predicts about as well.

        The lamps that are left out shine from between others.  Under lamps from elsewhere, what bumps did to a texel's
        own base colour is still further from the truth.
        """
        error = self.judge.error(taken)
        fine = [trial for trial in self.trials.values() if trial.base_strength and self._no_worse(trial.name, error)]
        leading = [trial for trial in fine if self.judge.leads(trial.name, ALIKE[0], [taken])]
        found = self.trials.get(self.judge.choose([["lambert"], *by_size(leading)]))
        if found is None:
            return None
        alike = [trial for trial in fine if trial.material is found.material]
        near = self.judge.near([trial.name for trial in alike], STRONGER)
        return max((trial for trial in alike if trial.name in near), key=lambda trial: trial.base_strength)

    def _better_than_own(self, taken: str, found: Trial) -> Generator[Progress, None, bool]:
        """Whether one value predicts better than the fit's own values a texel, if base colours are drawn as far.

        Noise, too, makes base colours differ: to draw them says nothing of roughness then.
        """
        name = drawn_name(taken, found.base_strength)

        def own(known: Bool, joint: Joint, trials: list[Trial]) -> Generator[Progress, None, None]:
            yield from self._own_lobe(taken, known, name, found.base_strength)

        yield from self._folds(own)
        return not self.solver.cancelled and self.judge.leads(found.name, 0.0, [name])

    def _constant(self) -> Generator[Progress, None, list[Trial]]:
        """Those whose values were found with one base colour for all."""
        for n, left_out in enumerate(self.folds.left_out):
            yield PREDICTING
            self.joints[n] = self.search.with_constant(self.joints[n], ~left_out)
        metal = self.metals and min(joint.constant[1].metallic for joint in self.joints) > PLAIN_METALLIC
        return [drawn for trial in (CONSTANT, *([CONSTANT_METAL] if metal else [])) for drawn in with_drawn_base(trial)]

    def _no_worse(self, name: str, than: PredictionError) -> bool:
        """In neither error: what explains highlights may not spoil the body."""
        error = self.judge.error(name)
        return error.relative_rms <= WORSE * than.relative_rms and error.lightness <= WORSE * than.lightness

    def _own_lobe(
        self, name: str, known: Bool, called: str = "", drawn: float = 0.0,
    ) -> Generator[Progress, None, None]:
        """``called``: another name of the trial.  ``drawn``: as of `predicted`."""
        level = self.fitted.level if name == FITTED["one-lobe-specular"] else 0.5
        self.solver.use_level(self._grid(level) if level != 0.5 else None)
        (values,) = yield from self.solver.under_priors([None])
        self._add(called or name, one_lobe(self._at(values), level), known, drawn)
