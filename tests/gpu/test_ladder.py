"""Which model a material gets, and what the larger models find: observations of which everything is known."""

from __future__ import annotations

import gc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import ONE_VALUE, JointPrior
from irpso_addon.core.errors import Cancelled
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.solve.ladder_records import EarlierResult, LadderResult, Materials
from irpso_addon.gpu.solve.model_ladder import Ladder
from tests.support import texel_problem as bench
from tests.support.texels import Texels, exact, finish, held

PAINT = ("Paint",)


def settings(texels: Texels, **chosen: Any) -> SolveSettings:
    return SolveSettings(**{"size": max(16, texels.quality.shape[0]), **chosen})


def climb(on_gl: Any, texels: Texels, slots: np.ndarray | None = None, names: tuple[str, ...] = PAINT,
          **chosen: Any) -> LadderResult:
    """What the ladder finds; one material unless told."""
    where = np.zeros(texels.quality.shape[:2], np.int32) if slots is None else slots

    def job(device: Device) -> LadderResult:
        source = texels.source(device)
        ladder = Ladder(device, source, settings(texels, **chosen), Materials(where, names))
        found = finish(ladder.solve())
        ladder.release()
        source.release()
        return found

    return on_gl(job)


def at_level(problem: bench.Problem, level: np.ndarray | float) -> np.ndarray:
    """(h, w, K, 3) what one lobe of the problem's roughness reflects at another Specular IOR Level (h, w)."""
    sin2h, _, cos_l, factor = np.moveaxis(problem.lobes[..., 0, :].astype(np.float64), -1, 0)
    cos_v, r = problem.cos_v.astype(np.float64), problem.truth.roughness[..., None]
    cos_vh = np.minimum((cos_l + cos_v) / (2 * np.sqrt(1 - sin2h)), 1)
    there = np.broadcast_to(np.broadcast_to(level, problem.quality.shape[:2])[..., None], cos_v.shape)
    energy = brdf.principled_energy_level(r, cos_v, there)
    roots = brdf.lambda_root(r**4, 1 / cos_l**2 - 1) + brdf.lambda_root(r**4, 1 / cos_v**2 - 1)
    s = factor * brdf.F_level_ratio(cos_vh, there) * brdf.D_ggx(r**4, sin2h) / roots * energy[..., 0]
    return np.asarray(problem.truth.base[:, :, None] * ((1 - energy[..., 1]) / np.pi)[..., None] + s[..., None])


def seen_as(texels: Texels, rgb: np.ndarray, noise: float = 0.0) -> Texels:
    """The same texels with other values where they are observed."""
    value = rgb * (1 + noise * np.random.default_rng(4).standard_normal(rgb.shape))
    return replace(texels, rgb=np.where(texels.quality[..., None] > 0, value, 0).astype(np.float32))


# ---- auto


@pytest.mark.one_python
@pytest.mark.parametrize(("model", "size"), [("lambert", 32), ("one-lobe", 32), ("one-lobe", 64), ("two-lobe", 32)])
@pytest.mark.parametrize("seed", range(4))
def test_auto_takes_the_model_that_made_the_data(on_gl, model, size, seed):
    """Twelve observations a texel with 1 % noise."""
    found = climb(on_gl, exact(model=model, size=size, noise=0.01, seed=seed)[1])
    assert found.model == {"Paint": model}
    assert "information criterion" in found.why["Paint"]
    assert (found.lobes is not None) == (model == "two-lobe")
    assert found.level is None
    assert not found.cancelled


@pytest.mark.one_python
@pytest.mark.parametrize("noise", [0.0, 0.001, 0.003, 0.03])
def test_auto_never_takes_two_lobes_for_one(on_gl, noise):
    for seed in range(4):
        found = climb(on_gl, exact(noise=noise, seed=10 + seed)[1])
        assert found.model == {"Paint": "one-lobe"}, seed


