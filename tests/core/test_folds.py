"""Prediction by folds: what is left out, how errors are measured, and which candidate is taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from irpso_addon.core.evaluation.folds import Candidate, Judge, lightness, limited, rises, split
from irpso_addon.core.evaluation.pixel_bias import pixel_bias
from irpso_addon.core.evaluation.sampled_texels import one_lobe, predicted
from tests.support.random_texels import RNG, sampled

pytestmark = pytest.mark.usefixtures("same_draws")


def test_lambert_predicts_the_mean_of_what_is_known() -> None:
    texels, _ = sampled(10, 6, 1, np.full(10, 0.5))
    got = predicted(texels, None, np.ones(6, bool))
    unit = np.maximum(texels.reflected, np.median(texels.reflected, axis=1, keepdims=True)) ** 2
    np.testing.assert_allclose(got[:, 0], np.average(texels.reflected, axis=1, weights=1 / unit), rtol=1e-9)
    assert np.ptp(got, axis=1).max() < 1e-12


def test_each_lamp_is_left_out_once() -> None:
    texels, _ = sampled(4, 7, 3, np.full(4, 0.4))
    folds = split(texels)
    assert folds is not None and folds.of == "lamps" and len(folds.left_out) == 3
    assert (np.sum(folds.left_out, axis=0) == 1).all()
    for left_out in folds.left_out:
        assert not set(texels.lamps[left_out]) & set(texels.lamps[~left_out])


def test_cameras_are_left_out_where_lamps_are_few() -> None:
    texels, _ = sampled(4, 2, 5, np.full(4, 0.4))
    folds = split(texels)
    assert folds is not None and folds.of == "cameras"
    assert split(sampled(4, 2, 2, np.full(4, 0.4))[0]) is None


@given(st.floats(0, 1))
def test_lightness_is_that_of_cie(y: float) -> None:
    f = y ** (1 / 3) if y > (6 / 29) ** 3 else y / (3 * (6 / 29) ** 2) + 4 / 29  # CIE 15, written with deltas
    assert lightness(np.asarray(y)) == pytest.approx(116 * f - 16, abs=1e-9)


def test_errors_are_those_of_the_layers_left_out() -> None:
    texels, _ = sampled(6, 4, 1, np.full(6, 0.4))
    folds = split(texels)
    assert folds is not None
    judge = Judge(texels, folds)
    judge.add("too bright", [texels.reflected * np.where(out, 1.1, 5.0)[:, None] for out in folds.left_out])
    assert judge.error("too bright").relative_rms == pytest.approx(0.1, rel=1e-9)


def test_a_missed_shadow_judges_nobody() -> None:
    texels, _ = sampled(6, 8, 1, np.full(6, 0.4))
    texels.reflected[2, 3] *= 0.01
    folds = split(texels)
    assert folds is not None
    judge = Judge(texels, folds)
    assert not judge.judged[2, 3] and judge.judged.sum() == judge.judged.size - 1


def contest(errors: dict[str, tuple[float, np.ndarray]]) -> str:
    """What is taken where candidates err by so much everywhere, and by more at some texels."""
    texels, _ = sampled(64, 8, 1, np.full(64, 0.4))
    folds = split(texels)
    assert folds is not None
    judge = Judge(texels, folds, np.arange(64, dtype=np.int32) // 4)
    for name, (share, more) in errors.items():
        judge.add(name, [texels.reflected * (1 + share + more[:, None, None])] * len(folds.left_out))
    return judge.choose([["lambert"], ["one value"], ["a texel, prior"], ["a texel"]])


@pytest.mark.parametrize(("lambert", "one", "prior", "apart", "taken"), [
    (0.2, 0.05, 0.05, 0.05, "one value"),
    (0.2, 0.0512, 0.05, 0.05, "one value"),  # hardly worse
    (0.2, 0.06, 0.05, 0.05, "a texel, prior"),
    (0.2, 0.1, 0.06, 0.05, "a texel"),
    (0.05, 0.2, 0.3, 0.2, "lambert"),
])
def test_the_simplest_of_the_best_wins(lambert: float, one: float, prior: float, apart: float, taken: str) -> None:
    none = np.zeros(64)
    values = dict(zip(("lambert", "one value", "a texel, prior", "a texel"), (lambert, one, prior, apart), strict=True))
    assert contest({name: (share, none) for name, share in values.items()}) == taken


@pytest.mark.parametrize(("flash", "taken"), [(0.2, "a texel"), (0.6, "one value")])
def test_what_predicts_radiance_worse_than_no_lobe_is_not_taken(flash: float, taken: str) -> None:
    """Bright places that are predicted too bright: lightness hardly sees them, and half of it is better elsewhere."""
    texels, _ = sampled(64, 8, 1, np.full(64, 0.4))
    folds = split(texels)
    assert folds is not None
    judge = Judge(texels, folds, np.arange(64, dtype=np.int32) // 4)
    order = np.argsort(texels.reflected.mean((1, 2)))
    bright = np.isin(np.arange(64), order[-16:])
    for name, share, more in (("lambert", 0.4, 0.0), ("one value", 0.38, 0.0), ("a texel", 0.05, flash)):
        off = 1 + np.where(bright, more if more else share, share)[:, None, None]
        judge.add(name, [texels.reflected * off] * len(folds.left_out))
    assert judge.error("a texel").lightness < judge.error("lambert").lightness
    assert judge.no_worse_than_plain("a texel") == (taken == "a texel")
    assert judge.choose([["lambert"], ["one value"], ["a texel"]]) == taken


@pytest.mark.parametrize(("flashing", "rise"), [(1, False), (12, True)])
def test_a_rise_in_one_error_is_one_but_not_of_one_place(flashing: int, rise: bool) -> None:
    """Radiance alone: lightness falls.  What one place errs by exceeds all else, and hardly its own scatter."""
    clusters = np.arange(200, dtype=np.int32) // 2
    before = Candidate(np.full(200, 0.1), np.full(200, 4.0))
    flash = np.isin(clusters, np.arange(flashing) * 7)
    after = Candidate(np.where(flash, 100.0, 0.1), np.full(200, 3.0))
    assert rises(before, after, 1.02, clusters) == rise
    assert not rises(before, replace(after, squares=before.squares), 1.02, clusters)
    assert rises(before, replace(before, lightness=np.full(200, 4.4)), 1.02, clusters)


def test_one_texel_that_flashes_is_enough() -> None:
    """A false sharp lobe at one texel in 64: the eye forgives it, radiance does not."""
    flash = np.zeros(64)
    flash[7] = 8.0
    none = np.zeros(64)
    errors = {"lambert": (0.2, none), "one value": (0.06, none), "a texel": (0.05, flash),
              "a texel, prior": (0.3, none)}
    assert contest(errors) == "one value"


def test_a_lobe_that_flashes_in_a_missed_shadow_is_an_error() -> None:
    """Diffuse light that the shadow hides is nobody's fault; what a lobe adds there is."""
    texels, _ = sampled(6, 8, 1, np.full(6, 0.4))
    seen = texels.reflected[2, 3].copy()
    texels.reflected[2, 3] *= 0.01
    folds = split(texels)
    assert folds is not None
    judge = Judge(texels, folds)
    flash = texels.reflected.copy()
    flash[2, 3] = 5 * seen
    plain = texels.reflected.copy()
    plain[2, 3] = seen
    judge.add("lambert", [plain] * 3)
    judge.add("flash", [flash] * 3)
    assert judge.dark.sum() == 1 and judge.dark[2, 3]
    assert judge.error("lambert").relative_rms == 0
    off = float((4 * seen * texels.irradiance[2, 3]).item())
    assert judge.candidates["flash"].squares.sum() == pytest.approx(off**2, rel=1e-9)


