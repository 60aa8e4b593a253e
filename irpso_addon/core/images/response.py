"""The response of a camera, or of the program that developed its pictures.

Files hold radiance to some power.  A tone curve has a shoulder beside, so that whites are flatter than the dark: the
curve of Naka and Rushton (J. Physiol. 185, 1966), which photography knows as sigmoid.  White, the value 1, stays where
it is.  A black level may have been added to that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ..data import F32, F64, View

Values = TypeVar("Values", F32, F64)

LEAST_RESPONSE, MOST_RESPONSE = 0.2, 5.0
LEAST_SHOULDER, MOST_SHOULDER = 1.0, 1000.0
MOST_BLACK = 1.0  # values of a file


def file_scale(view: View) -> F64:
    """(3,) values of the view's file for each unit of radiance, vignetting, response and black level aside."""
    return np.asarray(view.gain * 2.0**view.exposure * np.array(view.tint))


def straightened(rgb: F32, view: View) -> F32:
    """Radiance from ``rgb``, a picture that was read as if its file were linear; both are over `file_scale`."""
    if any(view.black_level):
        rgb = rgb - _black(view)
    return _under(straight, rgb, view)


def as_read(radiance: F32, view: View) -> F32:
    """The reverse of `straightened`."""
    rgb = _under(curved, radiance, view)
    if any(view.black_level):
        rgb = rgb + _black(view)
    return rgb


def _black(view: View) -> F32:
    return np.asarray(np.array(view.black_level, np.float32) / file_scale(view).astype(np.float32))


def straight(value: Values, response: float, shoulder: float) -> Values:
    """What is in proportion to radiance, of values of files.  Negative values, of noise, stay so.

    ``response``: exponent of the curve in the dark.  ``shoulder``: how many times flatter it is at white; 1: no less.
    """
    size = np.abs(value)
    if shoulder != 1.0:
        under = np.minimum(size, 1.0)
        size = np.where(size > 1, 1 + shoulder * (size - 1), under / (shoulder - (shoulder - 1) * under))
    return np.asarray(np.sign(value) * (size if response == 1.0 else size ** (1 / response)), value.dtype)


def curved(value: Values, response: float, shoulder: float) -> Values:
    """The reverse of `straight`."""
    size = np.abs(value) if response == 1.0 else np.abs(value) ** response
    if shoulder != 1.0:
        under = np.minimum(size, 1.0)
        size = np.where(size > 1, 1 + (size - 1) / shoulder, shoulder * under / (1 + (shoulder - 1) * under))
    return np.asarray(np.sign(value) * size, value.dtype)


def _under(curve: Callable[[F32, float, float], F32], rgb: F32, view: View) -> F32:
    """``rgb`` over `file_scale`, of which values the file's curve is taken or undone."""
    if view.response == 1.0 and view.shoulder == 1.0:
        return rgb
    scale = file_scale(view).astype(np.float32)
    return np.asarray(curve(rgb * scale, view.response, view.shoulder) / scale)
