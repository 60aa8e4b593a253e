"""The whole job by real clicks, in a real window."""

from __future__ import annotations


def test_from_panel_to_maps(blender, ball, folder):
    done = blender.run("jobs:whole", folder, scene=str(ball), size=128)
    assert done.told["maps"]["solved"] > 0
