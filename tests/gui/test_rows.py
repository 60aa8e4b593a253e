"""What the panel says and its buttons do, where a window is needed to see it."""

from __future__ import annotations


def test_the_panel(blender, ball, folder):
    told = blender.run("rows:panel", folder, scene=str(ball), limit=240).told
    assert (told["perspective"], told["back"]) == ("CAMERA", "PERSP")
    assert told["windows"] == 0, "it opens a window beside the UV editor"


def test_file_browsers_begin_where_the_files_are(blender, ball, folder):
    told = blender.run("rows:browsers", folder, scene=str(ball), clicks=False, limit=400).told
    assert told["captures"] == [told["home"], "*.json"]
    assert told["export"][0] == str(folder / "maps") and told["made"]
    assert not told["left"], "an empty folder stays"


def test_a_window_is_closed_while_a_solve_runs(blender, ball, folder):
    told = blender.run("rows:closed", folder, scene=str(ball), clicks=False, limit=240).told
    assert (told["windows"], told["running"], told["again"]) == (1, False, True)
