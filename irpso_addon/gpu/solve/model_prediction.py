"""Which model of a material predicts best what left-out lamps or cameras show, on squares of its texels."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

import numpy as np

from ...core.data import F32, F64, I32, Bool, JointPrior, MaterialPrediction, PredictionError
from ...core.evaluation.folds import Folds, Judge, split
from ...core.evaluation.joint_material import Joint, JointSearch
from ...core.evaluation.sampled_texels import Lobes, SampledTexels, one_lobe, predicted
from ...core.job import Progress
from ...core.models import LADDER
from ...core.params import SolveSettings
from ..device.context import Device
from ..observe.observation_atlas import Source
from .material_sample import MaterialSample, clusters, read_sample, sampled
from .solver import Solver

STRENGTHS = (200.0, 10.0)  # of the material's prior: nats per squared log ratio of roughness
JUDGED = 1000  # texels, of a sample
ONE = 1e5  # the same, where a material has one roughness
APART, APART_LEVEL, TWO = "a value a texel", "a value a texel, one level", "two lobes"  # without a material's prior
CLEAR = 0.5  # of its loss: a fit that leads by so much over one value for the material needs no prior
LEAST = 0.01  # roughness: of texels that are not observed it is 0
PLAIN_LEVEL = 0.05  # a Specular IOR Level so near to 0.5 is 0.5


@dataclass(frozen=True)
class Decision:
    """What prediction says of a material."""

    model: str  # a row of core.models.LADDER
    why: str
    level: float | None = None  # Specular IOR Level, where the fit is not to find it
    prior: JointPrior | None = None  # that the texels are to be drawn with
    prediction: MaterialPrediction | None = None  # None: nothing could be left out
    cancelled: bool = False  # the trials were stopped


@dataclass(frozen=True)
class _Trial:
    """A way to describe the material."""

    name: str
    model: str
    strength: float | None = None  # None: as the model is solved without a prior of the material
    free_level: bool = False


@dataclass(frozen=True)
class _Fitted:
    """What the fit's evidence chose."""

    model: str
    level: float  # Specular IOR Level


class ModelPrediction:
    """Tries models of one material on its sample."""

    def __init__(self, device: Device, source: Source, settings: SolveSettings) -> None:
        self.device, self.source, self.settings = device, source, replace(settings, loss="squares")

    def decide(self, texels: Bool, model: str, level: float) -> Generator[Progress, None, Decision]:
        """``texels``: (h, w) of the material that are observed; ``model``: what the fit's evidence chose.

        ``level``: the Specular IOR Level that the fit found.
        """
        with self.device.scope():
            sample = sampled(self.device, self.source, texels, self.settings.seed)
            if sample is None:
                return Decision(model, "nothing says which lamps shone")
            observed, places = read_sample(self.device, sample, JUDGED)
            folds = split(observed)
            if folds is None:
                return Decision(model, "too few lamps and cameras to leave one out")
            contest = _Contest(self, sample, observed, places, folds, _Fitted(model, level))
            if not contest.judge.judged.any():
                return Decision(model, f"no texel has good observations enough to leave {folds.of} out")
            return (yield from contest.decide())


