"""Colour spaces against published figures; ``tests/blender/test_scene_images.py`` holds them against Blender's."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.images.colour import (
    D60,
    D65,
    SPACES,
    known_space,
    linear_to_srgb,
    matrix_to_rec709,
    srgb_to_linear,
    to_linear_rec709,
)


def test_rec2020_matrix():  # ITU-R BT.2087-0, section 4, inverted to four digits
    published = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]]
    np.testing.assert_allclose(matrix_to_rec709("rec2020", D65), published, atol=1e-4)


def test_acescg_matrix():  # as printed with OpenColorIO's ACES configurations
    published = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
    np.testing.assert_allclose(matrix_to_rec709("ap1", D60), published, atol=1e-4)


@pytest.mark.parametrize("space", SPACES)
def test_white_stays_white(space):
    if "XYZ" not in space:
        np.testing.assert_allclose(to_linear_rec709(np.ones((1, 3), np.float32), space), 1, atol=2e-6)


def test_srgb():  # IEC 61966-2-1
    found = srgb_to_linear(np.float32([0, 0.04045, 0.5, 1]))
    np.testing.assert_allclose(found, [0, 0.0031308, 0.2140411, 1], rtol=1e-5)
    x = np.linspace(-0.2, 1.5, 1001, dtype=np.float32)
    np.testing.assert_allclose(srgb_to_linear(linear_to_srgb(x)), x, atol=1e-6)


def test_linear_values_are_not_touched():
    x = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    for space in ("Linear Rec.709", "Non-Color"):
        assert to_linear_rec709(x, space).tobytes() == x.tobytes()


def test_names():
    assert known_space("linear rec.709") == known_space("lin_rec709_scene") == "Linear Rec.709"
    assert known_space("Non-Color") == "Non-Color"
    assert known_space("AgX Log") is None
