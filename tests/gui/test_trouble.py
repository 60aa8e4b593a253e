"""What people do while a job runs: nothing crashes, nothing is lost, nothing is left behind."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize("what", ["load", "undo", "delete", "render", "no_opengl", "close"])
def test_while_it_runs(blender, ball, folder, what):
    run = blender.run(f"trouble:{what}", folder, scene=str(ball), size=512)
    assert "stopped before there was a result" not in run.log, "nobody stopped it"
