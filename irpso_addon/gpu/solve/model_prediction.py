"""Which model of a material predicts best what left-out lamps or cameras show, on squares of its texels."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from ...core.change_records import PredictionError
from ...core.data import I32, ONE_VALUE, Bool, Coat, JointPrior, MaterialPrediction
from ...core.errors import Cancelled
from ...core.evaluation.coat_search import APART, METAL, PLAIN, CoatSearch
from ...core.evaluation.folds import ALIKE, Folds, split
from ...core.evaluation.joint_material import Joint, JointSearch, OneMaterial
from ...core.evaluation.pixel_bias import pixel_bias
from ...core.evaluation.sampled_texels import SampledTexels, common_base, noise_by_light
from ...core.evaluation.value_descent import lobes_of
from ...core.job import Progress
from ...core.params import SolveSettings
from ...core.tiled.tiled_plan import PriorKnowledge
from ..device.context import Device
from ..observe.observation_atlas import Source
from .drawn_base_trials import CLEAR, HOPEFUL, PLAIN_METALLIC
from .map_around import MapAround
from .material_sample import MaterialSample, packed, read_sample, squares_of
from .prediction_trials import (
    DRAWN,
    DRAWN_COAT,
    DRAWN_COAT_METAL,
    DRAWN_LEVEL,
    DRAWN_LEVEL_ROUGH,
    DRAWN_LEVELS,
    DRAWN_METAL,
    DRAWN_ROUGH,
    DRAWN_WEAKLY,
    FITTED,
    FREE_COAT,
    FREE_ROUGH,
    OWN_DRAWN,
    PARTS,
    UNIFORM,
    UNIFORM_COAT,
    UNIFORM_COAT_METAL,
    UNIFORM_METAL,
    UNIFORM_ROUGH,
    Fitted,
    Trial,
    by_size,
)
from .settled_trials import SettledTrials
from .tile_passes import ROBUST_METAL
from .trial_runs import PREDICTING

NUMBERS = 2  # that a fit of one lobe finds in each texel: base colour and roughness
FEW = 8  # good observations of a texel: with fewer, it may need a prior though texels differ clearly
JUDGED = 2000  # texels, of a sample
CLEAR_TWO = 0.5  # CLEAR of two lobes, which have no prior: false ones flash so seldom that samples miss it
SAME_LEVEL = 0.05  # a Specular IOR Level so near to 0.5 in all folds is 0.5: nothing else is to be tried
SOME_METALLIC = 0.08  # a Metallic worth the time to try it where texels differ
WORTH_RMS, WORTH_LIGHTNESS = 0.05, 0.7  # errors of what would be taken from which on more is tried
NOTICEABLE = 1.0  # L*: below, nobody sees what base colours would gain by going by what is lit well
CLEAR_MORE = 1 / 6  # of its loss, by which a coat or a rough diffuse must lead: they mend a little of every material
DIVIDED = 1.02  # ratio of errors of L* from which on parts divide what changes gradually
LEAST_ROUGH = 0.05  # Diffuse Roughness that every fold must find
BROADEST = 0.95  # roughness of a metal from which on its lobe only takes up what the diffuse lacks
LEAST_COAT = 0.02  # weight that every fold must find
AGREED = 2.0  # ratio of the folds' largest roughness of the coat to the least
STOPPED = "stopped before left-out views were predicted"


def solves_metals(device: Device, source: Source) -> bool:
    """Whether the device finishes the kernels of metals, see `Layers.at_once`."""
    return not device.is_software or source.layers.at_once(ROBUST_METAL) > 0


@dataclass(frozen=True)
class Decision:
    """What prediction says of a material."""

    model: str  # a row of core.models.LADDER
    why: str
    level: float | None = None  # Specular IOR Level, where the fit is not to find it
    metallic: float = 0.0
    coat: Coat | None = None
    diffuse_roughness: float = 0.0
    prior: JointPrior | None = None  # that the texels are to be drawn with
    prediction: MaterialPrediction | None = None  # None: nothing could be left out
    differ: bool = False  # texels seem to differ, though one value for all of them was taken
    cancelled: bool = False  # the trials were stopped


class ModelPrediction:
    """Tries models of one material on its sample."""

    def __init__(self, device: Device, source: Source, settings: SolveSettings) -> None:
        self.device, self.source, self.settings = device, source, replace(settings, loss="squares")

    def decide(self, texels: Bool, fitted: Fitted) -> Generator[Progress, None, Decision]:
        """``texels``: (h, w) of the material that are observed."""
        try:
            return (yield from self._decided(texels, fitted))
        except Cancelled:
            return Decision(fitted.model, STOPPED, cancelled=True)

    def _decided(self, texels: Bool, fitted: Fitted) -> Generator[Progress, None, Decision]:
        with self.device.scope():
            squares = squares_of(self.source, texels, self.settings.seed)
            if squares is None:
                return Decision(fitted.model, "the views do not name their lamps")
            sample = packed(self.device, self.source, texels, squares)
            yield PREDICTING
            observed, places = read_sample(self.device, sample, JUDGED, bounds=True)
            folds = split(observed, NUMBERS)
            if folds is None:
                return Decision(fitted.model, "too few lamps and cameras to leave one out")
            around = MapAround(self.device, self.source, texels, squares, self.settings)
            contest = _Contest(self, sample, observed, places, folds, fitted, around)
            if not contest.judge.judged.any():
                return Decision(fitted.model, f"no texel has enough good observations to leave {folds.of} out")
            return (yield from contest.decide())

    def metal(self, texels: Bool) -> OneMaterial:
        """The level and Metallic that explain all texels together, where each has its own roughness."""
        with self.device.scope():
            squares = squares_of(self.source, texels, self.settings.seed)
            if squares is None:
                return OneMaterial(0.5)
            sample = packed(self.device, self.source, texels, squares)
            observed, _ = read_sample(self.device, sample, JUDGED, bounds=True)
            search, known = JointSearch(observed), np.ones(len(observed.camera), bool)
            return search.apart(known)


class _Contest(SettledTrials):
    """Which of one material's trials is to be taken."""

    def __init__(
        self, owner: ModelPrediction, sample: MaterialSample, observed: SampledTexels, places: I32, folds: Folds,
        fitted: Fitted, around: MapAround,
    ) -> None:
        super().__init__(owner.device, sample, owner.settings, observed, places, folds)
        self.fitted, self.metals, self.around = fitted, solves_metals(owner.device, sample), around
        self.settled = False  # whether the joints are, see `JointSearch.settled`
        self.coats: CoatSearch | None = None  # where one is sought

    def decide(self) -> Generator[Progress, None, Decision]:
        for left_out in self.folds.left_out:
            yield PREDICTING
            self.joints.append(self.search.fit(~left_out))
        metal = self.metals and min(joint.metal.metallic for joint in self.joints) > PLAIN_METALLIC
        yield from self._folds(self._own)
        yield from self._folds(self._uniform, [*UNIFORM, *([UNIFORM_METAL] if metal else [])])
        few = self.observed.typical_observations() < FEW
        incumbent, clear = FITTED[self.fitted.model], CLEAR
        if self.fitted.model == "two-lobe":
            clear = CLEAR_TWO
            if not self.solver.cancelled and not self.judge.leads(incumbent, clear, self.predictions):
                self.fitted = replace(self.fitted, model="one-lobe", level=0.5)
                incumbent, clear = FITTED["one-lobe"], CLEAR
        led = not self.solver.cancelled and self._leads(incumbent, clear)
        if not self.solver.cancelled and not led:
            yield from self._settle()
            yield from self._folds(self._drawn, PARTS, race=True)
            near = self.judge.near([trial.name for trial in UNIFORM], HOPEFUL)
            yield from self._folds(self._drawn, DRAWN if UNIFORM[0].name in near else [], race=True)
            free = max(abs(joint.apart.level - 0.5) for joint in self.joints) > SAME_LEVEL
            yield from self._folds(self._drawn, DRAWN_LEVEL if free and UNIFORM[1].name in near else [], race=True)
            yield from self._folds(self._drawn_levels, DRAWN_LEVELS, race=True)
        elif few and self.fitted.model in OWN_DRAWN:
            yield from self._settle()
            yield from self._folds(self._drawn, OWN_DRAWN[self.fitted.model], race=True)
        if not self.solver.cancelled and not self._leads(incumbent, 0.0 if led else clear) and self._flashes():
            yield from self._folds(self._drawn, DRAWN_WEAKLY, race=True)
        # A metal's roughness may differ from texel to texel: then one value says little of it.
        apart = self.metals and self._apart_metallic() > SOME_METALLIC
        if apart and not self.solver.cancelled:
            yield from self._settle()
            apart = self._apart_metallic() > SOME_METALLIC
        if not self.solver.cancelled and (
                apart or self.judge.leads(UNIFORM_METAL.name, ALIKE[0], self.predictions)):
            yield from self._settle()
            yield from self._folds(self._drawn, DRAWN_METAL, race=True)
        if self.solver.cancelled:
            return Decision(self.fitted.model, STOPPED, cancelled=True)
        margin = ALIKE[0] if few and led else clear  # one that led is larger by a prior alone
        leads, taken = self._verdict(incumbent, margin, few)
        if taken != incumbent and incumbent in self.predictions and self.fitted.model in OWN_DRAWN and (
                yield from self._again(incumbent, self._own_among_all)):
            leads, taken = self._verdict(incumbent, margin, few)
        if self.solver.cancelled:
            return Decision(self.fitted.model, STOPPED, cancelled=True)
        errors = {name: self.judge.error(name) for name in self.predictions}
        before = taken
        # A rough diffuse may hide behind a metal that leaves little.
        if not self.solver.cancelled and (self._is_metal(taken) or worth(self.judge.error(taken))):
            taken = yield from self._above_rough(taken)
        if not self.solver.cancelled and worth(self.judge.error(taken)):
            taken = yield from self._under_coats(taken, metal or apart)
        if not self.solver.cancelled and not self.fitted.beside and worth(self.judge.error(taken)):
            taken = yield from self._with_drawn_base(taken)
        if self.solver.cancelled:
            return Decision(self.fitted.model, STOPPED, cancelled=True)
        by_light, left, same = 0.0, self.judge.error(taken), taken == before
        if self.observed.nodes is None and (  # what shines from all around is alike
                left.relative_rms >= WORTH_RMS or left.lightness >= NOTICEABLE):
            by_light = yield from self._by_light(taken)
            taken = yield from self._with_settled_values(taken, by_light)
        errors |= {name: self.judge.error(name) for name in self.predictions}
        return (yield from self._decision(
            MaterialPrediction(self.folds.of, taken, errors, leads and same, by_light=by_light,
                               noise_by_light=noise_by_light(self.observed, by_light))))

    def _verdict(self, incumbent: str, margin: float, few: bool) -> tuple[bool, str]:
        """(whether the fit's own model leads, what is to be taken)."""
        leads, chosen = self._leads(incumbent, margin), self._chosen()
        if not few and self.fitted.model in OWN_DRAWN:
            one_value = chosen in self.trials and self.trials[chosen].strength == ONE_VALUE
            leads = leads or self.judge.excuses(incumbent, NUMBERS, chosen if one_value else None)
        leads = leads and self.judge.no_worse_than_plain(incumbent)
        return leads, incumbent if leads else chosen

    def _apart_metallic(self) -> float:
        """The least Metallic that a fold finds where texels differ."""
        return min(joint.apart_metal.metallic for joint in self.joints)

    def _settle(self) -> Generator[Progress, None, None]:
        """Level and Metallic of texels that differ, between the nodes: once, where they are needed."""
        for n, left_out in enumerate(() if self.settled else self.folds.left_out):
            yield PREDICTING
            self.joints[n] = self.search.settled(self.joints[n], ~left_out)
        self.settled = True

    def _leads(self, incumbent: str, clear: float) -> bool:
        """Over all but two lobes that were given up."""
        return self.judge.leads(incumbent, clear, [
            name for name in self.predictions if name != FITTED["two-lobe"] or name == incumbent])

    def _flashes(self) -> bool:
        """Whether a roughness a texel, which does not lead, has the least error of lightness: a few texels flash."""
        least = min(self.predictions, key=lambda name: self.judge.error(name).lightness)
        return least == FITTED["one-lobe"]

    def _above_rough(self, taken: str) -> Generator[Progress, None, str]:
        """The trial with a rough diffuse that is to be taken instead, if there is one, else ``taken``."""
        if self.observed.nodes is not None:  # what shines from all around has no direction
            return taken
        values: list[float] = []
        for left_out in self.folds.left_out:
            yield PREDICTING
            values.append(self.search.diffuse_roughness(~left_out))
            if min(values) < LEAST_ROUGH or max(values) > AGREED * min(values):
                return taken
        self.joints = [_with_rough(self.search, joint, ~left_out, value) for left_out, joint, value in zip(
            self.folds.left_out, self.joints, values, strict=True)]
        yield from self._folds(self._uniform, UNIFORM_ROUGH)
        for trial in FREE_ROUGH:
            yield from self._folds(self._drawn, [trial], race=True)
        if not self.solver.cancelled and self._best_rough(taken) is not None:
            yield from self._folds(self._drawn, DRAWN_ROUGH, race=True)
            yield from self._folds(self._drawn, DRAWN_LEVEL_ROUGH, race=True)
        return taken if self.solver.cancelled else self._best_rough(taken) or taken

    def _is_metal(self, taken: str) -> bool:
        return taken in self.trials and self.trials[taken].model == "one-lobe-metallic"

    def _best_rough(self, taken: str) -> str | None:
        """The trial with a rough diffuse that leads; it has no Metallic, so that it need not lead a metal."""
        error = self.judge.error(taken)
        trials = [trial for trial in self.trials.values() if trial.rough and self._no_worse(trial.name, error)]
        drawn = [trial for trial in trials if trial not in FREE_ROUGH]
        found = self.judge.choose(
            [["lambert"], *by_size(drawn), *([trial.name] for trial in FREE_ROUGH if trial in trials)])
        metal = self._is_metal(taken)
        rival = self.judge.choose(self._families([trial for trial in self.trials.values() if not (
            trial.rough or trial.coat or trial.model == "one-lobe-metallic")])) if metal else taken
        leads = self.judge.leads(found, CLEAR_MORE, [rival]) and (
            not metal or found in self.judge.near([found, taken], ALIKE[0]))
        return found if found != "lambert" and leads else None

    def _under_coats(self, taken: str, metal: bool) -> Generator[Progress, None, str]:
        """The trial with a coat that is to be taken instead, if there is one, else ``taken``."""
        error = self.judge.error(taken)
        yield PREDICTING
        # Texels differ, as it seems, or what lies below the coat's highlights says that they do:
        differ = taken not in self.trials or self.trials[taken].strength < ONE_VALUE or (
            self.judge.error(FITTED[self.fitted.model]).lightness < error.lightness)
        pairs = [(UNIFORM_COAT, DRAWN_COAT)] if self._find_coats(PLAIN) else []
        if metal and self._find_coats(METAL):
            pairs.append((UNIFORM_COAT_METAL, DRAWN_COAT_METAL))
        yield from self._folds(self._uniform, [uniform for uniform, _ in pairs])
        differ = differ or any(worth(self.judge.error(uniform.name)) for uniform, _ in pairs)
        for uniform, drawn in pairs:
            if differ and not self.solver.cancelled and uniform.name in self.judge.near([uniform.name, taken], HOPEFUL):
                yield from self._folds(self._drawn, drawn, race=True)
        if differ and not self.solver.cancelled and self._find_coats(APART):
            yield from self._folds(self._drawn, [FREE_COAT])
        if self.solver.cancelled:
            return taken
        trials = [trial for trial in self.trials.values() if trial.coat and self._no_worse(trial.name, error)]
        if FREE_COAT in trials and not self.judge.leads(FREE_COAT.name, CLEAR_TWO, [trial.name for trial in trials]):
            trials.remove(FREE_COAT)  # what no prior holds together must be clear, as of two lobes
        found = self.judge.choose([[taken], *by_size(trials)])
        return found if self.judge.leads(found, CLEAR_MORE, [taken]) else taken

    def _find_coats(self, kind: str) -> bool:
        """Whether all folds find a coat, and much the same; then their joint values have it."""
        found = []
        for left_out, joint in zip(self.folds.left_out, self.joints, strict=True):
            found.append(self._coated(kind, ~left_out, joint))
            coats = [joint.coated[kind].coat for joint in found]
            rough = [coat.roughness for coat in coats if coat is not None and coat.weight > LEAST_COAT]
            if len(rough) < len(found) or max(rough) > AGREED * min(rough):
                return False
        self.joints = found
        return True

    def _coated(self, kind: str, known: Bool, joint: Joint) -> Joint:
        """With the coat that the ``known`` layers show."""
        if self.coats is None:
            self.coats = CoatSearch(self.search, self.observed)
        return replace(joint, coated={**joint.coated, kind: self.coats.fit(kind, known, joint, self.fitted.level)})

    def _chosen(self) -> str:
        """The best of the smallest models that predict about as well; a metal whose texels differ must lead clearly."""
        taken = self.judge.choose(self._families(list(self.trials.values())))
        metals = {trial.name for trial in DRAWN_METAL}
        if taken in metals and not self.judge.leads(taken, CLEAR, set(self.predictions) - metals):
            taken = self.judge.choose(self._families(self._without(DRAWN_METAL)))
        return self._unless_gradual(taken) if self.trials.get(taken) in PARTS else taken

    def _unless_gradual(self, parts: str) -> str:
        """Parts divide what changes gradually at borders that no picture shows: then L* is predicted worse by them."""
        found = self.judge.choose(self._families(self._without([*PARTS, *DRAWN_METAL])))
        worse = self.judge.error(parts).lightness > DIVIDED * self.judge.error(found).lightness
        return found if worse and self.judge.leads(found, 0.0, [parts]) else parts

    def _without(self, some: list[Trial]) -> list[Trial]:
        names = {trial.name for trial in some}
        return [trial for trial in self.trials.values() if trial.name not in names]

    def _families(self, trials: list[Trial]) -> list[list[str]]:
        """Their names from the smallest models on; the last is the fit's own, where its texels know no prior.

        Metals come late: a Metallic that is none misleads more than a roughness too many.
        """
        metal = [trial for trial in trials if trial.model == "one-lobe-metallic"]
        plain = [trial for trial in trials if trial not in metal]
        own = [[FITTED[self.fitted.model]]] if self.fitted.model in ("one-lobe", "one-lobe-specular") else []
        return [["lambert"], *by_size(plain), *by_size(metal), *own]

    def _own(self, known: Bool, joint: Joint, trials: list[Trial]) -> Generator[Progress, None, None]:
        """No lobe, and the model that the fit prefers; beside two lobes also one."""
        self._add("lambert", None, known)
        model, name = self.fitted.model, FITTED[self.fitted.model]
        if model == "two-lobe":
            self._add(name, (yield from self._two_lobes()), known)
            model, name = "one-lobe", FITTED["one-lobe"]
        if model != "lambert":
            yield from self._own_lobe(name, known)

    def _own_among_all(self, left_out: Bool) -> Generator[Progress, None, None]:
        """The fit's own model, where each square knows what the rest of the map says of it."""
        level = self.fitted.level if self.fitted.model == "one-lobe-specular" else 0.5
        self.solver.before = yield from self.around.without(left_out, level)
        self.solver.cancelled = self.solver.cancelled or self.around.cancelled
        if not self.solver.cancelled:
            yield from self._own_lobe(FITTED[self.fitted.model], ~left_out)
        self.solver.before = PriorKnowledge()

    def _decision(self, prediction: MaterialPrediction) -> Generator[Progress, None, Decision]:
        taken, errors, best = prediction.taken, prediction.tried, prediction.error
        weights = f", base colors by irradiance^{prediction.by_light:g}" if prediction.by_light else ""
        why = (f"left-out {self.folds.of} are predicted to {best.relative_rms:.3g} of their radiance, L* "
               f"{best.lightness:.2g} ({taken}{weights}); " + ", ".join(
                   f"{name}: {error.relative_rms:.3g}, {error.lightness:.2g}" for name, error in errors.items()
                   if name != taken))
        if taken not in self.trials:
            model = "lambert" if taken == "lambert" else self.fitted.model
            return Decision(model, why, prediction=prediction)
        trial = self.trials[taken]
        known = np.ones(len(self.observed.camera), bool)
        joint = self.search.fit(known)
        if self.settled:
            joint = self.search.settled(joint, known)
        if trial.coat:
            joint = self._coated(trial.coat, known, joint)
        if trial.rough:
            joint = _with_rough(self.search, joint, known, self.search.diffuse_roughness(known))
        if self.joints[0].constant:
            joint = self.search.with_constant(joint, known)
        one = trial.material(joint)
        values = np.array([trial.material(joint).roughness for joint in self.joints])
        # Jackknife (Quenouille 1956) over the folds.
        sigma = float(np.sqrt((len(values) - 1) * values.var())) if trial.strength == ONE_VALUE else 0.0
        if trial.strength == ONE_VALUE and not trial.coat:
            sigma = float(np.hypot(sigma, pixel_bias(self.observed, lambda texels: trial.material(
                self._joint(texels, known, trial)).roughness)))
        if trial.settled:  # what two ways find is off by as much as they differ
            found, one = one, (yield from self._settled_values(trial, one, prediction.by_light))
            sigma = float(np.hypot(sigma, one.roughness - found.roughness))
        prior = trial.prior(one, sigma)
        if prior is not None and trial.base_strength:
            prior = replace(prior, base=common_base(self.observed, lobes_of(one, len(self.places))),
                            base_strength=trial.base_strength)
        level = None if trial.model == "one-lobe" or trial in DRAWN_LEVELS else one.level
        prediction = replace(
            prediction, broad_metal=trial.model == "one-lobe-metallic" and one.roughness >= BROADEST)
        # The lightness of most pixels says that texels differ, though the few brightest would flash.
        differ = (trial.strength == ONE_VALUE and self.fitted.model in ("one-lobe", "one-lobe-specular")
                  and errors[FITTED[self.fitted.model]].lightness < best.lightness)
        return Decision(trial.model, why, level, one.metallic, one.coat, one.diffuse, prior, prediction, differ)

    def _joint(self, texels: SampledTexels, known: Bool, trial: Trial) -> Joint:
        """Of some texels, as far as a trial without a coat goes by it."""
        search = JointSearch(texels, self.metals and not trial.rough)
        joint = search.fit(known)
        if self.joints[0].constant:
            joint = search.with_constant(joint, known)
        return _with_rough(search, joint, known, search.diffuse_roughness(known)) if trial.rough else joint


def _with_rough(search: JointSearch, joint: Joint, known: Bool, diffuse: float) -> Joint:
    """And what explains the texels together with a rough diffuse."""
    return replace(joint, rough=search.settled(search.fit(known, diffuse), known))


def worth(error: PredictionError) -> bool:
    """Whether so much is left that a larger model is worth its time."""
    return error.relative_rms >= WORTH_RMS or error.lightness >= WORTH_LIGHTNESS
