"""The candidates of a material: what each holds for all texels, what it leaves to them, and under which priors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from ...core.data import ONE_BASE, ONE_VALUE, JointPrior
from ...core.evaluation.coat_search import APART, METAL, PLAIN
from ...core.evaluation.joint_material import Joint, OneMaterial

STRENGTHS = (200.0, 10.0)  # of the material's prior: nats per squared log ratio of roughness
WEAK_STRENGTHS = (0.3, 0.1)  # that keep a few texels from flashing and hardly move the others
# Of the material's base colour: observations of a texel for which it counts; by the last, all texels have that colour.
BASE_STRENGTHS = (2.0, 8.0, 32.0, 128.0, ONE_BASE)
LEVEL_STRENGTHS = ((200.0, 1.0), (200.0, 0.2), (10.0, 0.2))  # where levels differ too: of roughness, and of level


@dataclass(frozen=True)
class Fitted:
    """What the fit's evidence chose."""

    model: str
    level: float = 0.5  # Specular IOR Level
    beside: bool = False  # another material, whose colour pixels at the border mix into what all texels say


@dataclass(frozen=True)
class Trial:
    """A way to describe the material by what all its texels say together."""

    name: str
    model: str
    strength: float  # of the prior about the joint roughness
    material: Callable[[Joint], OneMaterial]
    coat: str = ""  # what is free below a coat, a word of core/evaluation/coat_search.py; "": there is none
    rough: bool = False  # whether its diffuse is rough
    level_strength: float = 0.0  # of the prior about the joint level; 0: all texels have that level
    base_strength: float = 0.0  # of the prior about the material's base colour; 0: there is none
    settled: bool = False  # whether its values are settled by what they predict

    def prior(self, one: OneMaterial, sigma: float = 0.0) -> JointPrior | None:
        """That its texels are drawn with, of what is found of the material."""
        if self.strength == 0:
            return None
        prior = JointPrior(one.roughness, self.strength, sigma, one.others)
        return replace(prior, level=one.level, level_strength=self.level_strength) if self.level_strength else prior


def _trials(
    name: str, model: str, material: Callable[[Joint], OneMaterial], coat: str = "",
    strengths: tuple[float, ...] = STRENGTHS,
) -> list[Trial]:
    return [Trial(f"{name}, prior {strength:g}", model, strength, material, coat) for strength in strengths]


UNIFORM = (
    Trial("one value", "one-lobe", ONE_VALUE, lambda joint: joint.plain),
    Trial("one value and level", "one-lobe-specular", ONE_VALUE, lambda joint: joint.specular),
)
UNIFORM_METAL = Trial("one value, level and metallic", "one-lobe-metallic", ONE_VALUE, lambda joint: joint.metal)
DRAWN = _trials("a value a texel", "one-lobe", lambda joint: joint.plain)
DRAWN_WEAKLY = _trials("a value a texel", "one-lobe", lambda joint: joint.plain, strengths=WEAK_STRENGTHS)
DRAWN_LEVEL = _trials("a value a texel, one level", "one-lobe-specular", lambda joint: joint.apart)
DRAWN_LEVELS = [Trial(f"a value and level a texel, prior {strength:g}, {level:g}", "one-lobe-specular", strength,
                       lambda joint: joint.specular, level_strength=level) for strength, level in LEVEL_STRENGTHS]
DRAWN_METAL = _trials("a value a texel, one metallic", "one-lobe-metallic", lambda joint: joint.apart_metal)
UNIFORM_COAT = Trial("one value, level and coat", "one-lobe-specular", ONE_VALUE, lambda joint: joint.coated[PLAIN],
                      PLAIN)
UNIFORM_COAT_METAL = Trial("one value, level, metallic and coat", "one-lobe-metallic", ONE_VALUE,
                            lambda joint: joint.coated[METAL], METAL)
DRAWN_COAT = _trials("a value a texel, one level and coat", "one-lobe-specular",
                     lambda joint: joint.coated[PLAIN], PLAIN)
DRAWN_COAT_METAL = _trials("a value a texel, one metallic and coat", "one-lobe-metallic",
                           lambda joint: joint.coated[METAL], METAL)
