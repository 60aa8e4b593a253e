"""What a shoot is told by the mouse in a picture."""

from __future__ import annotations

import pytest


def test_clicks_in_a_picture(blender, ball, folder):
    """Squares and circles are where the mouse went, in pixels of the file from its upper left corner."""
    seen = blender.run("shoot:shoot", folder, scene=str(ball)).told
    assert seen["file"].endswith("refs/Camera 0, Light 2.exr")
    assert seen["square"] == pytest.approx([46, 50, 12], abs=0.5)
    # The lamps had 200 W when the pictures were rendered, and the paint's reflectance is 0.35 in luminance.
    assert all(120 < power < 300 for power in seen["scaled"])
    assert seen["scaled"] == pytest.approx([seen["scaled"][0]] * 5)
    assert seen["undone"] == seen["power"] == [100.0] * 5
    x, y = seen["middle"]
    assert seen["circle"] == pytest.approx([x, y, ((80 - x) ** 2 + (48 - y) ** 2) ** 0.5], abs=0.5)
    assert seen["drawn"] and seen["camera"] == "Camera 1"
    assert seen["after"] == seen["undone"]


def test_clicks_in_a_window_of_its_own(blender, ball, folder):
    """Where no Image Editor is open; closing the window ends the operator, and not Blender."""
    seen = blender.run("shoot:alone", folder, scene=str(ball)).told
    assert seen["square"] == pytest.approx([46, 50, 12], abs=0.5)
    assert seen["windows"] == 1


def test_noise_of_normals_is_taken_out_by_a_click(blender, ball, folder):
    """One undo brings the mesh's own normals back."""
    seen = blender.run("shoot:scan", folder, scene=str(ball)).told
    assert seen["before"] > 1 and seen["after"] == 0
    assert seen["undone"] == pytest.approx(seen["before"], rel=1e-3) and not seen["custom"]