def quarters() -> tuple[bench.Problem, Texels, np.ndarray]:
    """One map of four materials: no lobe, one, one of level 0.8, two; a corner of a fifth that nobody sees."""
    made = {model: bench.make(bench.Spec(model, 12, 64)) for model in ("lambert", "one-lobe", "two-lobe")}
    one = made["one-lobe"]
    slots = np.kron(np.array([[0, 1], [2, 3]]), np.ones((32, 32))).astype(np.int32)
    values = [made["lambert"].rgb, one.rgb, at_level(one, 0.8), made["two-lobe"].rgb]
    rgb = np.select([slots[..., None, None] == slot for slot in range(4)], values)
    quality = one.quality.copy()
    quality[:6, :6] = 0
    slots[:6, :6] = 5
    texels = Texels(rgb, quality, one.cos_v, one.lobes, one.groups)
    return made["two-lobe"], seen_as(texels, rgb, 0.01), slots


NAMES = ("Chalk", "Gloss", "Lacquer", "Coat", "Empty", "Unseen")


def test_materials_of_one_map_get_their_own_models(on_gl):
    """And those without texels, or without observations, none."""
    two, texels, slots = quarters()
    found = climb(on_gl, texels, slots, NAMES)
    expected = {"Chalk": "lambert", "Gloss": "one-lobe", "Lacquer": "one-lobe-specular", "Coat": "two-lobe"}
    assert found.model == expected
    assert set(found.why) == set(expected)
    assert found.levels == {"Lacquer": pytest.approx(0.8, abs=0.05)}
    assert (found.level[slots == 1] == 0.5).all()
    assert (found.level[slots == 2] == np.float32(found.levels["Lacquer"])).all()
    gloss, coat = slots == 1, slots == 3
    np.testing.assert_array_equal(found.lobes[gloss, 0], found.texels.roughness[gloss])
    np.testing.assert_array_equal(found.lobes[gloss, 1], found.texels.roughness[gloss])
    assert (found.lobes[gloss, 2] == 1).all()
    np.testing.assert_array_equal(found.lobes[coat, 0], found.texels.roughness[coat])
    assert np.median(np.abs(found.lobes[..., 0] - two.truth.roughness)[coat]) < 0.1
    left = np.sqrt(found.texels.residual / np.maximum(found.texels.observations, 1))
    assert all(np.median(left[slots == slot]) < 0.01 for slot in range(1, 4))  # three channels' mean: 0.006 of noise
    one = bench.make(bench.Spec("one-lobe", 12, 64)).truth.roughness
    for slot in (1, 2):
        assert np.median(np.abs(found.texels.roughness - one)[slots == slot]) < 0.015
    assert not found.texels.solved[slots == 5].any()


def test_slots_of_one_material_decide_together(on_gl):
    """Half of a material shows no lobe; the other half decides for both."""
    chalk, gloss = (bench.make(bench.Spec(model, 12, 32)) for model in ("lambert", "one-lobe"))
    slots = (np.arange(32) >= 16).astype(np.int32)[None].repeat(32, 0)
    rgb = np.where(slots[..., None, None] == 0, chalk.rgb, gloss.rgb)
    texels = seen_as(Texels(rgb, gloss.quality, gloss.cos_v, gloss.lobes, gloss.groups), rgb, 0.01)
    assert climb(on_gl, texels, slots, ("Paint", "Paint")).model == {"Paint": "one-lobe"}
    assert climb(on_gl, texels, slots, ("A", "B")).model == {"A": "lambert", "B": "one-lobe"}


def test_nothing_observed_is_no_model(on_gl):
    texels = exact()[1]
    dark = replace(texels, quality=np.zeros_like(texels.quality))
    found = climb(on_gl, dark)
    assert (found.model, found.why) == ({}, {})
    assert np.isfinite(found.texels.roughness).all() and np.isfinite(found.texels.sigma).all()
    assert not found.texels.solved.any()


# ---- Specular IOR Level


