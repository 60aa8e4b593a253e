"""Which model of a material predicts best what left-out lamps or cameras show, on squares of its texels."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

import numpy as np

from ...core.data import F32, F64, I32, ONE_VALUE, Bool, JointPrior, MaterialPrediction
from ...core.evaluation.folds import ALIKE, Folds, Judge, split
from ...core.evaluation.joint_material import Joint, JointSearch, OneMaterial
from ...core.evaluation.sampled_texels import Lobes, SampledTexels, one_lobe, predicted
from ...core.job import Progress
from ...core.params import SolveSettings
from ..device.context import Device
from ..observe.observation_atlas import Source
from .material_sample import MaterialSample, clusters, read_sample, sampled
from .solver import Solver

STRENGTHS = (200.0, 10.0)  # of the material's prior: nats per squared log ratio of roughness
JUDGED = 1000  # texels, of a sample
CLEAR = 0.15  # of its loss: a fit that leads by so much over one value for the material needs no prior
CLEAR_TWO = 0.5  # the same of two lobes, which have no prior: false ones flash so seldom that samples miss it
HOPEFUL = 0.25  # the same: one value that is not worse than the best one value by more is tried a texel, too
LEAST = 0.01  # roughness: of texels that are not observed it is 0
PLAIN_METALLIC = 0.03  # a Metallic so near to 0 is 0 ...
SOME_METALLIC = 0.08  # ... and one above this worth the time to try it where texels differ


@dataclass(frozen=True)
class Decision:
    """What prediction says of a material."""

    model: str  # a row of core.models.LADDER
    why: str
    level: float | None = None  # Specular IOR Level, where the fit is not to find it
    metallic: float = 0.0
    prior: JointPrior | None = None  # that the texels are to be drawn with
    prediction: MaterialPrediction | None = None  # None: nothing could be left out
    cancelled: bool = False  # the trials were stopped


@dataclass(frozen=True)
class Fitted:
    """What the fit's evidence chose."""

    model: str
    level: float = 0.5  # Specular IOR Level


@dataclass(frozen=True)
class _Trial:
    """A way to describe the material by what all its texels say together."""

    name: str
    model: str
    strength: float  # of the prior about the joint roughness
    material: Callable[[Joint], OneMaterial]

    def prior(self, joint: Joint, sigma: float = 0.0) -> JointPrior:
        """That its texels are drawn with."""
        one = self.material(joint)
        return JointPrior(one.roughness, self.strength, sigma, one.others)


def _trials(name: str, model: str, material: Callable[[Joint], OneMaterial]) -> list[_Trial]:
    return [_Trial(f"{name}, prior {strength:g}", model, strength, material) for strength in STRENGTHS]


UNIFORM = (
    _Trial("one value", "one-lobe", ONE_VALUE, lambda joint: joint.plain),
    _Trial("one value and level", "one-lobe-specular", ONE_VALUE, lambda joint: joint.specular),
)
UNIFORM_METAL = _Trial("one value, level and metallic", "one-lobe-metallic", ONE_VALUE, lambda joint: joint.metal)
DRAWN = _trials("a value a texel", "one-lobe", lambda joint: joint.plain)
DRAWN_LEVEL = _trials("a value a texel, one level", "one-lobe-specular", lambda joint: joint.apart)
DRAWN_METAL = _trials("a value a texel, one metallic", "one-lobe-metallic", lambda joint: joint.apart_metal)
PARTS = [_Trial("two parts", "one-lobe-specular", STRENGTHS[0], lambda joint: joint.parts[0]),
         _Trial("three parts", "one-lobe-specular", STRENGTHS[0], lambda joint: joint.parts[1])]
# The fit's own, without a prior of the material:
FITTED = {"lambert": "lambert", "one-lobe": "a value a texel", "one-lobe-specular": "a value a texel, one level",
          "two-lobe": "two lobes"}


def _by_size(trials: list[_Trial]) -> list[list[str]]:
    """Names of one value for the material, of parts, and of texels that are drawn, by model."""
    uniform = [[trial.name] for trial in trials if trial.strength == ONE_VALUE]
    parts = [[trial.name] for trial in trials if trial in PARTS]
    drawn = [trial for trial in trials if trial.strength != ONE_VALUE and trial not in PARTS]
    return [*uniform, *parts, *([trial.name for trial in drawn if trial.model == model]
                                for model in dict.fromkeys(trial.model for trial in drawn))]


