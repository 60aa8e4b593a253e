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


def test_large_maps_go_on_where_they_were_stopped(blender, ball, folder):
    told = blender.run("jobs:large", folder, scene=str(ball), size=96).told
    assert "plan.npz" in told["kept"] and not told["before"]
    assert (told["source"], told["tiles"]) == ("TILED", [1001, 1002])
    assert {"Ball_basecolor.1001.exr", "Ball_roughness.1002.exr"} <= set(told["files"])
    assert not any(name.startswith((".irpso", "irpso_work")) for name in told["files"])


def test_pause(blender, ball, folder):
    blender.run("jobs:paused", folder, scene=str(ball), size=256)
