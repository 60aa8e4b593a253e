"""The figures of Checks, with the limits that docs/report.md states for the warnings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from irpso_addon.core.check_records import Checks, LightResidual, MaterialCheck, Misfit, Slope
from irpso_addon.core.checks.check_figures import CheckFigure, Level, check_figures
from irpso_addon.core.checks.warnings import warnings

LIGHT = LightResidual("Key", 3, 0.9, 0.01, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
FINE = Checks(
    name="Vase", views=(), lights=(replace(LIGHT, name="Rim", gain=1.001), replace(LIGHT, gain=0.999)), materials=(),
    noise=0.01, structure=0.0, highlight=0.0, slope=Slope(1.001, 0.001), unlit_share=0.0, clipped=0.0, no_highlight=0.5,
    nearest=2.0, doubtful=0.0, sure=True, pixels_per_texel=1.0)
MISFIT = Misfit(Path("a.exr"), "Camera 1", (100, 100), (0.03, 0.0), 0.001, 1.0, 0.001, False)


def rows(checks: Checks) -> dict[str, CheckFigure]:
    return {figure.name: figure for figure in check_figures(checks)}


@pytest.mark.parametrize(("name", "field", "limit"), [
    ("Doubtful Roughness", "doubtful", 0.05), ("Clipped", "clipped", 0.01), ("Light in Shadows", "unlit_share", 0.003),
    ("Unexplained", "structure", 0.004), ("Contradicting Views", "contradicted", 0.01)])
def test_a_share_is_good_near_its_limit_or_beyond_it(name: str, field: str, limit: float) -> None:
    for part, level in ((0.0, Level.GOOD), (0.4, Level.GOOD), (0.8, Level.NEAR), (1.2, Level.BEYOND)):
        found = rows(replace(FINE, **{field: part * limit}))[name]
        assert found.level is level
        assert f"(< {100 * limit:.1f})" in found.value


def test_the_noise_hides_what_is_unexplained() -> None:
    """The limit is 0.3 of the noise where that is more than 0.4 %."""
    assert rows(replace(FINE, structure=0.02))["Unexplained"].level is Level.BEYOND
    assert rows(replace(FINE, structure=0.02, noise=0.1))["Unexplained"] == CheckFigure(
        "Unexplained", "2.0 % (< 3.0)", Level.NEAR)


def test_without_a_limit_there_is_no_light() -> None:
    """Noise and highlights alone are no fault; what nothing tells is unknown."""
    found = rows(replace(FINE, unlit_share=float("nan")))
    assert found["Noise"] == CheckFigure("Noise", "1.0 %")
    assert found["No Highlight"] == CheckFigure("No Highlight", "50.0 %")
    assert found["Light in Shadows"] == CheckFigure("Light in Shadows", "unknown")
    assert "Camera Alignment" not in found and "Linearity" not in rows(replace(FINE, slope=None))


def test_what_chance_may_do_is_not_red() -> None:
    """A shift, a lamp and an exponent beyond their limits, certain and not; the worst is named."""
    sure = replace(FINE, lights=(replace(LIGHT, name="Rim", gain=1.001), LIGHT), slope=Slope(0.9, 0.01), registration=(
        MISFIT, replace(MISFIT, camera="Camera 2", shift=(0.3, 0.4), shift_error=0.01)))
    assert {name: figure.level for name, figure in rows(sure).items() if figure.level is Level.BEYOND}.keys() == {
        "Linearity", "Camera Alignment", "Light Power"}
    assert rows(sure)["Camera Alignment"] == CheckFigure(
        "Camera Alignment", "0.50 px (< 0.1)", Level.BEYOND, "Camera 2")
    assert rows(sure)["Light Power"] == CheckFigure("Light Power", "-10.0 % (± 1.5)", Level.BEYOND, "Key")
    doubtful = replace(sure, lights=(replace(LIGHT, gain_error=0.05),), slope=Slope(0.9, 0.1), registration=(
        replace(MISFIT, shift=(0.3, 0.4), shift_error=1.0),))
    assert {rows(doubtful)[name].level for name in ("Linearity", "Camera Alignment", "Light Power")} == {Level.NEAR}


@pytest.mark.parametrize(("around", "known", "advice"), [
    (False, 0.05, "take more views"), (True, 0.5, "take more views"), (True, 0.05, "add a lamp")])
def test_light_that_shows_no_roughness_asks_for_a_lamp(around: bool, known: float, advice: str) -> None:
    """Where all light comes from all around and most texels are unsure, further views show as little."""
    few = MaterialCheck("Clay", "one-lobe", 4.0, 3.0, 0.9)
    lines = warnings(replace(FINE, around=around, known=known, materials=(few,)))
    assert len(lines) == 1 + (advice == "add a lamp")
    assert all(advice in line for line in lines)
    assert ("confidence is below one half on 95 % of its solved texels" in lines[-1]) == (advice == "add a lamp")