class ModelPrediction:
    """Tries models of one material on its sample."""

    def __init__(self, device: Device, source: Source, settings: SolveSettings) -> None:
        self.device, self.source, self.settings = device, source, replace(settings, loss="squares")

    def decide(self, texels: Bool, fitted: Fitted) -> Generator[Progress, None, Decision]:
        """``texels``: (h, w) of the material that are observed."""
        with self.device.scope():
            sample = sampled(self.device, self.source, texels, self.settings.seed)
            if sample is None:
                return Decision(fitted.model, "nothing says which lamps shone")
            observed, places = read_sample(self.device, sample, JUDGED)
            folds = split(observed)
            if folds is None:
                return Decision(fitted.model, "too few lamps and cameras to leave one out")
            contest = _Contest(self, sample, observed, places, folds, fitted)
            if not contest.judge.judged.any():
                return Decision(fitted.model, f"no texel has good observations enough to leave {folds.of} out")
            return (yield from contest.decide())


    def metal(self, texels: Bool) -> OneMaterial:
        """The level and Metallic that explain all texels together, where each has its own roughness."""
        with self.device.scope():
            sample = sampled(self.device, self.source, texels, self.settings.seed)
            if sample is None:
                return OneMaterial(0.5)
            observed, _ = read_sample(self.device, sample, JUDGED)
            return JointSearch(observed).fit(np.ones(len(observed.camera), bool)).apart_metal


