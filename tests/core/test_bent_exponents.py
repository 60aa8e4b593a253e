"""When an exponent between light and brightness says that files are not linear."""

from __future__ import annotations

import pytest

from irpso_addon.core.check_records import Checks, Residual, Slope, ViewCheck
from irpso_addon.core.checks.warnings import warnings


def checks(exponent: float, misfit: bool) -> Checks:
    """Of one view whose brightness follows light to a power."""
    slope = Slope(exponent, 0.001)
    view = ViewCheck("a.exr", "Cam", ("Key",), 0.0, Residual(900, 1.0, 0.002, 0.002, 0.002, 0.003, None, 0), slope)
    return Checks(
        name="Cup", views=(view,), lights=(), materials=(), noise=0.01, structure=0.002, highlight=0.0,
        slope=slope, unlit_share=float("nan"), clipped=0.0, no_highlight=0.0, nearest=1.0, doubtful=0.0, sure=True,
        pixels_per_texel=1.0, misfit=misfit)


@pytest.mark.parametrize(("exponent", "misfit", "told"), [
    (1.1, False, True),  # the model is the material's: the files are to blame
    (1.1, True, False),  # real diffuse reflection bends brightness as much
    (0.45, True, True),  # a display curve, which no material bends so
    (2.2, True, True),
    (1.0, False, False),
])
def test_a_bent_exponent_is_proof_only_where_the_model_fits(exponent: float, misfit: bool, told: bool) -> None:
    found = [line for line in warnings(checks(exponent, misfit)) if "brightness follows light" in line]
    assert bool(found) == told
