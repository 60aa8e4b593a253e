"""Which changes of the scene are offered for which findings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from irpso_addon.core.check_records import Checks, LightResidual, MaterialCheck, Misfit, Residual, Slope, ViewCheck
from irpso_addon.core.checks.remedies import Remedy, remedies
from irpso_addon.core.checks.warnings import warnings

SUN = LightResidual("Sun", 3, 1.0, 0.002, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)


def view(name: str, light: str, gain: float = 1.0) -> ViewCheck:
    residual = Residual(900, gain, 0.002, 0.002, 0.002, 0.003, None, 0)
    return ViewCheck(name, "Cam", (light,), 0.0, residual, Slope(1.0, 0.001))


def checks(**changed: object) -> Checks:
    """Of six views under three lights, all of them right."""
    lights = tuple(replace(SUN, name=f"Lamp {i}") for i in range(6))
    views = tuple(view(f"{i}.exr", f"Lamp {i}") for i in range(6))
    made = Checks(
        name="Cup", views=views, lights=lights, materials=(), noise=0.01, structure=0.002, highlight=0.0,
        slope=Slope(1.0, 0.001), unlit_share=float("nan"), clipped=0.0, no_highlight=0.0, nearest=1.0, doubtful=0.0,
        sure=True, pixels_per_texel=1.0)
    return replace(made, **changed)


def with_light(**changed: object) -> Checks:
    lights = checks().lights
    return checks(lights=(replace(lights[0], **changed), *lights[1:]))


def test_where_all_is_well_nothing_is_offered() -> None:
    assert warnings(checks()) == () and remedies(checks()) == ()


def test_a_lamp_of_another_power() -> None:
    found = with_light(gain=1.2)
    assert "brighter" in warnings(found)[0]
    assert remedies(found) == (Remedy("Multiply Power of 'Lamp 0' by 1.200", "power", "Lamp 0", 1.2),)


def test_a_lamp_that_stands_elsewhere() -> None:
    found = with_light(offset=(0.3, 0.0, -0.4), offset_share=0.2, effect=0.1, explained=0.9)
    assert "(+0.3, +0, -0.4)" in warnings(found)[0]
    (remedy,) = remedies(found)
    assert (remedy.kind, remedy.target, remedy.offset) == ("move", "Lamp 0", (0.3, 0.0, -0.4))
    assert remedy.label == "Move 'Lamp 0' by 0.5 m"


@pytest.mark.parametrize(("exponent", "space"), [(0.45, "sRGB"), (2.2, "Linear Rec.709"), (1.3, None)])
def test_a_curve_in_all_views(exponent: float, space: str | None) -> None:
    """Where the exponent is that of sRGB read wrongly, its color space is offered, and nothing else."""
    views = tuple(replace(v, slope=Slope(exponent, 0.001)) for v in checks().views)
    found = remedies(replace(with_light(gain=1.2), slope=Slope(exponent, 0.001), views=views))
    assert [remedy.value for remedy in found] == ([space] if space else [])


def test_a_camera_that_is_off_and_exposures_that_drift() -> None:
    off = Misfit(Path("0.exr"), "Cam", (100, 100), (1.5, 0.0), 0.01, 1.0, 0.001, False)
    (remedy,) = remedies(checks(registration=(off,)))
    assert (remedy.kind, remedy.target, remedy.value) == ("setting", "registration", "auto")
    drifting = tuple(view(f"{i}.exr", f"Lamp {i}", 1.08 if i % 2 else 0.93) for i in range(6))
    (remedy,) = remedies(checks(views=drifting))
    assert (remedy.kind, remedy.target, remedy.value) == ("setting", "exposures", "solve")


def test_no_line_recommends_what_the_solve_has_done() -> None:
    off = Misfit(Path("0.exr"), "Cam", (100, 100), (1.5, 0.0), 0.01, 1.0, 0.001, False)
    drifting = tuple(view(f"{i}.exr", f"Lamp {i}", 1.08 if i % 2 else 0.93) for i in range(6))
    for found, setting, words in ((checks(registration=(off,)), "registration", "or set Camera Alignment to Auto"),
                                  (checks(views=drifting), "exposures", "or set Exposures to Solve")):
        assert words in warnings(found)[0]
        (line,) = warnings(found, tried=(setting,))
        assert words not in line and "; check " in line


def test_a_sun_is_turned() -> None:
    found = with_light(offset=(0.03, 0.0, -0.04), offset_share=0.05, effect=0.1, explained=0.9, sun=True)
    (line,) = warnings(found)
    assert "it appears turned by 2.9 degrees from where the scene has it; check its direction and angle" in line
    (remedy,) = remedies(found)
    assert remedy == Remedy("Turn 'Lamp 0' by 2.9 Degrees", "move", "Lamp 0", offset=(0.03, 0.0, -0.04))


def test_no_line_recommends_indirect_light_or_a_model_that_the_solve_had() -> None:
    dark = checks(unlit_share=0.2)
    assert "; set Indirect Light to On" in warnings(dark)[0]
    (line,) = warnings(dark, tried=("indirect",))
    assert "set Indirect Light" not in line and "subtracted" in line and "; subtract the camera's black level" in line
    shiny = checks(highlight=0.2)
    assert "set Model to Roughness + Specular or Two Roughnesses" in warnings(shiny)[0]
    had = replace(shiny, materials=(MaterialCheck("Glaze", "two-lobe", 40.0, 12.0, 0.0),))
    assert warnings(had)[0].endswith("; check the lights' sizes, or set Model to Roughness + Specular")
    assert warnings(had, tried=("model",))[0].endswith("; check the lights' sizes and the mesh's normals")


def test_where_one_roughness_was_taken_the_line_says_so() -> None:
    alike = MaterialCheck("Glaze", "one-lobe-specular", 40.0, 3.0, 0.0, one_value=True)
    (line,) = warnings(replace(checks(highlight=0.24), materials=(alike,)), tried=("model",))
    assert line.endswith(
        "highlights are off by 24 % of their brightness, and IRPSO took one roughness for 'Glaze'; if it differs from "
        "place to place, set Model to Roughness + Specular, else check the lights' sizes and the mesh's normals")