class _Contest:
    """One material's trials, fold by fold."""

    def __init__(
        self, owner: ModelPrediction, sample: MaterialSample, observed: SampledTexels, places: I32, folds: Folds,
        fitted: Fitted,
    ) -> None:
        self.sample, self.observed, self.places, self.folds, self.fitted = sample, observed, places, folds, fitted
        self.settings = owner.settings
        self.solver = Solver(owner.device, sample, self.settings)
        self.solver.shown = False
        self.search = JointSearch(observed)
        self.joints = [self.search.fit(~left_out) for left_out in folds.left_out]
        self.judge = Judge(observed, folds)
        self.predictions: dict[str, list[F64]] = {}
        self.trials: dict[str, _Trial] = {}

    def decide(self) -> Generator[Progress, None, Decision]:
        metal = min(joint.metal.metallic for joint in self.joints) > PLAIN_METALLIC
        yield from self._folds(self._own)
        yield from self._folds(self._uniform, [*UNIFORM, *([UNIFORM_METAL] if metal else [])])
        incumbent = FITTED[self.fitted.model]
        clear = CLEAR_TWO if self.fitted.model == "two-lobe" else CLEAR
        if not self.solver.cancelled and not self.judge.leads(incumbent, clear, self.predictions):
            yield from self._folds(self._drawn, PARTS)
            near = self.judge.near([trial.name for trial in UNIFORM], HOPEFUL)
            for uniform_trial, drawn in zip(UNIFORM, (DRAWN, DRAWN_LEVEL), strict=True):
                yield from self._folds(self._drawn, drawn if uniform_trial.name in near else [])
        # A metal's roughness may differ from texel to texel: then one value says little of it.
        apart = min(joint.apart_metal.metallic for joint in self.joints) > SOME_METALLIC
        if not self.solver.cancelled and (
                apart or self.judge.leads(UNIFORM_METAL.name, ALIKE[0], self.predictions)):
            yield from self._folds(self._drawn, DRAWN_METAL)
        if self.solver.cancelled:
            return Decision(self.fitted.model, "stopped before left-out views were predicted", cancelled=True)
        errors = {name: self.judge.error(name) for name in self.predictions}
        leads = self.judge.leads(incumbent, clear, self.predictions)
        if self.fitted.model in ("one-lobe", "one-lobe-specular"):
            spared = self.judge.spared()
            leads = leads or (spared > 0 and self.judge.stays(incumbent, spared))
        taken = incumbent if leads else self.judge.choose(self._families(), clusters(self.sample, self.places))
        return self._decision(MaterialPrediction(self.folds.of, taken, errors, leads))

    def _folds(
        self, attempt: Callable[[Bool, Joint, list[_Trial]], Generator[Progress, None, None]],
        trials: list[_Trial] | None = None,
    ) -> Generator[Progress, None, None]:
        """Some trials in every fold, with what they predict."""
        if trials == [] or self.solver.cancelled:
            return
        before = set(self.predictions)
        for left_out, joint in zip(self.folds.left_out, self.joints, strict=True):
            self.sample.left_out = left_out
            yield from attempt(~left_out, joint, trials or [])
            if self.solver.cancelled:
                return
        self.sample.left_out = np.zeros_like(self.folds.left_out[0])
        self.trials |= {trial.name: trial for trial in trials or []}
        for name, predictions in self.predictions.items():  # in order: Lambert is the first
            if name not in before:
                self.judge.add(name, predictions)

    def _families(self) -> list[list[str]]:
        """Names of trials from the smallest models on; the last is the fit's own, where its texels know no prior.

        Metals come late: a Metallic that is none misleads more than a roughness too many.
        """
        metal = [trial for trial in self.trials.values() if trial.model == "one-lobe-metallic"]
        plain = [trial for trial in self.trials.values() if trial not in metal]
        own = [[FITTED[self.fitted.model]]] if self.fitted.model in ("one-lobe", "one-lobe-specular") else []
        return [["lambert"], *_by_size(plain), *_by_size(metal), *own]

    def _own(self, known: Bool, joint: Joint, trials: list[_Trial]) -> Generator[Progress, None, None]:
        """No lobe, and the model that the fit prefers."""
        self._add("lambert", None, known)
        model, name = self.fitted.model, FITTED[self.fitted.model]
        if model == "two-lobe":
            self._add(name, (yield from self._two_lobes()), known)
        elif model != "lambert":
            level = self.fitted.level if model == "one-lobe-specular" else 0.5
            self.solver.use_level(self._grid(level) if level != 0.5 else None)
            (values,) = yield from self.solver.under_priors([None])
            self._add(name, one_lobe(self._at(values), level), known)

    def _uniform(self, known: Bool, joint: Joint, trials: list[_Trial]) -> Generator[Progress, None, None]:
        """One value for the material."""
        yield Progress(0.5, "solve", "predicting left-out views")
        for trial in trials:
            one = trial.material(joint)
            self._add(trial.name, one_lobe(np.full(len(self.places), one.roughness), one.level, one.metallic), known)

    def _drawn(self, known: Bool, joint: Joint, trials: list[_Trial]) -> Generator[Progress, None, None]:
        """A value a texel, drawn to the material's, under several priors at one level and Metallic."""
        one = trials[0].material(joint)
        self.solver.use_level(self._grid(one.level) if one.level != 0.5 else None)
        self.solver.use_metallic(one.metallic)
        maps = yield from self.solver.under_priors([trial.prior(joint) for trial in trials])
        self.solver.use_metallic(0.0)
        for trial, values in zip(trials, maps, strict=True):
            self._add(trial.name, one_lobe(self._at(values), one.level, one.metallic), known)

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

    def _add(self, name: str, lobes: Lobes | None, known: Bool) -> None:
        """What a trial predicts of a fold; ``known``: layers that are not left out."""
        self.predictions.setdefault(name, []).append(predicted(self.observed, lobes, known))

    def _decision(self, prediction: MaterialPrediction) -> Decision:
        taken, errors, best = prediction.taken, prediction.tried, prediction.error
        why = (f"left-out {self.folds.of} are predicted to {best.relative_rms:.3g} of their radiance, L* "
               f"{best.lightness:.2g} ({taken}); " + ", ".join(
                   f"{name}: {error.relative_rms:.3g}, {error.lightness:.2g}" for name, error in errors.items()
                   if name != taken))
        if taken not in self.trials:
            model = "lambert" if taken == "lambert" else self.fitted.model
            return Decision(model, why, prediction=prediction)
        trial = self.trials[taken]
        joint = self.search.fit(np.ones(len(self.observed.camera), bool))
        one = trial.material(joint)
        values = np.array([trial.material(joint).roughness for joint in self.joints])
        # Jackknife (Quenouille 1956) over the folds.
        sigma = float(np.sqrt((len(values) - 1) * values.var())) if trial.strength == ONE_VALUE else 0.0
        return Decision(trial.model, why, None if one.level == 0.5 else one.level, one.metallic,
                        trial.prior(joint, sigma), prediction)
