"""When an exponent between light and brightness says that files are not linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.check_records import Checks, Residual, Slope, ViewCheck
from irpso_addon.core.checks.remedies import remedies
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
    found = [line for line in warnings(checks(exponent, misfit)) if "non-linear" in line]
    assert bool(found) == told
    assert all(line.endswith(f"multiply the views' Response by {exponent:.2f}") for line in found)


@pytest.mark.parametrize(("exponent", "structure", "told"), [
    (1.32, 0.01, True),
    (1.32, 0.07, False),  # a varnished board, whose pictures are linear
    (1.44, 0.2, False),
    (1.58, 0.13, False),  # glitter under a flash, whose pictures are linear
    (1.85, 0.2, True),  # no material that was seen bends so
    (0.52, 0.2, True),
    (0.45, 0.2, True),
])
def test_the_more_a_model_lacks_the_more_it_may_bend(exponent: float, structure: float, told: bool) -> None:
    lines = warnings(replace(checks(exponent, misfit=True), structure=structure))
    assert any("look non-linear" in line for line in lines) == told


def test_no_line_recommends_raw_files_to_who_has_them():
    """Nor another response or colour space: a RAW file is linear, so the cause is another."""
    encoded = checks(0.45, misfit=False)
    raw = replace(encoded, views=tuple(replace(view, view="a.NEF") for view in encoded.views))
    (line,), (other,) = warnings(raw), warnings(encoded)
    assert line.startswith("all views: look non-linear (exponent 0.45); RAW files are linear, so either other light")
    assert "Response" not in line and "Response" in other
    assert not remedies(raw) and [found.kind for found in remedies(encoded)] == ["colorspace"]


@pytest.mark.parametrize(("exponent", "around", "tried", "not_bounced", "bounced"), [
    (0.97, True, (), "", True),  # nothing has looked for light that bounces under a world
    (0.97, True, ("indirect",), "", False),  # it was subtracted
    (0.97, True, (), "light that bounces is 0.1 % of the direct light", False),  # a solve has looked: there is none
    (0.97, False, (), "", False),  # under lamps shadows tell
    (0.85, True, (), "", False),  # no bounced light bends brightness so much ...
    (1.03, True, (), "", False),  # ... or makes lit places brighter than dark ones
])
def test_under_a_world_bounced_light_is_named_before_a_tone_curve(
    exponent: float, around: bool, tried: tuple[str, ...], not_bounced: str, bounced: bool,
) -> None:
    (line,) = warnings(replace(checks(exponent, misfit=False), around=around, not_bounced=not_bounced), tried)
    assert ("set Indirect Light to On" in line) == bounced
    assert ("look non-linear" in line) != bounced


def of_views(exponents: list[float]) -> Checks:
    """Of views whose brightness follows light each to a power of its own."""
    one = checks(1.0, misfit=False)
    (view,) = one.views
    return replace(one, views=tuple(
        replace(view, view=f"{i}.exr", slope=Slope(exponent, 0.001)) for i, exponent in enumerate(exponents)))


def test_a_view_is_blamed_only_where_it_stands_out() -> None:
    """One encoded picture among linear ones is named; the ends of a wide scatter are not."""
    rng = np.random.default_rng(0)
    encoded = warnings(of_views([*(1 + 0.01 * rng.normal(size=11)), 0.45]))
    assert len(encoded) == 1 and encoded[0].startswith("'11.exr': looks non-linear (exponent 0.45)")
    assert warnings(of_views([*(1 + 0.08 * rng.normal(size=30)), 0.71, 1.3])) == ()


def test_a_view_stands_out_from_the_others_and_not_from_1() -> None:
    """Cloth with sheen under 56 suns, rendered by Cycles: exponents of 0.57 to 1.03 with a scale of 0.1, and 0.36."""
    most = list(0.776 + 0.1007 * np.random.default_rng(2).normal(size=55).clip(-2.05, 2.55))
    made = replace(of_views([*most, 0.359]), misfit=True, structure=0.099)
    assert not any("non-linear" in line for line in warnings(made))
    alike = [0.776 + 0.3 * (exponent - 0.776) for exponent in most]
    (line,) = (line for line in warnings(replace(made, views=of_views([*alike, 0.359]).views)) if "non-linear" in line)
    assert line.startswith("'55.exr': looks non-linear (exponent 0.36)")


def test_structure_in_all_views_excuses_a_single_bent_one() -> None:
    """A photographed figure: 7 % of structure, exponents of .71 to 1.08 with a scale of .04."""
    rng = np.random.default_rng(1)
    views = of_views([*(0.96 + 0.04 * rng.normal(size=60)), 0.71, 0.75, 0.76])
    assert any("non-linear" in line for line in warnings(views))
    assert not any("non-linear" in line for line in warnings(replace(views, structure=0.07)))
    encoded = replace(of_views([*(0.96 + 0.04 * rng.normal(size=60)), 0.45]), structure=0.07)
    assert any("'60.exr': looks non-linear" in line for line in warnings(encoded))
