"""The panel Corrections and its button."""

from __future__ import annotations


def test_apply_to_scene(blender, ball, folder):
    blender.run("put_right:applied", folder, scene=str(ball), size=64)
