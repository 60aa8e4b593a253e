"""Squares and circles that are dragged in a picture."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.shoot.picture_marks import (
    chart_lines,
    circle_line,
    dragged_circle,
    dragged_square,
    square_line,
)

SIZE = (600, 400)


@pytest.mark.parametrize(("end", "square"), [
    ((130.0, 110.0), (115.0, 115.0, 30.0)),  # the longer way counts
    ((70.0, 110.0), (85.0, 115.0, 30.0)),  # to the left and down
    ((90.0, 60.0), (80.0, 80.0, 40.0)),
    ((101.0, 100.5), (100.0, 100.0, 12.0)),  # a click: a fiftieth of the width
])
def test_squares(end, square):
    assert dragged_square((100.0, 100.0), end, SIZE) == pytest.approx(square)


def test_squares_are_inside_the_picture():
    """Wherever the mouse goes, also beyond the picture."""
    for start, end in np.random.default_rng(2).uniform(-900, 1500, (500, 2, 2)):
        x, y, side = dragged_square(tuple(start), tuple(end), SIZE)
        assert 0 < side <= 400
        assert side / 2 - 1e-6 <= x <= 600 - side / 2 + 1e-6 and side / 2 - 1e-6 <= y <= 400 - side / 2 + 1e-6


def test_lines():
    """A circle's points are as far from its middle; a square's corners are a square; six squares on the line."""
    circle = dragged_circle((50.0, 60.0), (53.0, 64.0))
    assert circle == (50.0, 60.0, 5.0)
    assert np.allclose(np.hypot(*(circle_line(circle) - (50, 60)).T), 5)
    assert square_line((10, 20, 4)).tolist() == [[8, 18], [12, 18], [12, 22], [8, 22], [8, 18]]
    lines = chart_lines((100.0, 50.0), (300.0, 200.0))
    assert len(lines) == 7 and np.allclose(lines[6].mean(0), (300 - 12.5 / 5, 200 - 12.5 / 5))
    assert len(chart_lines((100.0, 50.0), (101.0, 50.0))) == 1
