"""The whole job by real clicks, in a real window."""

from __future__ import annotations

import pytest

STOP_SECONDS = 0.2  # from the key or click until Blender is the user's again
BOTH = {"Base Color", "Roughness"}


@pytest.mark.parametrize(("gpu", "shading"), [("opengl", "MATERIAL"), ("vulkan", "RENDERED")])
def test_from_panel_to_maps(blender, ball, folder, gpu, shading):
    told = blender.run("jobs:whole", folder, gpu=gpu, scene=str(ball), size=128, shading=shading).told
    assert told["texels"]["solved"] > 4000
    assert set(told["linked"]) == BOTH
    assert not told["undone"] and set(told["redone"]) == BOTH


def test_stopping_is_at_once_and_keeps_what_was_found(blender, ball, folder):
    told = blender.run("jobs:stopped", folder, scene=str(ball), size=512).told
    assert max(told["stopped"].values()) < STOP_SECONDS


def test_pause(blender, ball, folder):
    blender.run("jobs:paused", folder, scene=str(ball), size=256)