@pytest.mark.parametrize("level", [0.3, 0.8])
@pytest.mark.parametrize(("noise", "within"), [(0.0, 0.01), (0.01, 0.05)])
def test_the_specular_level_of_a_material_comes_out(on_gl, level, noise, within):
    problem, texels = exact()
    texels = seen_as(texels, at_level(problem, level), noise)
    for model in ("one-lobe-specular", "auto"):
        found = climb(on_gl, texels, model=model)
        assert found.model == {"Paint": "one-lobe-specular"}
        assert found.levels == {"Paint": pytest.approx(level, abs=within)}
        assert (found.level == np.float32(found.levels["Paint"])).all()
        rough = np.abs(found.texels.roughness - problem.truth.roughness)
        assert rough.mean() < (0.04 if noise else 1e-3)


@pytest.mark.parametrize("specular", ["material", "texel"])
def test_what_no_view_sees_keeps_the_usual_level(on_gl, specular):
    """A quarter that nothing observes, as a material of its own."""
    problem, texels = exact()
    slots = np.zeros((32, 32), np.int32)
    slots[16:, 16:] = 1
    quality = np.where(slots[..., None] == 1, 0, texels.quality)
    texels = seen_as(replace(texels, quality=quality), at_level(problem, 0.8))
    found = climb(on_gl, texels, slots, ("Seen", "Unseen"), model="one-lobe-specular", specular=specular)
    beyond = slice(None, 12), slice(None, 12)
    assert (found.level[20:, 20:] == 0.5).all()
    assert np.median(found.level[beyond]) == pytest.approx(0.8, abs=0.01)
    assert found.levels.get("Unseen", 0.5) == 0.5


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_the_usual_level_stays_one_lobe(on_gl, noise):
    """Level 0.5 is what the Principled BSDF has of itself; asked for, it is found."""
    texels = exact(noise=noise)[1]
    assert climb(on_gl, texels).model == {"Paint": "one-lobe"}
    levels = climb(on_gl, texels, model="one-lobe-specular").levels
    assert levels == {"Paint": pytest.approx(0.5, abs=0.05 if noise else 0.005)}


def test_two_materials_get_their_own_levels(on_gl):
    problem, texels = exact(size=64)
    slots = (np.arange(64) >= 32).astype(np.int32)[None].repeat(64, 0)
    texels = seen_as(texels, at_level(problem, np.where(slots == 0, 0.3, 0.8)))
    found = climb(on_gl, texels, slots, ("Dull", "Bright"), model="one-lobe-specular")
    assert found.levels == {"Dull": pytest.approx(0.3, abs=0.01), "Bright": pytest.approx(0.8, abs=0.01)}


@pytest.mark.parametrize(("noise", "typical"), [(0.0, 0.01), (0.01, 0.06)])
def test_the_specular_level_by_texel_is_a_map(on_gl, noise, typical):
    """Level 0.3 on the left, 0.8 on the right.  Windows of nine texels: right to within four texels of the border."""
    problem, texels = exact(size=64)
    truth = np.where(np.arange(64) < 32, 0.3, 0.8)[None].repeat(64, 0)
    found = climb(on_gl, seen_as(texels, at_level(problem, truth), noise), model="one-lobe-specular",
                  specular="texel")
    assert found.levels == {}
    away = np.abs(np.arange(64) - 31.5) > 5
    off = np.abs(found.level - truth)[:, away]
    assert np.median(off) < typical
    assert np.median(found.level[:, :27]) == pytest.approx(0.3, abs=typical)
    assert np.median(found.level[:, 37:]) == pytest.approx(0.8, abs=typical)
    assert np.median(np.abs(found.texels.roughness - problem.truth.roughness)[:, away]) < (0.03 if noise else 2e-3)


# ---- two lobes


