"""Grey patches: figures of made squares, the scale by Lambert's law, the response by the chart's greys."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.response import curved, straight
from irpso_addon.core.shoot.grey_patch import (
    CHART_GREYS,
    UnevenPatch,
    UnusablePatch,
    Verdict,
    chart_curve,
    chart_response,
    chart_scale,
    chart_squares,
    measure_patch,
    patch_scale,
)


def square(value: float, noise: float = 0.01, slope: float = 0.0, seed: int = 0) -> np.ndarray:
    """(20, 30, 3), falling by ``slope`` from left to right, relative."""
    random = np.random.default_rng(seed)
    fall = 1 + slope * (np.arange(30) / 29 - 0.5)
    return value * fall[None, :, None] * (1 + random.normal(0, noise, (20, 30, 3))) * (1.0, 0.9, 0.8)


def chart(power: float = 1.0, scale: float = 0.8, noise: float = 0.01) -> np.ndarray:
    patches = [measure_patch(square(scale * rho ** power, noise, seed=k)) for k, rho in enumerate(CHART_GREYS)]
    return np.array([patch.mean.mean() for patch in patches])


def test_chart_greys_are_those_of_the_maker():
    """From L* of the published table (D50), by CIE 15: Y = ((L* + 16) / 116)^3."""
    lightness = np.array([96.539, 81.257, 66.766, 50.867, 35.656, 20.461])
    assert np.allclose(((lightness + 16) / 116) ** 3, CHART_GREYS, atol=6e-5)


def test_figures_of_a_patch():
    patch = measure_patch(square(0.4, noise=0.02, slope=0.1))
    assert np.allclose(patch.mean, 0.4 * np.array([1, 0.9, 0.8]), rtol=0.005)
    assert patch.unevenness == pytest.approx(0.1, abs=0.01)
    # Of the mean of three channels whose noise is independent.
    assert patch.spread == pytest.approx(0.02 * np.sqrt(1 + 0.81 + 0.64) / 2.7, rel=0.1)
    assert patch.clipped == 0


def test_scale_by_a_lamp_overhead():
    """A point lamp of 100 W, 2 m straight above: E = P / (4 pi d^2) W/m^2, the picture is 3 times as bright."""
    irradiance = np.full(3, 100 / (4 * np.pi * 4))
    radiance = 0.36 * irradiance / np.pi
    patch = measure_patch(np.broadcast_to(3 * radiance, (10, 10, 3)), clip=np.inf)
    assert np.allclose(patch_scale(patch, 0.36, irradiance), 3)


@pytest.mark.parametrize(("values", "message"), [
    (np.clip(square(1.1), 0, 1), r"^card: 9\d % of the patch is clipped|^card: 100 % of the patch is clipped"),
    (square(0.0), "the patch is black"),
    (square(np.nan), "pixels without a value"),
    (square(0.5)[:2, :3], "fewer than 16 pixels"),
    (np.concatenate([square(0.5), square(0.1)]), "more than one patch"),
])
def test_patches_that_are_refused(values, message):
    with pytest.raises(BadInput, match=message):
        measure_patch(values, name="card")


@pytest.mark.parametrize("beside", [0.05, 0.09, 0.3, 0.9])
@pytest.mark.parametrize("part", [0.1, 0.2, 0.5])
@pytest.mark.parametrize("turn", [0.0, 0.6])
def test_a_square_over_an_edge_is_refused(beside, part, turn):
    """A tenth of it, or more, is not the grey of 0.18: the mean would be off by up to 5 times."""
    y, x = np.mgrid[:20, :20]
    along = x * np.cos(turn) + y * np.sin(turn)
    values = np.where(along < np.quantile(along, part), beside, 0.18)[..., None]
    values = values * (1 + np.random.default_rng(0).normal(0, 0.03, (20, 20, 3)))
    with pytest.raises(BadInput, match="shows more than one patch, or a shine"):
        measure_patch(values)


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.2])
@pytest.mark.parametrize("side", [4, 9, 20, 61])
@pytest.mark.parametrize("beside", [0.0, 1.0])
def test_light_that_falls_off_is_no_edge(noise, side, beside):
    """A bare lamp six times the square's side away, straight above or beside: E goes with cos / d^2.  For any noise."""
    y, x = (np.mgrid[:side, :side] + 0.5) / side - 0.5
    fall = 6.0 / ((x + 6.0 * beside) ** 2 + y ** 2 + 36.0) ** 1.5
    for seed in range(20):
        values = 0.2 * fall[..., None] * (1 + np.random.default_rng(seed).normal(0, noise, (side, side, 3)))
        measure_patch(values)


def test_scale_needs_light_and_a_reflectance():
    patch = measure_patch(square(0.4))
    for reflectance, value in ((0.0, 1.0), (1.5, 1.0), (0.2, 0.0), (0.2, np.nan)):
        with pytest.raises(BadInput):
            patch_scale(patch, reflectance, np.full(3, value))


def test_what_one_patch_spoils():
    """Clipped or black: other patches of a chart may do.  More than one patch in the square: the click may be wrong."""
    for values, kind in ((np.clip(square(1.1), 0, 1), UnusablePatch), (square(-0.01), UnusablePatch),
                         (np.concatenate([square(0.5), square(0.1)]), UnevenPatch)):
        with pytest.raises(BadInput) as caught:
            measure_patch(values)
        assert type(caught.value) is kind


