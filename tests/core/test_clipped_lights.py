"""Lights that are cut off in pictures of the world, and lights that only look so."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.images.clipped_lights import BrightestPixels

SIDE = 256
Y, X = np.mgrid[:SIDE, :SIDE]


def clipped(picture: np.ndarray, bands: int = 7) -> int:
    """Of a grey picture, in bands."""
    found = BrightestPixels()
    for band in np.array_split(np.repeat(picture[..., None], 3, -1), bands):
        found.add(band)
    return found.clipped()


def sun(width: float) -> np.ndarray:
    """Radiance of a sun before a sky."""
    return np.asarray(0.5 + Y / SIDE + 300 * np.exp(-0.5 * ((X - 100.3) ** 2 + (Y - 40.6) ** 2) / width**2))


def half(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float16).astype(np.float64)


def few_digits(values: np.ndarray) -> np.ndarray:
    """As Radiance's files hold them: a mantissa of eight bits."""
    mantissa, exponent = np.frexp(values)
    return np.asarray(np.ldexp(np.floor(mantissa * 256) / 256, exponent))


@pytest.mark.parametrize("stored", [np.asarray, half, few_digits])
@pytest.mark.parametrize("width", [2.0, 6.0, 25.0])
def test_a_sun_is_clipped_only_where_it_is_cut_off(width, stored) -> None:
    assert not clipped(stored(sun(width)))
    for share in (0.5, 0.1, 0.02):
        cut = stored(np.minimum(sun(width), 300 * share))
        assert clipped(cut) == (cut == cut.max()).sum()


@pytest.mark.parametrize("stored", [np.asarray, half, few_digits])
def test_soft_boxes_are_not(stored) -> None:
    """Of one radiance, with edges that are smoothed over a pixel; and of one that falls off by 2 % to its sides."""
    inside = np.clip(40.4 - np.abs(X - 120), 0, 1) * np.clip(20.7 - np.abs(Y - 90), 0, 1)
    assert not clipped(stored(0.1 + 8 * inside))
    fill = np.clip(20.5 - np.abs(X - 30), 0, 1) * np.clip(20.5 - np.abs(Y - 200), 0, 1)
    assert not clipped(stored(0.1 + 8 * inside + 4 * fill + 3 * fill[::-1]))
    falls = 1 - 0.02 * ((X - 120) ** 2 + (Y - 90) ** 2) / 2000
    assert not clipped(stored(0.1 + 8 * inside * falls))


def test_one_colour_all_around_is_not() -> None:
    assert not clipped(np.full((SIDE, SIDE), 0.8))
    assert not clipped(np.zeros((SIDE, SIDE)))


def test_bands_make_no_difference() -> None:
    cut = np.minimum(sun(6.0), 50.0)
    assert len({clipped(cut, bands) for bands in (1, 3, SIDE)}) == 1
