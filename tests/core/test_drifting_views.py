"""When views that are not what the maps say speak of exposures or lights, and when of a material that is no model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.check_records import Checks, LightResidual, Residual, ViewCheck
from irpso_addon.core.checks.warnings import warnings


def checks(gains: list[float], structure: float, misfit: bool) -> Checks:
    """Of views with these gains, which are known to 0.1 %."""
    views = tuple(ViewCheck(f"{i}.exr", "Cam", (f"Sun {i}",), 0.0, Residual(
        900, gain, 0.001, 0.02, 0.02, structure, None, 0), None) for i, gain in enumerate(gains))
    return Checks(
        name="Cup", views=views, lights=(), materials=(), noise=0.05, structure=structure, highlight=0.0, slope=None,
        unlit_share=float("nan"), clipped=0.0, no_highlight=0.0, nearest=1.0, doubtful=0.0, sure=True,
        pixels_per_texel=1.0, misfit=misfit)


def told(made: Checks) -> list[str]:
    return [line for line in warnings(made) if "exposure" in line]


@pytest.mark.parametrize(("gain", "structure", "misfit", "named"), [
    (0.984, 0.0115, False, True),  # the model is the material's: the exposure is to blame
    (0.984, 0.0115, True, False),  # robes of several paints whose highlights no model has, right exposures
    (0.9, 0.0115, True, True),  # no material does that
    (0.9, 0.1, True, False),  # one that leaves so much everywhere does
])
def test_a_view_is_named_where_no_misfit_makes_it_so(gain: float, structure: float, misfit: bool, named: bool) -> None:
    (*lines,) = told(checks([*np.linspace(0.997, 1.003, 17), gain], structure, misfit))
    assert bool(lines) == named and all(line.startswith("'17.exr': brighter or darker") for line in lines)


@pytest.mark.parametrize(("noise", "named"), [(0.02, True), (0.2068, False)])
def test_noise_whose_median_is_not_its_mean_is_no_exposure(noise: float, named: bool) -> None:
    """A right picture of few samples, under an HDRI with a small lamp: its noise, and its median 3 % below the mean."""
    made = checks([*np.linspace(0.997, 1.003, 17), 0.9704], 0.0, misfit=False)
    *others, last = made.views
    noisy = replace(last, residual=replace(last.residual, noise=noise))
    assert bool(told(replace(made, views=(*others, noisy)))) == named


def test_a_mirror_does_not_look_like_exposures_that_drift() -> None:
    """Crumpled foil under 18 suns, whose radiance no model predicts; and a camera that chooses each exposure itself."""
    gains = list(np.random.default_rng(0).uniform(0.35, 0.96, 18))
    assert any("drifts" in line for line in told(checks(gains, 0.05, misfit=False)))
    assert not told(checks(gains, 1.2, misfit=True))


@pytest.mark.parametrize(("misfit", "own", "named"), [
    (True, [0.968, 1.39, 1.1, 0.981], False),  # what neighbours of the very view have in common explains it
    (True, [0.286] * 4, True),  # no more than in the others: the exposures are to blame
    (False, [0.968, 1.39, 1.1, 0.981], True),
])
def test_a_view_that_lacks_more_than_most_is_not_blamed(misfit: bool, own: list[float], named: bool) -> None:
    """Crinkled foil under 35 suns from Cycles: facets miss highlights of the four suns nearest to the camera."""
    made = checks([*np.linspace(0.76, 0.93, 31), 0.274, 0.361, 0.483, 0.582], 0.286, misfit)
    near = tuple(replace(view, residual=replace(view.residual, structure=structure))
                 for view, structure in zip(made.views[-4:], own, strict=True))
    assert bool(told(replace(made, views=made.views[:-4] + near))) == named


# Of 22 right lamps around a board with straight grain, whose highlights no model has; rendered by Cycles.
BOARD = [0.096, 0.089, 0.078, 0.076, 0.071, 0.058, 0.053, 0.052, 0.051, 0.048, 0.045, 0.044, 0.043, 0.035, 0.029, 0.027,
         0.018, 0.018, 0.013, 0.008, 0.005, 0.004]


@pytest.mark.parametrize(("effects", "misfit", "named"), [
    (BOARD, True, 0),  # all lamps seem to stand elsewhere
    ([0.3, *BOARD[1:]], True, 1),  # one stands out
    ([0.096, *[0.012] * 21], True, 1),
    (BOARD, False, 3),  # the model is the material's: the lamps are to blame
])
def test_a_light_is_named_where_no_misfit_makes_it_so(effects: list[float], misfit: bool, named: int) -> None:
    lights = tuple(
        LightResidual(f"Lamp {i}", 1, 1.0, float("nan"), (0.1, 0.0, 0.0), 0.2, effect, 0.9 if i < 9 else 0.2)
        for i, effect in enumerate(effects))
    lines = [line for line in warnings(replace(checks([1.0] * 22, 0.0355, misfit), lights=lights)) if "appears" in line]
    assert len(lines) == named and all(line.startswith(f"light 'Lamp {i}': ") for i, line in enumerate(lines))