@pytest.mark.parametrize(("lamps", "numbers", "folds"), [
    (60, 2, 3), (6, 2, 3), (5, 2, 4), (4, 2, 4), (3, 2, 3), (4, 1, 3), (60, 50, 6)])
def test_of_few_observations_fewer_are_left_out(lamps: int, numbers: int, folds: int) -> None:
    """The variance of a fit, which goes as 1 / (n - numbers), at most doubles; but lamps are no more than they are."""
    texels, _ = sampled(6, lamps, 1, np.full(6, 0.4))
    made = split(texels, numbers)
    assert made is not None and len(made.left_out) == folds
    assert texels.typical_observations() == lamps
    kept = lamps * (1 - 1 / folds)
    if lamps > 3 and folds < 6:
        assert (lamps - numbers) / (kept - numbers) <= 2
    assert (np.sum(made.left_out, 0) == 1).all()


def test_observations_that_are_not_many_spare_the_fit() -> None:
    def judge(lamps: int) -> Judge:
        texels, _ = sampled(6, lamps, 1, np.full(6, 0.4))
        made = Judge(texels, split(texels))
        for name, share in (("lambert", 0.2), ("one value", 0.1), ("a texel", 0.105)):
            made.add(name, [texels.reflected * (1 + share)] * 3)
        return made

    some, many = judge(12), judge(60)
    assert some.spared(2) == pytest.approx(10 / (12 * 2 / 3 - 2) - 1.5)  # variances go as 1 / (n - 2)
    assert many.spared(2) < 0.05
    assert some.stays("a texel", some.spared(2)) and not many.stays("a texel", many.spared(2))
    assert not some.stays("lambert", 0.1)


