"""The trials of one material, fold by fold: what each predicts of the layers that are left out."""

from __future__ import annotations

from collections.abc import Callable, Generator
from itertools import groupby

import numpy as np

from ...core.data import F32, F64, I32, Bool
from ...core.evaluation.folds import Folds, Judge
from ...core.evaluation.joint_material import Joint, JointSearch
from ...core.evaluation.sampled_texels import Lobes, SampledTexels, one_lobe, predicted, under_strengths
from ...core.evaluation.value_descent import lobes_of
from ...core.job import Progress
from ...core.params import SolveSettings
from ..device.context import Device
from .material_sample import MaterialSample, clusters
from .prediction_trials import Trial
from .solver import Solver

RACE = 0.5  # of its loss: what is so much worse than the best in the first fold is not tried in the others
BY_LIGHT = 1.0, 2.0  # powers of the irradiance by which observations may count in base colour
LEAST = 0.01  # roughness: of texels that are not observed it is 0
PREDICTING = Progress(0.5, "solve", "predicting left-out views")


class TrialRuns:
    """Runs trials on a sample, and tells a judge what they predict."""

    def __init__(
        self, device: Device, sample: MaterialSample, settings: SolveSettings, observed: SampledTexels, places: I32,
        folds: Folds,
    ) -> None:
        self.sample, self.observed, self.places, self.folds, self.settings = sample, observed, places, folds, settings
        self.solver = Solver(device, sample, settings)
        self.solver.shown = False
        self.search = JointSearch(observed)
        self.joints: list[Joint] = []  # of each fold
        self.judge = Judge(observed, folds, clusters(sample, places))
        self.predictions: dict[str, list[F64]] = {}
        self.lobes: dict[str, list[Lobes | None]] = {}  # that they were made with
        self.trials: dict[str, Trial] = {}

    def _folds(
        self, attempt: Callable[[Bool, Joint, list[Trial]], Generator[Progress, None, None]],
        trials: list[Trial] | None = None, race: bool = False,
    ) -> Generator[Progress, None, None]:
        """Some trials in every fold, with what they predict; with ``race``, those alone that do well in the first."""
        if trials == [] or self.solver.cancelled:
            return
        before = set(self.predictions)
        for left_out, joint in zip(self.folds.left_out, self.joints, strict=True):
            self.sample.left_out = left_out
            yield from attempt(~left_out, joint, trials or [])
            if self.solver.cancelled:
                return
            if race and trials and left_out is self.folds.left_out[0]:
                hopeful = self._hopeful([trial.name for trial in trials], RACE)
                trials = [trial for trial in trials if trial.name in hopeful]
                if not trials:
                    break
        self.sample.left_out = np.zeros_like(self.folds.left_out[0])
        self.trials |= {trial.name: trial for trial in trials or []}
        for name, predictions in self.predictions.items():  # in order: Lambert is the first
            if name not in before:
                self.judge.add(name, predictions)

    def _again(
        self, name: str, attempt: Callable[[Bool], Generator[Progress, None, None]],
    ) -> Generator[Progress, None, bool]:
        """A candidate in another way, if that is the best of all in the first fold: whether it is."""
        before = self.predictions.pop(name), self.lobes.pop(name)
        for left_out in self.folds.left_out:
            self.sample.left_out = left_out
            yield from attempt(left_out)
            first = left_out is self.folds.left_out[0]
            if self.solver.cancelled or (first and not self._hopeful([name], 0.0)):
                break
        self.sample.left_out = np.zeros_like(self.folds.left_out[0])
        if len(self.predictions.get(name, [])) < len(before[0]):
            self.predictions[name], self.lobes[name] = before
            return False
        self.judge.add(name, self.predictions[name])
        return True

    def _hopeful(self, new: list[str], margin: float) -> list[str]:
        """Those whose first fold leaves them a chance; the predictions of the others are forgotten."""
        hopeful = self.judge.hopeful({name: of[0] for name, of in self.predictions.items()}, new, margin)
        for name in new:
            if name not in hopeful:
                del self.predictions[name]
        return hopeful

    def _uniform(self, known: Bool, joint: Joint, trials: list[Trial]) -> Generator[Progress, None, None]:
        """One value for the material."""
        yield PREDICTING
        for _, group in groupby(trials, lambda trial: trial.material):
            alike = list(group)  # but for their base colours
            lobes = lobes_of(alike[0].material(joint), len(self.places))
            strengths = [trial.base_strength for trial in alike]
            found = under_strengths(self.observed, lobes, known, strengths)
            for trial, value in zip(alike, found, strict=True):
                self._keep(trial.name, lobes, value)

    def _drawn(self, known: Bool, joint: Joint, trials: list[Trial]) -> Generator[Progress, None, None]:
        """A value a texel, drawn to the material's, under several priors at one level and Metallic."""
        one = trials[0].material(joint)
        self.solver.use_level(self._grid(one.level) if one.level != 0.5 else None)
        self.solver.use_metallic(one.metallic)
        self.solver.use_coat(one.coat)
        self.solver.use_diffuse_roughness(one.diffuse)
        maps = yield from self.solver.under_priors([trial.prior(one) for trial in trials])
        self.solver.use_metallic(0.0)
        self.solver.use_coat(None)
        self.solver.use_diffuse_roughness(0.0)
        for trial, values in zip(trials, maps, strict=True):
            lobes = one_lobe(self._at(values), one.level, one.metallic, one.coat, one.diffuse)
            self._add(trial.name, lobes, known)

    def _drawn_levels(self, known: Bool, joint: Joint, trials: list[Trial]) -> Generator[Progress, None, None]:
        """The same with a level a texel, which is drawn too."""
        priors = {trial.name: prior for trial in trials if (prior := trial.prior(trial.material(joint))) is not None}
        levels = yield from self.solver.levels_under(list(priors.values()))
        for (name, prior), (level, _) in zip(priors.items(), levels, strict=True):
            self.solver.use_level(level)
            (values,) = yield from self.solver.under_priors([prior])
            self._add(name, one_lobe(self._at(values), level.ravel()[self.places].astype(np.float64)), known)

    def _two_lobes(self) -> Generator[Progress, None, Lobes]:
        self.solver.use_level(None)
        maps = yield from self.solver.solve_two()
        pairs = maps.read_pairs(self.solver.device)
        assert pairs is not None
        maps.release()
        lobes = pairs.reshape(-1, 3)[self.places].astype(np.float64)
        lobes[:, :2] = np.clip(lobes[:, :2], LEAST, 1.0)
        return Lobes(lobes[:, :2], lobes[:, 2], np.full(len(lobes), 0.5), self.settings.ndf == "beckmann")

    def _grid(self, level: float) -> F32:
        return np.full(self.sample.size[::-1], level, np.float32)

    def _at(self, values: F32) -> F64:
        return np.clip(values.ravel()[self.places].astype(np.float64), LEAST, 1.0)

    def _add(self, name: str, lobes: Lobes | None, known: Bool, drawn: float = 0.0) -> None:
        """What a trial predicts of a fold; ``known``: layers that are not left out.  ``drawn``: as of `predicted`."""
        self._keep(name, lobes, predicted(self.observed, lobes, known, drawn=drawn))

    def _keep(self, name: str, lobes: Lobes | None, value: F64) -> None:
        self.predictions.setdefault(name, []).append(value)
        self.lobes.setdefault(name, []).append(lobes)

    def _by_light(self, taken: str) -> Generator[Progress, None, float]:
        """The power of the irradiance by which observations are to count in base colour, for what is ``taken``.

        That is not a larger model, so that whatever predicts best is right.  The judge's candidate becomes that.
        """
        trial = self.trials.get(taken)
        drawn, powers = trial.base_strength if trial else 0.0, {taken: 0.0}
        for power in BY_LIGHT:
            name = f"{taken}, by irradiance^{power:g}"
            powers[name] = power
            predictions: list[F64] = []
            for left_out, lobes in zip(self.folds.left_out, self.lobes[taken], strict=True):
                yield PREDICTING
                predictions.append(predicted(self.observed, lobes, ~left_out, drawn=drawn, by_light=power))
            self.judge.add(name, predictions)
        (best,) = self.judge.near(list(powers), 0.0)[:1]
        self.judge.candidates[taken] = self.judge.candidates[best]
        return powers[best]