@pytest.mark.parametrize("seed", range(2))
def test_two_lobes_are_found_on_clean_data(on_gl, seed):
    """Twelve observations: fewer than 2 % of texels end in a wrong valley."""
    problem, texels = exact(model="two-lobe", size=64, seed=seed)
    found = climb(on_gl, texels, model="two-lobe")
    truth = np.stack([problem.truth.roughness, problem.truth.roughness2], -1)
    off = np.abs(found.lobes[..., :2] - truth).max(-1)
    assert (off > bench.FAILED).mean() < 0.02
    assert np.median(off) < 1e-4
    assert np.median(np.abs(found.lobes[..., 2] - problem.truth.weight)) < 1e-4
    np.testing.assert_array_equal(found.texels.roughness, found.lobes[..., 0])


@pytest.mark.parametrize("spec", [{"model": "two-lobe", "noise": 0.01}, {"model": "one-lobe"},
                                  {"model": "lambert", "noise": 0.02}, {"model": "one-lobe", "outliers": 0.2}])
def test_lobes_are_in_order_and_weights_are_shares(on_gl, spec):
    """Whatever made the data: r1 <= r2, within what roughness may be, and a weight of 0 to 1."""
    found = climb(on_gl, exact(**spec)[1], model="two-lobe")
    assert np.isfinite(found.lobes).all()
    assert (found.lobes[..., 0] <= found.lobes[..., 1]).all()
    assert found.lobes[..., :2].min() >= np.float32(0.05)
    assert found.lobes.max() <= 1
    assert found.lobes[..., 2].min() >= 0


def test_beckmann_lobes_are_found(on_gl):
    """Cook-Torrance: base / pi and two Beckmann lobes; read with GGX the same data fit far worse."""
    problem, texels = exact(model="two-lobe")
    sin2h, _, cos_l, factor = np.moveaxis(problem.lobes[..., 0, :].astype(np.float64), -1, 0)
    truth, cos_v = problem.truth, problem.cos_v.astype(np.float64)
    parts = []
    for r, share in ((truth.roughness, truth.weight), (truth.roughness2, 1 - truth.weight)):
        alpha2 = r[..., None] ** 4
        roots = sum(brdf.lambda_root_beckmann(alpha2, 1 / c**2 - 1) for c in (cos_l, cos_v))
        parts.append(share[..., None] * factor * brdf.D_beckmann(alpha2, sin2h) / roots)
    diffuse = (truth.base / np.pi)[:, :, None]
    texels = seen_as(texels, diffuse + sum(parts)[..., None])
    # Its lobes have no tails: one that no two observations see may be anything, and is told to be unsure.
    shown = np.all([(part > 1e-3 * diffuse.mean(-1)).sum(-1) >= 2 for part in parts], axis=0)
    found = {ndf: climb(on_gl, texels, model="two-lobe", ndf=ndf) for ndf in ("beckmann", "ggx")}
    off = np.abs(found["beckmann"].lobes[..., :2] - np.stack([truth.roughness, truth.roughness2], -1)).max(-1)
    failed = off > bench.FAILED
    assert 0.2 < shown.mean() < 0.4
    assert failed[shown].mean() < 0.03
    assert np.median(found["beckmann"].texels.sigma[failed]) > 0.2
    assert np.median(off[shown]) < 1e-4
    left = {ndf: np.median(f.texels.residual) for ndf, f in found.items()}
    assert left["beckmann"] < 1e-6 < left["ggx"]


# ---- stopping


PHASES = {
    "auto": {}, "levels of materials": {"model": "one-lobe-specular"},
    "levels of texels": {"model": "one-lobe-specular", "specular": "texel"}, "two lobes": {"model": "two-lobe"},
    "swarm": {"method": "swarm", "model": "one-lobe"}, "paper": {"method": "paper", "iterations": 40},
}


@pytest.fixture(scope="module")
def coat() -> Texels:
    """Two lobes and noise: auto tries everything."""
    return exact(model="two-lobe", noise=0.01)[1]


