"""Squares of texels, packed: on the device as in memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.solve.material_sample import SIDE, WIDTH, Squares, spread_squares


@pytest.mark.parametrize("channels", [1, 4])
@pytest.mark.parametrize("count", [1, WIDTH // SIDE, 3 * WIDTH // SIDE - 5])
def test_a_texture_is_packed_as_an_array_is(on_gl: Any, count: int, channels: int) -> None:
    """The grid ends within squares, whose rest is 0."""
    rng = np.random.default_rng(count)
    grid = rng.random((99, 77, channels), np.float32)
    texels = np.ones(grid.shape[:2], bool)
    squares = spread_squares(texels, count, 1)
    squares = Squares((*squares.corners[1:], (72, 96)))  # the last of all

    def packed(device: Device) -> np.ndarray:
        with device.scope():
            return squares.pack_texture(device, device.texture(77, 99, channels, grid)).copy()

    expected = squares.pack(grid)
    assert expected[(count - 1) // (WIDTH // SIDE) * SIDE:].any()
    assert all(size & (size - 1) == 0 for size in expected.shape[:2])
    np.testing.assert_array_equal(on_gl(packed), expected)