class _Contest:
    """One material's trials, fold by fold."""

    def __init__(
        self, owner: ModelPrediction, sample: MaterialSample, observed: SampledTexels, places: I32, folds: Folds,
        fitted: _Fitted,
    ) -> None:
        self.sample, self.observed, self.places, self.folds = sample, observed, places, folds
        self.model, self.fitted_level = fitted.model, fitted.level
        self.settings = owner.settings
        self.solver = Solver(owner.device, sample, self.settings)
        self.solver.shown = False
        self.search = JointSearch(observed)
        self.judge = Judge(observed, folds)
        self.predictions: dict[str, list[F64]] = {}
        self.trials: dict[str, _Trial] = {}
        self.free_level = False  # whether the Specular IOR Level of texels apart may be another than 0.5

    def decide(self) -> Generator[Progress, None, Decision]:
        joints = [self.search.fit(~left_out) for left_out in self.folds.left_out]
        self.free_level = abs(joints[0].apart_level - 0.5) > PLAIN_LEVEL
        yield from self._folds(joints, self._simple)
        if not self.solver.cancelled and not self.judge.leads(self._incumbent(), CLEAR):
            yield from self._folds(joints, self._drawn)
        if self.solver.cancelled:
            return Decision(self.model, "stopped before left-out views were predicted", cancelled=True)
        errors = {name: self.judge.error(name) for name in self.predictions}
        taken = self.judge.choose(self._families(), clusters(self.sample, self.places), self._incumbent())
        return self._decision(self.trials[taken], errors, joints)

    def _folds(
        self, joints: list[Joint], attempt: Callable[[Bool, Joint], Generator[Progress, None, None]],
    ) -> Generator[Progress, None, None]:
        """Some trials in every fold, with what they predict."""
        for left_out, joint in zip(self.folds.left_out, joints, strict=True):
            self.sample.left_out = left_out
            yield from attempt(~left_out, joint)
            if self.solver.cancelled:
                return
        self.sample.left_out = np.zeros_like(self.folds.left_out[0])
        for name, predictions in self.predictions.items():
            self.judge.add(name, predictions)

    def _families(self) -> list[list[str]]:
        """Names of trials from the smallest models on, but for fits that nothing holds together.

        Where the fit's own choice finds false lobes, another free fit may seem better by luck.
        """
        families = [[name] for name in ("lambert", "one value", "one value and level")]
        for model in LADDER[1:]:
            families.append([name for name, trial in self.trials.items()
                             if trial.model == model and trial.strength in STRENGTHS])
        return [family for family in families if family]

    def _incumbent(self) -> str:
        return {"lambert": "lambert", "one-lobe": APART, "one-lobe-specular": APART_LEVEL, "two-lobe": TWO}[self.model]

    def _simple(self, known: Bool, joint: Joint) -> Generator[Progress, None, None]:
        """No lobe, one value for the material, and the model that the fit prefers."""
        count = len(self.places)
        self._add(_Trial("lambert", "lambert"), None, known)
        self._add(_Trial("one value", "one-lobe", ONE),
                  one_lobe(np.full(count, joint.plain_roughness), 0.5), known)
        self._add(_Trial("one value and level", "one-lobe-specular", ONE, True),
                  one_lobe(np.full(count, joint.roughness), joint.level), known)
        if self.model == "two-lobe":
            yield from self._two_lobes(known)
        elif self.model != "lambert":
            yield from self._lobe_a_texel(known, joint, self._incumbent(), (None,))

    def _drawn(self, known: Bool, joint: Joint) -> Generator[Progress, None, None]:
        """A value a texel, drawn to the material's."""
        for name in [APART, APART_LEVEL] if self.free_level else [APART]:
            yield from self._lobe_a_texel(known, joint, name, STRENGTHS)

    def _two_lobes(self, known: Bool) -> Generator[Progress, None, None]:
        maps = yield from self.solver.solve_two()
        pairs = maps.read_pairs(self.solver.device)
        assert pairs is not None
        lobes = pairs.reshape(-1, 3)[self.places].astype(np.float64)
        lobes[:, :2] = np.clip(lobes[:, :2], LEAST, 1.0)
        self._add(_Trial(TWO, "two-lobe"), Lobes(
            lobes[:, :2], lobes[:, 2], np.full(len(lobes), 0.5), self.settings.ndf == "beckmann"), known)
        maps.release()

    def _lobe_a_texel(
        self, known: Bool, joint: Joint, name: str, strengths: tuple[float | None, ...],
    ) -> Generator[Progress, None, None]:
        """``name``: APART or APART_LEVEL; ``strengths``: of the material's prior, None for none."""
        free = name == APART_LEVEL
        level, roughness = (joint.apart_level, joint.apart_roughness) if free else (0.5, joint.plain_roughness)
        if free and strengths == (None,):
            level = self.fitted_level
        self.solver.use_level(np.full(self.sample.size[::-1], level, np.float32) if free else None)
        maps = yield from self.solver.under_priors(
            [None if strength is None else JointPrior(roughness, strength) for strength in strengths])
        self.solver.use_level(None)
        for strength, values in zip(strengths, maps, strict=True):
            label = name if strength is None else f"{name}, prior {strength:g}"
            self._add(_Trial(label, "one-lobe-specular" if free else "one-lobe", strength, free),
                      one_lobe(self._at(values), level), known)

    def _at(self, values: F32) -> F64:
        return np.clip(values.ravel()[self.places].astype(np.float64), LEAST, 1.0)

    def _add(self, trial: _Trial, lobes: Lobes | None, known: Bool) -> None:
        """What a trial predicts of a fold; ``known``: layers that are not left out."""
        self.trials[trial.name] = trial
        self.predictions.setdefault(trial.name, []).append(predicted(self.observed, lobes, known))

    def _decision(self, taken: _Trial, errors: dict[str, PredictionError], joints: list[Joint]) -> Decision:
        best = errors[taken.name]
        why = (f"left-out {self.folds.of} are predicted to {best.relative_rms:.3g} of their radiance, L* "
               f"{best.lightness:.2g} ({taken.name}); " + ", ".join(
                   f"{name}: {error.relative_rms:.3g}, {error.lightness:.2g}" for name, error in errors.items()
                   if name != taken.name))
        joint = self.search.fit(np.ones(len(self.observed.camera), bool))
        plain = not taken.free_level
        roughness = joint.plain_roughness if plain else joint.roughness
        values = np.array([j.plain_roughness if plain else j.roughness for j in joints])
        # Jackknife (Quenouille 1956) over the folds.
        sigma = float(np.sqrt((len(values) - 1) * values.var())) if taken.strength == ONE else 0.0
        level = None
        if taken.strength is not None and not plain:
            level = joint.level if taken.strength == ONE else joint.apart_level
        prior = None if taken.strength is None else JointPrior(roughness, taken.strength, sigma)
        return Decision(taken.model, why, level, prior, MaterialPrediction(self.folds.of, taken.name, errors))