@pytest.mark.one_python
@pytest.mark.parametrize("phase", PHASES)
def test_a_stop_at_any_step_gives_what_there_is_and_leaves_nothing(on_gl, coat, phase):
    """Stopped at its first, last and steps between; or dropped without a word, as when a window is closed."""

    def job(device: Device) -> list[tuple[int, bool, LadderResult | None]]:
        def run(stop: int | None, drop: bool = False) -> tuple[int, bool, LadderResult | None]:
            source = coat.source(device)
            ladder = Ladder(device, source, settings(coat, **PHASES[phase]),
                            Materials(np.zeros((32, 32), np.int32), PAINT))
            steps, count, told, found = ladder.solve(), 0, False, None
            try:
                while True:
                    next(steps)
                    if count == stop:  # steps are as many as time asks for: the last may not come
                        told = True
                        if drop:
                            steps.close()
                            break
                        steps.throw(Cancelled())
                    count += 1
            except StopIteration as end:
                found = end.value
            del steps
            ladder.release()
            source.release()
            return count, told, found

        idle = device.ctx.simple_framebuffer((1, 1))
        total, _, whole = run(None)
        gc.collect()
        device.collect()
        gc.freeze()  # only what comes from now on is looked through, each time
        before = held(device)
        results = []
        for stop in sorted({0, 1, 2, total // 4, total // 2, 3 * total // 4, total - 2, total - 1} & set(range(total))):
            results.append(run(stop))
            assert held(device) <= before, f"stopped at {stop} of {total}"
            run(stop, drop=True)
            idle.use()  # what was drawn on last is the context's as long as it is bound
            gc.collect()
            device.collect()
            assert held(device) <= before, f"dropped at {stop} of {total}"
        assert not whole.cancelled
        idle.release()
        return results

    try:
        results = on_gl(job)
    finally:
        gc.unfreeze()
    assert sum(told for _, told, _ in results) > 2
    for stop, told, found in results:
        assert found is not None, stop
        assert found.cancelled == told, stop
        assert set(found.model) <= {"Paint"}
        at = found.texels
        for values in (at.roughness, at.sigma, at.residual, found.lobes, found.level, found.base):
            assert values is None or np.isfinite(values).all()


@pytest.mark.parametrize("other", [
    EarlierResult(model={"A": "one-lobe", "B": "one-lobe"}, priors={"B": JointPrior(0.4, ONE_VALUE, 0.02)}),
    EarlierResult(model={"A": "one-lobe", "B": "one-lobe-metallic"}, metallic={"B": 0.7}, levels={"B": 0.5}),
])
def test_blocks_go_by_the_noise_of_texels_without_a_prior(on_gl, other):
    """Whatever the material that is solved last: errors of 16 x 16 texels are alike, and some observations outliers."""
    _, texels = exact(size=64, views=12, noise=0.003)
    rng = np.random.default_rng(0)
    common = np.kron(rng.standard_normal((4, 4, 12)), np.ones((16, 16, 1)))
    rgb = texels.rgb * (1 + 0.02 * common[..., None])
    rgb[rng.random(rgb.shape[:3]) < 0.06] *= 2.5
    texels = replace(texels, rgb=rgb.astype(np.float32))
    slots = np.broadcast_to((np.arange(64) >= 32).astype(np.int32), (64, 64))

    def job(device: Device, last: EarlierResult) -> LadderResult:
        source = texels.source(device)
        ladder = Ladder(device, source, settings(texels, model="auto"), Materials(slots, ("A", "B")), last)
        found = finish(ladder.solve())
        ladder.release()
        source.release()
        return found

    alone = on_gl(lambda device: job(device, EarlierResult(model={"A": "one-lobe", "B": "one-lobe"})))
    beside = on_gl(lambda device: job(device, other))
    assert alone.robust and alone.noise[1].alike > 0.3
    assert (beside.robust, beside.noise[1]) == (alone.robust, alone.noise[1])
