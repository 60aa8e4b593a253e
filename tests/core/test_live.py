"""The maps of a running solve: coarse looks under finer ones, and how far pictures are from what maps predict."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.data import ViewPicture
from irpso_addon.core.live_maps import Canvas, Live, difference
from irpso_addon.core.resampling import block_means, nearest


def look(size: int, value: float, known: np.ndarray | None = None, role: str = "roughness") -> Live:
    shape = (size, size, 3) if role == "base_color" else (size, size)
    values = np.full(shape, value, np.float32)
    if known is not None:
        values[~known] = np.nan
    return Live({role: values})


def test_finer_looks_cover_what_they_know() -> None:
    canvas = Canvas(8)
    canvas.add(look(2, 0.5))
    left = np.arange(8)[None].repeat(8, 0) < 4
    canvas.add(look(8, 0.25, left))
    np.testing.assert_array_equal(canvas.maps["roughness"], np.where(left, 0.25, 0.5).astype(np.float32))


def test_a_coarser_look_changes_nothing_any_more() -> None:
    canvas = Canvas(8)
    canvas.add(look(8, 0.25, role="base_color"))
    canvas.add(look(4, 0.9, role="base_color"))
    assert np.all(canvas.maps["base_color"] == 0.25)
    canvas.add(look(4, 0.9))  # another role has its own size
    assert np.all(canvas.maps["roughness"] == np.float32(0.9))


def test_a_preview_is_worth_less_than_a_look_of_its_size() -> None:
    canvas = Canvas(8)
    left = np.arange(8)[None].repeat(8, 0) < 4
    canvas.add(look(4, 0.5), preview=True)
    canvas.add(look(8, 0.25, left))
    canvas.add(look(8, 0.75), preview=True)  # still better than coarser ones
    np.testing.assert_array_equal(canvas.maps["roughness"], np.where(left, 0.25, 0.75).astype(np.float32))
    canvas.add(look(8, 0.125))
    assert np.all(canvas.maps["roughness"] == 0.125)


def test_what_has_changed_is_another_array() -> None:
    """Whoever shows it need not compare, and may go on reading the one before."""
    canvas = Canvas(4)
    before = canvas.add(look(4, 0.5))["roughness"]
    after = canvas.add(look(4, 0.25))["roughness"]
    assert after is not before
    assert np.all(before == 0.5)


def test_what_no_look_knows_stays_unknown() -> None:
    canvas = Canvas(4)
    known = np.zeros((2, 2), bool)
    known[0] = True
    canvas.add(look(2, 0.5, known))
    assert np.isnan(canvas.maps["roughness"][2:]).all()
    assert np.all(canvas.maps["roughness"][:2] == 0.5)


def test_a_look_is_not_written_into() -> None:
    first = look(4, 0.5)
    canvas = Canvas(4)
    canvas.add(first)
    canvas.add(look(4, 0.25))
    assert np.all(first.maps["roughness"] == 0.5)


@pytest.mark.parametrize(("size", "grown"), [(2, 5), (5, 2), (3, 3), (7, 16)])
def test_nearest_takes_the_nearest_texel(size: int, grown: int) -> None:
    values = np.random.default_rng(0).random((size, size))
    want = np.array([[values[int((y + 0.5) * size / grown), int((x + 0.5) * size / grown)]
                      for x in range(grown)] for y in range(grown)])
    np.testing.assert_array_equal(nearest(values, grown), want)


def test_block_means_keep_what_is_unknown() -> None:
    values = np.arange(16 * 3, dtype=np.float32).reshape(4, 4, 3)
    values[0, 0, 0] = np.nan
    small = block_means(values, 2)
    assert np.isnan(small[0, 0, 0])
    assert small[1, 1, 2] == pytest.approx(values[2:, 2:, 2].mean())
    assert block_means(values, 3).shape == (3, 3, 3)  # no whole number of texels: the nearest


def test_difference_weighs_pictures_by_their_light() -> None:
    def picture(reference: list[float], predicted: list[float], scale: float) -> ViewPicture:
        shape = (1, len(reference), 1)
        return ViewPicture("a.exr", "Camera", (), np.broadcast_to(np.reshape(reference, shape), (1, len(reference), 3)),
                           np.broadcast_to(np.reshape(predicted, shape), (1, len(predicted), 3)), scale)

    nan = float("nan")
    bright, dark = picture([1.0, 0.5, nan], [1.1, 0.5, 9.0], 10.0), picture([1.0, 0.0], [0.5, nan], 1.0)
    # (10 * .1 + 1 * .5) / (10 * 1.5 + 1 * 1): pixels of which one side says nothing are left out
    assert difference((bright, dark)) == pytest.approx(1.5 / 16.0)
    assert np.isnan(difference(()))
