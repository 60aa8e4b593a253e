"""Results outlive the session, come back by a click, and are seen."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from PIL import Image


def test_tomorrow_and_back(blender, ball, folder):
    told = blender.run("results:tomorrow", folder, scene=str(ball), size=96, limit=600).told
    assert told["changed"] and told["back"] and "Diffuse Only" in told["label"]
    for run in told["told"]:
        assert all(a[0] <= b[0] for a, b in pairwise(run)), "progress goes back"
        left = [seconds for _, seconds in run if seconds is not None]
        assert all(a >= b for a, b in pairwise(left)), "the time left rises"


@pytest.mark.parametrize(("color", "size"), [("TEXTURE", 1024), ("MATERIAL", 512)])
def test_the_viewport_goes_on_as_the_solve_does(blender, ball, folder, color, size):
    """Texture shading shows the last maps before the end; plain Solid says that it shows none."""
    run = blender.run("results:shadings", folder, scene=str(ball), size=size, shading="SOLID", color=color, limit=400)
    before, first, late, end = (picture(run.shot(name)) for name in ("before", "first", "late", "end"))
    if color == "MATERIAL":
        return
    assert np.abs(first - before).mean() > 1, "nothing was shown"
    assert np.abs(late - end).mean() < 0.8 * np.abs(first - end).mean(), "it stands at the first look"


def picture(path):
    """The part of the window that shows the ball."""
    return np.asarray(Image.open(path).convert("RGB"), float)[150:600, 270:700]


def test_memory_comes_back_after_each_solve(blender, ball, folder):
    """Of five solves, undo steps and the results that are remembered are all that stays."""
    run = blender.run("results:memory", folder, scene=str(ball), size=256, solves=5, clicks=False, limit=600)
    held = run.told["held"]
    assert max(held[1:]) - held[0] < 0.3, held


def test_the_copy_is_saved_in_a_moment(blender, ball, folder):
    told = blender.run("results:copying", folder, scene=str(ball), clicks=False, limit=240).told
    assert told["seconds"] < 0.5 and told["preview"] == "AUTO"
