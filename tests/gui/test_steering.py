"""A part is marked and solved in a real window; the rest of the result stays."""

from __future__ import annotations

import pytest

ROUGH = 0.45  # of the ball, as in tests/support/make_scenes.py


def test_a_part(blender, ball, folder):
    told = blender.run("steering:part", folder, scene=str(ball), size=64).told
    assert told["texels"]["kept"] > 100 and told["texels"]["solved"] > 300
    assert 0.15 < told["kept"] < 0.6
    assert told["new"] == pytest.approx(ROUGH, abs=0.02)