FREE_COAT = Trial("a value a texel and coat", "one-lobe-specular", 0.0, lambda joint: joint.coated[APART], APART)

PARTS = [Trial("two parts", "one-lobe-specular", STRENGTHS[0], lambda joint: joint.parts[0]),
         Trial("three parts", "one-lobe-specular", STRENGTHS[0], lambda joint: joint.parts[1])]


def _above_rough(trial: Trial, strength: float, name: str = "") -> Trial:
    """The same above a rough diffuse.  The Diffuse Roughness of texels that differ is what they say together."""
    def material(joint: Joint) -> OneMaterial:
        assert joint.rough is not None
        one = trial.material(joint.rough)
        return one if strength == ONE_VALUE else replace(one, diffuse=joint.rough.apart.diffuse)

    return replace(trial, name=f"{name or trial.name}, rough diffuse", strength=strength, material=material, rough=True)


UNIFORM_ROUGH = [_above_rough(trial, ONE_VALUE) for trial in UNIFORM]
DRAWN_ROUGH = [_above_rough(trial, trial.strength) for trial in DRAWN]
DRAWN_LEVEL_ROUGH = [_above_rough(trial, trial.strength) for trial in DRAWN_LEVEL]
FREE_ROUGH = [_above_rough(DRAWN[0], 0.0, "a value a texel"),
              _above_rough(DRAWN_LEVEL[0], 0.0, "a value a texel, one level")]
MODELS = "one-lobe", "one-lobe-specular", "one-lobe-metallic"  # from the smallest on
# The fit's own, without a prior of the material:
FITTED = {"lambert": "lambert", "one-lobe": "a value a texel", "one-lobe-specular": "a value a texel, one level",
          "two-lobe": "two lobes"}
OWN_DRAWN = {"one-lobe": DRAWN, "one-lobe-specular": DRAWN_LEVEL}
CONSTANT = Trial("one material", "one-lobe-specular", ONE_VALUE, lambda joint: joint.constant[0])
CONSTANT_METAL = Trial("one material and metallic", "one-lobe-metallic", ONE_VALUE, lambda joint: joint.constant[1])


def with_drawn_base(trial: Trial) -> list[Trial]:
    """The same with base colours that are drawn to the material's, under several priors."""
    return [replace(trial, name=drawn_name(trial.name, strength), base_strength=strength)
            for strength in BASE_STRENGTHS]


def drawn_name(name: str, strength: float) -> str:
    """Of a trial whose base colours are drawn to the material's."""
    return f"{name}, one base color" if strength >= ONE_BASE else f"{name}, base color prior {strength:g}"


def settled(trial: Trial) -> Trial:
    """The same with values that are settled by what they predict; its level is free."""
    model = "one-lobe-specular" if trial.model == "one-lobe" else trial.model
    return replace(trial, name=f"{trial.name}, settled by prediction", model=model, settled=True)


_METALS = CONSTANT_METAL, UNIFORM_METAL, *DRAWN_METAL, UNIFORM_COAT_METAL, *DRAWN_COAT_METAL
METALS = frozenset(of.name for trial in _METALS for metal in (trial, *with_drawn_base(trial))
                   for of in (metal, settled(metal)))


def by_size(trials: list[Trial]) -> list[list[str]]:
    """Names of one value for the material, of parts, and of texels that are drawn, by model; those with levels last."""
    uniform: dict[tuple[bool, bool, int, bool], list[str]] = {}  # whatever their prior about base colour
    constants = CONSTANT.material, CONSTANT_METAL.material  # which have to predict clearly better than the usual values
    for trial in trials:
        if trial.strength == ONE_VALUE:
            size = bool(trial.coat), trial.rough, MODELS.index(trial.model), trial.material in constants
            uniform.setdefault(size, []).append(trial.name)
    parts = [[trial.name] for trial in trials if trial in PARTS]
    drawn: dict[tuple[bool, int], list[str]] = {}
    for trial in trials:
        if trial.strength != ONE_VALUE and trial not in PARTS:
            drawn.setdefault((trial in DRAWN_LEVELS, MODELS.index(trial.model)), []).append(trial.name)
    return [*(uniform[size] for size in sorted(uniform)), *parts, *(drawn[size] for size in sorted(drawn))]
