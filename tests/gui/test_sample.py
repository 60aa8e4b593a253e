"""The sample scene: three clicks to maps.  How long that takes: `python -m tests.gui.stalls`."""

from __future__ import annotations


def test_three_clicks(blender, folder):
    told = blender.run("sample:three_clicks", folder, screen_size=(1600, 900)).told
    assert told["texels"]["solved"] > 0.9 * told["texels"]["covered"] - told["texels"]["filled"]
