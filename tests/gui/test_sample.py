"""The sample scene: three clicks to maps."""

from __future__ import annotations

SECONDS = 30  # on two cores that have nothing else to do


def test_three_clicks(blender, folder):
    told = blender.run("sample:three_clicks", folder, screen_size=(1600, 900)).told
    assert told["texels"]["solved"] > 0.9 * told["texels"]["covered"] - told["texels"]["filled"]
    assert told["opening"] + told["solving"] < SECONDS
