"""The choice between models, by numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.models import FLOOR, PARAMETERS, choose, evidence

E = float(np.e)


def f32(*values: float) -> np.ndarray:
    return np.array(values, np.float32)


def test_the_ladder_counts_what_is_solved_for():
    assert PARAMETERS == {"lambert": 3, "one-lobe": 4}


def test_evidence_is_the_information_criterion():
    """n log(R / n + floor^2) + p log n, worked out: 10 log(.1) + 3 log 10 = -7 log 10, and 4 log(e^2) + 3 log 4."""
    assert evidence(f32(10), f32(10 * (0.1 - FLOOR**2)), 3) == pytest.approx(-7 * np.log(10), rel=1e-6)
    assert evidence(f32(4), f32(4 * (E**2 - FLOOR**2)), 3) == pytest.approx(8 + 3 * np.log(4), rel=1e-6)


def test_evidence_adds_over_texels():
    n, r = f32(10, 4, 7), f32(0.02, 0.5, 0.001)
    single = [evidence(n[i:i + 1], r[i:i + 1], 4) for i in range(3)]
    assert evidence(n, r, 4) == pytest.approx(sum(single), rel=1e-12)


def test_a_texel_without_observations_adds_only_the_floor():
    assert evidence(f32(0), f32(0), 4) == pytest.approx(np.log(FLOOR**2))


@pytest.mark.parametrize(("ratio", "model"), [(1.0, "lambert"), (1.2, "lambert"), (1.3, "one-lobe"), (50, "one-lobe")])
def test_the_lobe_must_pay_for_its_parameter(ratio, model):
    """With n = 10 the extra parameter costs log 10 = 2.30; it pays where 10 log(ratio) is more: ratio > 1.259."""
    residual = f32(*[10 * 0.01] * 5)
    lambert = (residual + 10 * FLOOR**2) * ratio - 10 * FLOOR**2
    assert choose(f32(*[10] * 5), residual, lambert.astype(np.float32))[0] == model


def test_below_the_floor_a_better_fit_is_no_evidence():
    """Errors of 0.01 % against 0.1 %, both under the forward model's own 0.3 %: 20 log(1.11) = 2.1 < log 20 = 3.0."""
    n = np.full(100, 20, np.float32)
    assert choose(n, n * 1e-4**2, n * 1e-3**2)[0] == "lambert"


def test_a_few_texels_with_a_highlight_decide_for_the_material():
    """Most texels never see a highlight and lose log n each by the lobe; the few that do gain far more."""
    n = np.full(100, 12, np.float32)
    lobe = n * 0.01**2
    lambert = lobe.copy()
    lambert[:5] = 12 * 0.2**2
    assert choose(n, lobe, lambert)[0] == "one-lobe"
    lambert[1:5] = lobe[1:5]
    assert choose(n, lobe, lambert)[0] == "lambert"


def test_texels_with_too_few_observations_say_nothing():
    good, few = f32(*[10] * 5), f32(*[2.9] * 200)
    residual, lambert = f32(*[0.1] * 5), f32(*[0.1] * 5)
    many_residual, many_lambert = np.full(200, 1e-4, np.float32), np.full(200, 5.0, np.float32)
    name, why = choose(np.concatenate([good, few]), np.concatenate([residual, many_residual]),
                       np.concatenate([lambert, many_lambert]))
    assert name == "lambert"
    assert "(5 texels)" in why
    assert choose(few, many_residual, many_lambert) == (
        "lambert", "no texel has three good observations: too few to tell a lobe from none")


def test_the_reason_tells_the_gain_of_a_texel():
    """10 log(.01 / .04) + log 10 = -13.86 + 2.30 = -11.6 a texel."""
    n = np.full(8, 10, np.float32)
    name, why = choose(n, n * np.float32(0.01 - FLOOR**2), n * np.float32(0.04 - FLOOR**2))
    assert name == "one-lobe"
    assert "-11.6 a texel (8 texels)" in why
