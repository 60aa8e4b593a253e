"""When views that are brighter than the maps say speak of exposures, and when of a material that is not its model."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.check_records import Checks, Residual, ViewCheck
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


def test_a_mirror_does_not_look_like_exposures_that_drift() -> None:
    """Crumpled foil under 18 suns, whose radiance no model predicts; and a camera that chooses each exposure itself."""
    gains = list(np.random.default_rng(0).uniform(0.35, 0.96, 18))
    assert any("drifts" in line for line in told(checks(gains, 0.05, misfit=False)))
    assert not told(checks(gains, 1.2, misfit=True))