@pytest.mark.parametrize(("power", "verdict", "words"), [
    (1.0, Verdict.LINEAR, "These pictures are linear: exponent 1.00 ± 0.01"),
    (1.015, Verdict.LINEAR, "These pictures are linear: exponent 1.0"),
    (0.95, Verdict.NEARLY, "These pictures are nearly linear: exponent 0.95 ± 0.01. Keep"),
    (0.58, Verdict.CURVED, "These pictures look non-linear (exponent 0.58). Use RAW files, or set the colour space of "
                           "all views to sRGB."),
    (2.2, Verdict.CURVED, "These pictures look non-linear (exponent 2.20). Use RAW files."),
])
def test_response(power, verdict, words):
    found = chart_response(chart(power))
    assert found.exponent == pytest.approx(power, abs=0.003)
    assert abs(found.exponent - power) < 4 * found.standard_error + 1e-4
    assert found.scale == pytest.approx(0.8 * 0.9, rel=0.01)
    assert found.verdict is verdict
    line = found.summary("IMG_1.exr", decoded=False)
    assert line.startswith(words) and "\n" not in line


def test_a_curve_that_is_not_srgb():
    line = chart_response(chart(1.4)).summary("IMG_1.jpg", decoded=True)
    assert line == "These pictures look non-linear (exponent 1.40): the curve of IMG_1.jpg is not sRGB. Use RAW files."


@pytest.mark.parametrize("exposure", [0.3, 1.0, 1.5])
@pytest.mark.parametrize(("response", "shoulder"), [(1.0, 1.0), (1.1, 5.0), (1.6, 9.0), (0.8, 2.0)])
def test_the_curve_of_a_chart(response, shoulder, exposure):
    """Its numbers come back to 2 %, whatever the exposure, under light that falls off along the chart."""
    light = np.linspace(1.2, 0.8, len(CHART_GREYS))
    radiance = exposure * np.array(CHART_GREYS) * light
    seen = radiance < 1  # the others are clipped
    found = chart_curve(curved(radiance[seen], response, shoulder), (np.array(CHART_GREYS) * light)[seen])
    if seen.sum() < 5:
        assert found is None
        return
    assert found.residual < 0.01
    assert found.response == pytest.approx(response, rel=0.02) and found.shoulder == pytest.approx(shoulder, rel=0.05)


def test_curves_that_are_not_of_its_kind():
    """A film curve by Narkowicz's fit of ACES is followed to a few per cent; greys in disorder are not."""
    x = 0.8 * np.array(CHART_GREYS)
    film = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    found = chart_curve(film, np.array(CHART_GREYS))
    assert found.shoulder > 3 and found.residual < 0.05
    again = curved(straight(film, found.response, found.shoulder), found.response, found.shoulder)
    assert again == pytest.approx(film, rel=1e-6)
    assert chart_curve(film[[0, 2, 1, 4, 3, 5]], np.array(CHART_GREYS)) is None
    line = chart_response(chart(1.4)).summary("IMG_1.jpg", decoded=True, curve=found)
    assert line.endswith(f"the curve of IMG_1.jpg is not sRGB. Response {found.response:.2f} and Shoulder "
                         f"{found.shoulder:.2g} fit its greys to {100 * found.residual:.1f} % and are now set for all "
                         "views; RAW files need neither.")


def test_stray_light_is_no_curve():
    """Half a per cent of white on every patch."""
    assert chart_response(np.array(CHART_GREYS) + 0.005).verdict is Verdict.NEARLY


def test_standard_error_of_the_exponent():
    """Charts whose patches are lit unevenly by 3 %: over 300 of them the exponents scatter as is said."""
    random = np.random.default_rng(3)
    found = [chart_response(np.array(CHART_GREYS) * np.exp(random.normal(0, 0.03, 6))) for _ in range(300)]
    assert np.sqrt(np.mean([one.standard_error ** 2 for one in found])) == pytest.approx(
        np.std([one.exponent for one in found]), rel=0.1)


def test_a_chart_that_tells_nothing():
    found = chart_response(np.array(CHART_GREYS) * (1, 1.3, 0.8, 1.2, 0.7, 1.1))
    assert found.verdict is Verdict.UNCLEAR
    assert "do not lie on one curve" in found.summary("chart", decoded=False)


def test_charts_that_are_refused():
    with pytest.raises(BadInput, match="only 2 of the greys can be used, and 3 are needed"):
        chart_response(chart()[:2], CHART_GREYS[:2])
    with pytest.raises(BadInput, match="click white first"):
        chart_response(chart()[::-1])


def test_squares_of_a_turned_chart():
    """White at (100, 50), 200 pixels to the right and 150 down to black: 50 pixels apart, so 25 wide."""
    squares = chart_squares((100.0, 50.0), (300.0, 200.0))
    assert np.allclose(squares, [(100 + 40 * k, 50 + 30 * k, 25) for k in range(6)])
    for black in ((120.0, 60.0), (np.nan, 0.0)):
        with pytest.raises(BadInput, match=r"^a\.exr: the white and the black patch are too close"):
            chart_squares((100.0, 50.0), black, "a.exr")


def test_scale_by_least_squares():
    """Independently: the normal equation's solution by numpy."""
    random = np.random.default_rng(1)
    radiances = random.uniform(0.01, 1, (5, 3))
    means = radiances * (2.0, 1.5, 1.0) * random.normal(1, 0.02, (5, 3))
    expected = [np.linalg.lstsq(radiances[:, [c]], means[:, c], rcond=None)[0][0] for c in range(3)]
    assert np.allclose(chart_scale(means, radiances), expected)
