"""The choice between models, by numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.models import Fit, choose, evidence

E = float(np.e)
FLOOR = 0.003


def f32(*values: float) -> np.ndarray:
    return np.array(values, np.float32)


def fit(residual: np.ndarray, searched: float) -> Fit:
    return Fit(residual.astype(np.float32), np.full(residual.shape, searched, np.float32))


def one_cell(n: np.ndarray) -> np.ndarray:
    return np.zeros(n.shape, np.int32)


def apart(n: np.ndarray) -> np.ndarray:
    return np.arange(len(n), dtype=np.int32)


def test_evidence_is_the_information_criterion():
    """n log(R / n + floor^2) + p log n, worked out: 10 log(.1) + 3 log 10 = -7 log 10, and 4 log(e^2) + log 4."""
    n = f32(10)
    residual = 10 * (0.1 - FLOOR**2) * f32(1)
    assert evidence(n, fit(residual, 3), one_cell(n), FLOOR) == pytest.approx(-7 * np.log(10), rel=1e-6)
    n = f32(4)
    residual = 4 * (E**2 - FLOOR**2) * f32(1)
    assert evidence(n, fit(residual, 1), one_cell(n), FLOOR) == pytest.approx(8 + np.log(4), rel=1e-6)


def test_a_cell_has_one_noise():
    """Two texels of residuals 1 and 3 with 10 observations each: together 20 log(4 / 20)."""
    n = f32(10, 10)
    assert evidence(n, fit(f32(1, 3), 0), one_cell(n), FLOOR) == pytest.approx(20 * np.log(0.2 + FLOOR**2), rel=1e-6)


def test_evidence_adds_over_cells():
    n, r = f32(10, 4, 7), f32(0.02, 0.5, 0.001)
    single = [evidence(n[i:i + 1], fit(r[i:i + 1], 1), one_cell(n[:1]), FLOOR) for i in range(3)]
    assert evidence(n, fit(r, 1), apart(n), FLOOR) == pytest.approx(sum(single), rel=1e-12)


@pytest.mark.parametrize(("ratio", "model"), [(1.0, "lambert"), (1.2, "lambert"), (1.3, "one-lobe"), (50, "one-lobe")])
def test_the_lobe_must_pay_for_what_it_determined(ratio, model):
    """With n = 10 a number that the data determined costs log 10 = 2.30; it pays where 10 log(ratio) is more."""
    n = f32(*[10] * 5)
    lobe = np.full(5, 10 * 0.01)
    lambert = (lobe + 10 * FLOOR**2) * ratio - 10 * FLOOR**2
    assert choose(n, {"one-lobe": fit(lobe, 1), "lambert": fit(lambert, 0)}, one_cell(n), FLOOR)[0] == model


def test_a_number_that_the_data_leave_open_costs_nothing():
    """A gain of 10 log 1.05 = 0.49 a texel pays for a fifth of a number (0.46), not for a whole one (2.30)."""
    n = f32(*[10] * 5)
    lobe = np.full(5, 10 * 0.01)
    lambert = (lobe + 10 * FLOOR**2) * 1.05 - 10 * FLOOR**2
    for searched, model in ((0.2, "one-lobe"), (1.0, "lambert")):
        assert choose(n, {"lambert": fit(lambert, 0), "one-lobe": fit(lobe, searched)}, one_cell(n), FLOOR)[0] == model


def test_below_the_floor_a_better_fit_is_no_evidence():
    """Errors of 0.01 % against 0.1 %, both under the forward model's own 0.3 %: 20 log(1.11) = 2.1 < log 20 = 3.0."""
    n = np.full(100, 20, np.float32)
    fits = {"lambert": fit(n * 1e-3**2, 0), "one-lobe": fit(n * 1e-4**2, 1)}
    assert choose(n, fits, one_cell(n), FLOOR)[0] == "lambert"


def test_a_few_texels_with_a_highlight_decide_for_the_material():
    """Most texels never see a highlight; the five that do carry a lobe through."""
    n = np.full(100, 12, np.float32)
    lobe = n * 0.01**2
    lambert = lobe.copy()
    lambert[:5] = 12 * 0.2**2
    assert choose(n, {"lambert": fit(lambert, 0), "one-lobe": fit(lobe, 1)}, apart(n), FLOOR)[0] == "one-lobe"


def test_two_lobes_must_bring_what_the_source_asks():
    """A gain of 12 log 1.2 - log 12 = 2.19 - 2.48 < 0 never does; 12 log 2 - 2.48 = 5.8 does up to that."""
    n = np.full(50, 12, np.float32)
    two = n * 0.02**2
    for ratio, least, model in ((1.2, 0.0, "one-lobe"), (2.0, 5.0, "two-lobe"), (2.0, 6.5, "one-lobe")):
        one = (two + n * FLOOR**2) * ratio - n * FLOOR**2
        fits = {"lambert": fit(one * 100, 0), "one-lobe": fit(one, 1), "two-lobe": fit(two, 2)}
        assert choose(n, fits, one_cell(n), FLOOR, least)[0] == model


def test_a_level_need_not_bring_what_two_lobes_must():
    """It is one number for all texels: 12 log 1.2 = 2.19 pays for its one nat, 12 log 1.05 = 0.59 does not."""
    n = np.full(50, 12, np.float32)
    level = n * 0.02**2
    for ratio, model in ((1.2, "one-lobe-specular"), (1.05, "one-lobe")):
        one = (level + n * FLOOR**2) * ratio - n * FLOOR**2
        fits = {"lambert": fit(one * 100, 0), "one-lobe": fit(one, 1), "one-lobe-specular": fit(level, 1)}
        assert choose(n, fits, one_cell(n), FLOOR, 5.0)[0] == model


def test_texels_with_few_observations_say_nothing():
    n = f32(2, 2, 2)
    model, why = choose(n, {"lambert": fit(f32(1, 1, 1), 0), "one-lobe": fit(f32(0, 0, 0), 1)}, one_cell(n), FLOOR)
    assert model == "lambert" and "three good observations" in why


def test_the_reason_holds_the_numbers():
    n = f32(*[10] * 4)
    _, why = choose(n, {"lambert": fit(n * 0.5, 0), "one-lobe": fit(n * 0.01, 1)}, one_cell(n), FLOOR)
    assert "lambert +3" in why and "3 texels" in why  # of a cell three quarters are heard


def test_texels_that_no_model_explains_do_not_drown_the_others():
    """One in five lies at an edge of shadow, off by 30 % under either model; the others tell the models apart."""
    n = np.full(100, 12, np.float32)
    edge = np.arange(100) % 5 == 0
    two = np.where(edge, n * 0.3**2, n * 0.01**2)
    one = np.where(edge, n * 0.3**2, n * 0.05**2)
    fits = {"lambert": fit(one * 100, 0), "one-lobe": fit(one, 1), "two-lobe": fit(two, 2)}
    assert choose(n, fits, one_cell(n), FLOOR, 5.0)[0] == "two-lobe"
