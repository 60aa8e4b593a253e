"""One value for a material that is settled by what it predicts of lamps that are left out."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest

from irpso_addon.core.data import Coat
from irpso_addon.core.evaluation import folds
from irpso_addon.core.evaluation.joint_material import JointSearch, OneMaterial
from irpso_addon.core.evaluation.sampled_texels import SampledTexels, predicted, predicted_apart
from irpso_addon.core.evaluation.value_descent import LEVEL, METALLIC, ROUGH, ValueDescent, lobes_of, numbers_of
from irpso_addon.core.job import Progress
from irpso_addon.gpu.solve.prediction_trials import DRAWN, METALS, UNIFORM, UNIFORM_METAL, Trial, settled
from irpso_addon.gpu.solve.settled_trials import SettledTrials
from tests.support import tilted_sphere as balls

LEVEL_TRIAL = UNIFORM[1]
Found = TypeVar("Found")


def two_lobes(way: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Half of each: no candidate has both."""
    narrow, wide = balls.principled(0.12), balls.principled(0.6)
    return np.asarray(0.5 * narrow(way, normals) + 0.5 * wide(way, normals))


def texels_of(reflect: balls.Reflect, seed: int = 1, noise: float = 0.01) -> SampledTexels:
    return balls.sphere(reflect, lamps=18, noise=noise, seed=seed)[0].texels


def contest(texels: SampledTexels, trial: Trial) -> SettledTrials:
    """A trial of one value was taken."""
    made = object.__new__(SettledTrials)
    made.observed, made.folds, made.trials = texels, folds.split(texels, 2), {trial.name: trial}
    made.places, made.predictions, made.lobes = np.arange(len(texels.cos_v), dtype=np.int32), {}, {}
    made.search = JointSearch(texels)
    made.joints = [made.search.fit(~out) for out in made.folds.left_out]
    made.judge = folds.Judge(texels, made.folds)
    made.judge.add("lambert", [predicted(texels, None, ~out) for out in made.folds.left_out])
    made.judge.add(trial.name, [predicted(texels, lobes_of(trial.material(joint), len(texels.cos_v)), ~out)
                                for out, joint in zip(made.folds.left_out, made.joints, strict=True)])
    return made


def end_of(steps: Generator[Progress, None, Found]) -> Found:
    try:
        while True:
            next(steps)
    except StopIteration as stop:
        found: Found = stop.value
        return found


def error_of(texels: SampledTexels, one: OneMaterial) -> float:
    """Of the radiance of every third lamp, predicted by the others."""
    judge = folds.Judge(texels, folds.split(texels))
    judge.add("lambert", [predicted(texels, None, ~out) for out in judge.folds.left_out])
    judge.add("one", [predicted(texels, lobes_of(one, len(texels.cos_v)), ~out) for out in judge.folds.left_out])
    return judge.error("one").relative_rms


def test_where_no_candidate_has_the_material_values_that_predict_are_taken() -> None:
    made = contest(texels_of(two_lobes), LEVEL_TRIAL)
    taken = end_of(made._with_settled_values(LEVEL_TRIAL.name, 0.0))
    assert taken == settled(LEVEL_TRIAL).name and made.trials[taken].settled
    assert made.judge.error(taken).relative_rms < 0.5 * made.judge.error(LEVEL_TRIAL.name).relative_rms
    # Lamps from elsewhere and other texels, which took no part, too:
    joint = LEVEL_TRIAL.material(made.search.fit(np.ones(18, bool)))
    one = end_of(made._settled_values(made.trials[taken], joint, 0.0))
    other = texels_of(two_lobes, seed=7)
    assert error_of(other, one) < 0.9 * error_of(other, joint)


@pytest.mark.parametrize("trial", UNIFORM)
@pytest.mark.parametrize("rough", [0.2, 0.5])
def test_in_its_own_world_nothing_is_settled_again(rough: float, trial: Trial) -> None:
    made = contest(texels_of(balls.principled(rough), noise=0.05), trial)
    assert end_of(made._with_settled_values(trial.name, 0.0)) == trial.name


def test_only_one_value_is_settled() -> None:
    made = contest(texels_of(two_lobes), LEVEL_TRIAL)
    made.trials[DRAWN[0].name] = DRAWN[0]
    for name in ("lambert", "a value a texel", DRAWN[0].name):
        assert end_of(made._with_settled_values(name, 0.0)) == name


@pytest.mark.parametrize(("start", "free"), [
    (OneMaterial(0.3, 0.8), (ROUGH, LEVEL)), (OneMaterial(0.6, 0.3), (ROUGH, LEVEL)),
    (OneMaterial(0.3, 0.5, 0.3), (ROUGH, LEVEL, METALLIC))])
def test_a_descent_finds_what_made_the_pictures(start: OneMaterial, free: tuple[int, ...]) -> None:
    texels = texels_of(balls.principled(0.4), noise=0.02)
    descent = ValueDescent(texels, folds.split(texels), np.arange(len(texels.cos_v), dtype=np.int32))
    *_, found = descent.run(start, free)
    assert found.roughness == pytest.approx(0.4, abs=0.002)
    assert found.level == pytest.approx(0.5, abs=0.01) and found.metallic == pytest.approx(0.0, abs=0.003)


def test_what_is_hidden_has_no_part() -> None:
    texels = texels_of(two_lobes)
    every = folds.split(texels)
    changed = replace(texels, reflected=np.where(every.left_out[1][:, None], 9.0, texels.reflected))
    found = []
    for sample in (texels, changed):
        descent = ValueDescent(sample, every, np.arange(len(texels.cos_v), dtype=np.int32), without=1)
        *_, last = descent.run(OneMaterial(0.3), (ROUGH, LEVEL))
        found.append(numbers_of(last))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


def test_predicted_apart_is_each_fold_by_itself() -> None:
    texels = texels_of(two_lobes)
    lobes = lobes_of(OneMaterial(0.3, 0.4, 0.2, coat=Coat(0.5, 0.1), diffuse=0.3), len(texels.cos_v))
    left_out = folds.split(texels).left_out
    together = predicted_apart(texels, lobes, left_out, drawn=8.0, by_light=1.0)
    for out in left_out:
        alone = predicted(texels, lobes, ~out, drawn=8.0, by_light=1.0)
        np.testing.assert_array_equal(together[:, out], alone[:, out])


def test_a_settled_metal_is_a_metal() -> None:
    assert settled(UNIFORM_METAL).name in METALS and settled(LEVEL_TRIAL).name not in METALS
    assert settled(UNIFORM[0]).model == "one-lobe-specular"