def test_what_no_layer_of_its_channel_tells_is_not_judged() -> None:
    """Red, green and blue lamps in turn: every third lamp is of one colour, and nothing else shows that."""
    texels, _ = sampled(6, 6, 2, np.full(6, 0.4))
    assert Judge(texels, split(texels)).judged.all()
    colours = replace(texels, channel=texels.lamps % 3)
    assert not Judge(colours, split(colours)).judged.any()
    pairs = replace(texels, channel=texels.lamps % 2)  # of each, two lamps are left
    assert Judge(pairs, split(pairs)).judged.all()


def test_one_place_counts_no_more_than_all_others() -> None:
    """Places of five texels; where there are too few of them, one texel counts no more than all others."""
    values, places = RNG.uniform(0, 1, 50), (np.arange(50) // 5).astype(np.int32)
    np.testing.assert_array_equal(limited(values, places), values)
    values[5:10] += (1e4, 2e4, 0, 0, 9e4)
    got = limited(values, places)
    others = np.delete(np.arange(50), range(5, 10))
    assert got[5:10].sum() == pytest.approx(values[others].sum())
    np.testing.assert_allclose(got[5:10] / got[5], values[5:10] / values[5])
    np.testing.assert_array_equal(got[others], values[others])
    few = limited(values, np.zeros(50, np.int32))
    assert few[9] == pytest.approx(np.delete(values, 9).sum())
    np.testing.assert_array_equal(np.delete(few, 9), np.delete(values, 9))
    np.testing.assert_array_equal(limited(values[:1], places[:1]), values[:1])


def test_one_mirrored_lamp_does_not_make_errors_small() -> None:
    """It is nearly all of the radiance; of everything half is predicted."""
    texels, _ = sampled(60, 12, 2, np.full(60, 0.6))
    folds = split(texels)
    texels.reflected[30, 7] *= 300.0
    judge = Judge(texels, folds)
    judge.add("half", [0.5 * texels.reflected for _ in folds.left_out])
    assert (judge.radiance[30] ** 2).sum() > 100 * (np.delete(judge.radiance, 30, 0) ** 2).sum()
    assert judge.error("half").relative_rms == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize("place", [1, 6])
def test_highlights_of_one_place_that_are_predicted_too_bright_do_not_choose_the_model(place: int) -> None:
    """A roughness of each texel is right, but at one place of so many, whose highlights the folds see too sharp."""
    rough = RNG.uniform(0.3, 0.7, 60)
    texels, _ = sampled(60, 12, 2, rough)
    folds = split(texels)
    texels.lobes[30, 0, :, :2] = 1e-6  # there, a lamp is seen in the middle of its highlight
    judge = Judge(texels, folds, (np.arange(60) // place).astype(np.int32))
    own = np.where(np.arange(60) // place == 30 // place, 0.05, rough)
    one = np.full(60, 0.5)
    for name, lobes in (("lambert", None), ("a value a texel", one_lobe(own, 0.5)), ("one value", one_lobe(one, 0.5))):
        judge.add(name, [predicted(texels, lobes, ~left_out) for left_out in folds.left_out])
    squares = {name: candidate.squares.sum() for name, candidate in judge.candidates.items()}
    assert squares["a value a texel"] > 2 * squares["one value"]
    assert judge.error("a value a texel").relative_rms < judge.error("one value").relative_rms
    assert judge.leads("a value a texel", 0.15, ["one value"])


@pytest.mark.parametrize(("blurs", "lamps", "wanted"), [
    ((1e-4, 3e-4), 8, 0.02), ((1e-4, 1.1e-4), 8, 0.04), ((1e-4,), 0, 0.0)])
def test_what_pixels_add_is_in_proportion_to_the_blur(blurs: tuple[float, ...], lamps: int, wanted: float) -> None:
    """Two halves of texels that differ by 0.02; at most twice that; without lamps nothing is known of it."""
    texels, _ = sampled(200, 8, 1, np.full(200, 0.4))
    blur = np.resize(blurs, 200)
    lobes = texels.lobes[:, :, :lamps].copy()
    lobes[..., 1] = blur[:, None, None]
    texels = replace(texels, lobes=lobes)
    found = pixel_bias(texels, lambda part: 0.4 + 0.02 * float(part.lobes[0, 0, 0, 1] > 1.05e-4) if lamps else 0.4)
    assert found == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize(("bright", "dark", "excused"), [(0.0, 0.2, False), (0.105, 0.05, True)])
def test_a_fit_that_predicts_lightness_worse_than_one_value_is_not_spared(
    bright: float, dark: float, excused: bool,
) -> None:
    """Errors of a fit where radiance is above the median, and where it is below; of one value 0.1 everywhere."""
    texels, _ = sampled(60, 12, 1, np.full(60, 0.4))
    judge = Judge(texels, split(texels))
    radiance = texels.reflected * texels.irradiance
    fit = texels.reflected * (1 + np.where(radiance > np.median(radiance), bright, dark))
    for name, values in (("lambert", 1.3 * texels.reflected), ("one value", 1.1 * texels.reflected), ("a texel", fit)):
        judge.add(name, [values] * 3)
    one, own = judge.error("one value"), judge.error("a texel")
    assert (own.lightness < one.lightness) == excused
    assert judge.excuses("a texel", 2, "one value") == excused
    assert judge.excuses("a texel", 2, None)


def test_what_each_texel_says_of_itself_holds_in_a_part() -> None:
    """Whether it was asked of all texels before or not; every third texel has an observation in a missed shadow."""
    texels, _ = sampled(30, 8, 2, RNG.uniform(0.15, 0.8, 30))
    dark = texels.reflected.copy()
    dark[::3, 2] *= 0.1
    some = np.arange(30) % 4 < 2
    for every in (True, False):
        all_of_them = replace(texels, reflected=dark)
        if every:
            assert not all_of_them.usable()[::3, 2].any()
        part = all_of_them.part(some)
        np.testing.assert_array_equal(part.typical()[:, 0, 0], np.median(dark[some, :, 0], axis=1))
        np.testing.assert_array_equal(part.usable()[:, 2], np.flatnonzero(some) % 3 != 0)


def test_pixels_that_show_another_place_judge_nobody() -> None:
    """A bump hides a tenth of the texels from a camera: its pixels show matt paint behind which a highlight lies."""
    rough = np.where(np.arange(80) % 2 == 0, 0.15, 0.6)
    texels, _ = sampled(80, 8, 2, rough)
    hidden = (np.arange(80)[:, None] % 10 == 0) & (texels.camera == 1)
    elsewhere = np.roll(texels.reflected, 1, 0)
    texels = replace(texels, reflected=np.where(hidden[..., None], elsewhere, texels.reflected),
                     quality=np.where(hidden, 1e-3, texels.cos_v**2))
    folds = split(texels)
    assert folds is not None
    judge = Judge(texels, folds)
    for name, lobes in (("lambert", None), ("true", one_lobe(rough, 0.5))):
        judge.add(name, [predicted(texels, lobes, ~out) for out in folds.left_out])
    assert judge.error("true").relative_rms < 0.02
    assert judge.error("true").lightness < 0.5
