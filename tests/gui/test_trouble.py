"""What people do while a job runs: nothing crashes, nothing is lost, nothing is left behind."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize("what", ["load", "undo", "delete", "render", "no_opengl", "close"])
def test_while_it_runs(blender, ball, folder, what):
    blender.run(f"trouble:{what}", folder, scene=str(ball), size=512)


def test_one_redo_brings_back_what_one_undo_took(blender, ball, folder):
    states = blender.run("trouble:redo", folder, scene=str(ball), size=2048).told["states"]  # which takes long enough
    assert states == [[0.5, 0], [0.0, 2], [0.0, 0], [0.0, 2], [0.5, 0], [0.0, 2]]


def test_an_error_is_the_last_line(blender, ball, folder):
    """The window shows that one.  Of a solve that leaves nothing it is the only one; it names the object."""
    told = blender.run("trouble:reported", folder, scene=str(ball), size=512, limit=300).told
    assert told["killed"][-1].startswith("the worker process ended (status -9)")
    assert "Ball: stopped; kept" in told["killed"][-2]
    assert len(told["unseen"]) == 1 and "no usable pixel shows 'Ball'" in told["unseen"][0]
