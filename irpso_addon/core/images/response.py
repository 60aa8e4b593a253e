"""The response of a camera, or of the program that developed its pictures: files hold radiance to some power.

White, the value 1, stays where it is.  A black level may have been added to that.
"""

from __future__ import annotations

import numpy as np

from ..data import F32, F64, View

LEAST_RESPONSE, MOST_RESPONSE = 0.2, 5.0
MOST_BLACK = 1.0  # values of a file


def file_scale(view: View) -> F64:
    """(3,) values of the view's file for each unit of radiance, vignetting, response and black level aside."""
    return np.asarray(view.gain * 2.0**view.exposure * np.array(view.tint))


def straightened(rgb: F32, view: View) -> F32:
    """Radiance from ``rgb``, a picture that was read as if its file were linear; both are over `file_scale`."""
    if any(view.black_level):
        rgb = rgb - _black(view)
    return undone(rgb, file_scale(view), view.response)


def as_read(radiance: F32, view: View) -> F32:
    """The reverse of `straightened`."""
    rgb = undone(radiance, file_scale(view), 1 / view.response)
    if any(view.black_level):
        rgb = rgb + _black(view)
    return rgb


def _black(view: View) -> F32:
    return np.asarray(np.array(view.black_level, np.float32) / file_scale(view).astype(np.float32))


def undone(rgb: F32, scale: float | F64, response: float) -> F32:
    """``rgb`` times ``scale`` to the power 1 / ``response``, over ``scale``.  Negative values, of noise, stay so."""
    if response == 1.0:
        return rgb
    scale = np.asarray(scale, np.float32)
    value = rgb * scale
    return np.asarray(np.sign(value) * np.abs(value) ** np.float32(1 / response) / scale, np.float32)
