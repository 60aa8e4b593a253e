"""Push-pull filling: what is known stays, what is not lies between."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.cpu_solver.solver import fill as fill_without_opengl
from irpso_addon.gpu.maps.fill import fill

SIZES = [(64, 64), (100, 100), (33, 47), (1, 1), (5, 1), (128, 96)]


def filled(on_gl, values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(h, w, 3) values and (h, w) weights -> the filled (h, w, 4)."""
    h, w = known.shape
    data = np.concatenate([values, known[..., None]], axis=2).astype(np.float32)

    def call(device):
        source = device.texture(w, h, data=data)
        result = fill(device, source)
        found = device.read(result).copy()
        for texture in {source, result}:
            texture.release()
        return found

    return on_gl(call)


def scattered(shape: tuple[int, int], share: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    known = (rng.random(shape) < share).astype(float)
    known.flat[0] = 1
    return rng.uniform(-3, 5, (*shape, 3)) * known[..., None], known


@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize("share", [0.5, 0.01])
def test_known_texels_stay_and_holes_lie_between_them(on_gl, shape, share):
    values, known = scattered(shape, share)
    got = filled(on_gl, values, known)
    sure = known == 1
    np.testing.assert_allclose(got[sure, :3], values[sure], atol=1e-6)  # mix(a, b, 1) is b to a rounding of a
    assert np.isfinite(got).all()
    for channel in range(3):
        # A mean of means: float32 rounds it by some 1e-6 of the range.
        low, high = values[sure, channel].min(), values[sure, channel].max()
        assert got[..., channel].min() >= low - 1e-5
        assert got[..., channel].max() <= high + 1e-5
    np.testing.assert_array_equal(got[..., 3], 1)


@pytest.mark.parametrize("shape", SIZES)
def test_a_constant_stays_constant(on_gl, shape):
    _, known = scattered(shape, 0.02)
    colour = np.array([0.25, 0.5, 0.125])
    got = filled(on_gl, colour * known[..., None], known)
    np.testing.assert_allclose(got[..., :3], np.broadcast_to(colour, (*shape, 3)), rtol=2e-6)


def test_a_hole_takes_from_what_is_near(on_gl):
    """Left half red, right half green, a gap of 12 texels between: each side of the gap leans to its side."""
    values, known = np.zeros((64, 64, 3)), np.ones((64, 64))
    values[:, :32, 0], values[:, 32:, 1] = 1, 1
    known[:, 26:38] = 0
    got = filled(on_gl, values * known[..., None], known)
    assert (got[:, 26, 0] > 0.75).all()
    assert (got[:, 37, 1] > 0.75).all()
    np.testing.assert_allclose(got[..., :2].sum(axis=-1), 1, atol=1e-5)


def test_a_ramp_is_continued_smoothly_over_a_hole(on_gl):
    """Within a quarter of the rise across the hole."""
    x = np.linspace(0, 1, 64)
    values = np.repeat(np.broadcast_to(x, (64, 64))[..., None], 3, axis=2)
    known = np.ones((64, 64))
    known[20:36, 20:36] = 0
    got = filled(on_gl, values * known[..., None], known)[..., 0]
    assert np.abs(got - values[..., 0]).max() < 0.25 * (x[36] - x[20])
    assert np.abs(np.diff(got, axis=1)).max() < 0.1


def test_a_weight_between_mixes_with_the_neighbours(on_gl):
    values, known = np.zeros((16, 16, 3)), np.ones((16, 16))
    values[:] = 0.2
    values[8, 8], known[8, 8] = 1.0, 0.5
    got = filled(on_gl, values, known)[8, 8, 0]
    assert 0.55 < got < 0.75  # half its own 1, half the neighbourhood's 0.2 with a little of itself
    untouched = np.ones((16, 16), bool)
    untouched[8, 8] = False
    np.testing.assert_array_equal(filled(on_gl, values, known)[untouched, 0], np.float32(0.2))


def test_nothing_known_gives_zeros_not_nan(on_gl):
    got = filled(on_gl, np.zeros((20, 30, 3)), np.zeros((20, 30)))
    np.testing.assert_array_equal(got[..., :3], 0)


@pytest.mark.parametrize("shape", [(64, 64), (33, 47)])
def test_what_lies_beside_a_border_continues_it(on_gl, shape):
    """A renderer mixes the first texel outside a UV island with the last one inside: it must have that one's color."""
    h, w = shape
    rng = np.random.default_rng(2)
    values, known = rng.uniform(0, 1, (*shape, 3)), np.zeros(shape)
    known[7:h - 6, 5:w - 9] = 1
    got = filled(on_gl, values * known[..., None], known)[..., :3]
    outside = np.pad(values[7:h - 6, 5:w - 9], ((1, 1), (1, 1), (0, 0)), mode="edge")
    np.testing.assert_allclose(got[6:h - 5, 4:w - 8], outside, atol=1e-6)


@pytest.mark.parametrize("shape", [(64, 64), (33, 47)])
@pytest.mark.parametrize("share", [0.5, 0.01])
def test_the_twin_without_opengl_fills_alike(on_gl, shape, share):
    values, known = scattered(shape, share)
    known *= np.random.default_rng(3).choice([0.25, 1.0], shape)
    values = values.astype(np.float32)
    np.testing.assert_allclose(
        filled(on_gl, values, known)[..., :3], fill_without_opengl(values.astype(float), known), atol=2e-5)
