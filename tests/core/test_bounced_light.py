"""Whether indirect light is worth rendering, told by small pictures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from irpso_addon.core.check_records import Checks
from irpso_addon.core.checks.bounced_light import BouncedSample, LightPicture, sampled, why_not
from irpso_addon.core.checks.warnings import warnings

SHOWN = np.arange(40)[:, None].repeat(20, 1) < 30  # three quarters of the picture


def picture(direct: float, indirect: float, shadow: float) -> LightPicture:
    """Radiance where the lamps' light arrives, what has bounced there, and what has in the object's first ten rows."""
    dark = np.arange(40)[:, None].repeat(20, 1) < 10
    floor = np.where(SHOWN, 0, 9)  # what is not the object's does not count
    return LightPicture((np.where(dark, 0, direct) + floor).astype(np.float32),
                        (np.where(dark, shadow, indirect) + floor).astype(np.float32), SHOWN)


def test_shares_of_all_pictures_together() -> None:
    found = sampled([picture(1.0, 0.01, 0.04), picture(1.0, 0.03, 0.08)])
    assert math.isclose(found.share, (0.01 + 0.04 / 2 + 0.03 + 0.08 / 2) / 2, rel_tol=1e-5)
    assert math.isclose(found.unlit, 0.06, rel_tol=1e-5)


def test_without_lamps_or_shadows_nothing_tells() -> None:
    none = sampled([picture(0.0, 0.0, 0.0)])
    assert math.isnan(none.share) and math.isnan(none.unlit) and why_not(none, 0.05) == ""
    lit = LightPicture(np.ones((8, 8), np.float32), np.full((8, 8), 0.1, np.float32), np.ones((8, 8), bool))
    assert math.isnan(sampled([lit]).unlit) and why_not(sampled([lit]), 0.05) == ""


def test_little_light_and_light_of_another_kind_are_left() -> None:
    assert why_not(BouncedSample(0.2, 0.05), 0.05) == ""
    assert "0.2 % of the lamps' light" in why_not(BouncedSample(0.002, 0.05), 0.05)
    assert "only 0.6 % as bright" in why_not(BouncedSample(0.02, 0.006), 0.05)
    assert why_not(BouncedSample(0.02, math.nan), 0.05) == ""
    assert why_not(BouncedSample(0.2, 0.006), 0.05) == ""  # too much to be left, whatever else is there


@pytest.mark.parametrize(("share", "why", "told"), [
    (0.09, "no surface in the scene sends much light to another", True),  # a block of wax: nothing else is in the scene
    (0.09, "", False),  # it may have bounced: that is tried first
    (0.005, "no surface in the scene sends much light to another", False),  # as little as a black level
])
def test_shadows_that_no_surface_lights_may_be_a_translucent_objects(share: float, why: str, told: bool) -> None:
    checks = Checks(
        name="Wax", views=(), lights=(), materials=(), noise=0.01, structure=0.002, highlight=0.0, slope=None,
        unlit_share=share, clipped=0.0, no_highlight=0.0, nearest=1.0, doubtful=0.0, sure=True, pixels_per_texel=1.0,
        not_bounced=why)
    (line,) = warnings(checks)
    assert ("translucent" in line) == told
