"""The response of a camera, or of the program that developed its pictures: files hold radiance to some power.

White, the value 1, stays where it is.  A black level may have been added to that.
"""

from __future__ import annotations

import numpy as np

from ..data import F32, View

LEAST_RESPONSE, MOST_RESPONSE = 0.2, 5.0
MOST_BLACK = 1.0  # values of a file


def file_scale(view: View) -> float:
    """The value of the view's file for each unit of radiance, vignetting, response and black level aside."""
    return float(view.gain * 2.0**view.exposure)


def straightened(rgb: F32, view: View) -> F32:
    """Radiance from ``rgb``, a picture that was read as if its file were linear; both are over `file_scale`."""
    if any(view.black_level):
        rgb = rgb - np.array(view.black_level, np.float32) / np.float32(file_scale(view))
    return undone(rgb, file_scale(view), view.response)


def as_read(radiance: F32, view: View) -> F32:
    """The reverse of `straightened`."""
    rgb = undone(radiance, file_scale(view), 1 / view.response)
    if any(view.black_level):
        rgb = rgb + np.array(view.black_level, np.float32) / np.float32(file_scale(view))
    return rgb


def undone(rgb: F32, scale: float, response: float) -> F32:
    """``rgb`` times ``scale`` to the power 1 / ``response``, over ``scale``.  Negative values, of noise, stay so."""
    if response == 1.0:
        return rgb
    value = rgb * np.float32(scale)
    return np.asarray(np.sign(value) * np.abs(value) ** np.float32(1 / response) / np.float32(scale), np.float32)
