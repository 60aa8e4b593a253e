"""Colour spaces of files, to linear Rec.709.

Names are Blender's (and a few that files carry).  A space is its primaries, its white and its transfer
function; matrices follow SMPTE RP 177 (RGB to XYZ from primaries), whites are adapted to D65 by
Bradford's transform, as OpenColorIO's built-in configurations do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np

from ..data import F32, F64

Floats = TypeVar("Floats", F32, F64)
D65 = (0.3127, 0.3290)
# ACES white, SMPTE ST 2065-1
D60 = (0.32168, 0.33767)
_WHITE_E = (1 / 3, 1 / 3)
_XYZ = ((1.0, 0.0), (0.0, 1.0), (0.0, 0.0))

# name -> xy of red, green, blue
PRIMARIES: dict[str, tuple[tuple[float, float], ...]] = {
    "rec709": ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06)),  # ITU-R BT.709
    "rec2020": ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),  # ITU-R BT.2020
    "p3": ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),  # SMPTE RP 431-2
    "adobe": ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06)),  # Adobe RGB (1998)
    "ap0": ((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.0770)),  # SMPTE ST 2065-1
    "ap1": ((0.713, 0.293), (0.165, 0.830), (0.128, 0.044)),  # ACEScg, S-2014-004
    "xyz": _XYZ,
}

# Blender's name -> (primaries, white, transfer: "linear", "srgb" or a power)
SPACES: dict[str, tuple[str, tuple[float, float], str | float]] = {
    "Linear Rec.709": ("rec709", D65, "linear"),
    "Linear Rec.2020": ("rec2020", D65, "linear"),
    "Linear DCI-P3 D65": ("p3", D65, "linear"),
    "Linear Adobe RGB": ("adobe", D65, "linear"),
    "Linear CIE-XYZ D65": ("xyz", D65, "linear"),
    "Linear CIE-XYZ E": ("xyz", _WHITE_E, "linear"),
    "ACES2065-1": ("ap0", D60, "linear"),
    "ACEScg": ("ap1", D60, "linear"),
    "Non-Color": ("rec709", D65, "linear"),
    "sRGB": ("rec709", D65, "srgb"),
    "Display P3": ("p3", D65, "srgb"),
    "sRGB Encoded P3-D65": ("p3", D65, "srgb"),
    "sRGB Encoded AP1": ("ap1", D60, "srgb"),
    "Rec.1886": ("rec709", D65, 2.4),
    "Rec.2020": ("rec2020", D65, 2.4),
    "Gamma 1.8 Encoded Rec.709": ("rec709", D65, 1.8),
    "Gamma 2.2 Encoded Rec.709": ("rec709", D65, 2.2),
    "Gamma 2.4 Encoded Rec.709": ("rec709", D65, 2.4),
    "Gamma 2.2 Encoded AdobeRGB": ("adobe", D65, 2.2),
    "Gamma 2.2 Encoded AP1": ("ap1", D60, 2.2),
}
# Other names for the same, lower case: Blender's aliases and the interchange names that EXR files carry.
_ALIASES = {
    "linear": "Linear Rec.709", "scene_linear": "Linear Rec.709", "linear bt.709": "Linear Rec.709",
    "lin_rec709": "Linear Rec.709", "lin_rec709_scene": "Linear Rec.709", "lin_srgb": "Linear Rec.709",
    "lin_rec2020_scene": "Linear Rec.2020", "lin_p3d65_scene": "Linear DCI-P3 D65",
    "lin_adobergb_scene": "Linear Adobe RGB", "lin_ciexyzd65_scene": "Linear CIE-XYZ D65",
    "lin_ap0_scene": "ACES2065-1", "lin_ap1_scene": "ACEScg", "raw": "Non-Color", "data": "Non-Color",
    "srgb_rec709_scene": "sRGB", "srgb_p3d65_scene": "Display P3",
    # descriptions of ICC profiles
    "srgb iec61966-2.1": "sRGB", "srgb built-in": "sRGB", "adobe rgb (1998)": "Gamma 2.2 Encoded AdobeRGB",
}
_BY_LOWER = {name.lower(): name for name in SPACES} | _ALIASES

# Bradford's cone responses (Lam 1985)
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


@dataclass(frozen=True)
class CameraColour:
    """From a camera's own linear colours to linear Rec.709: factors of red, green and blue, then a matrix."""

    white_balance: tuple[float, float, float]
    matrix: tuple[tuple[float, float, float], ...]  # 3 x 3; its rows add up to 1: white stays white

    @classmethod
    def of(cls, white_balance: Sequence[float], matrix: Sequence[Sequence[float]]) -> CameraColour:
        """Checked: raises ValueError or TypeError of what is no such thing."""
        factors, rows = np.array(white_balance, np.float64), np.array(matrix, np.float64)
        if factors.shape != (3,) or rows.shape != (3, 3) or not (np.isfinite(rows).all() and (factors > 0).all()
                                                                 and np.isfinite(factors).all()):
            raise ValueError("no colours of a camera")
        red, green, blue = factors.tolist()
        return cls((red, green, blue), tuple((row[0], row[1], row[2]) for row in rows.tolist()))

    def to_linear_rec709(self, rgb: F32, white_balance: tuple[float, float, float] | None = None) -> F32:
        """``rgb`` (..., 3) of the camera; ``white_balance``: other factors than those of the picture."""
        factors = np.array(self.white_balance if white_balance is None else white_balance)
        return np.asarray(rgb @ (np.array(self.matrix) * factors).T.astype(np.float32))


def known_space(name: str) -> str | None:
    """Blender's own spelling of the colour space ``name``, None when it is not one of ours."""
    return _BY_LOWER.get(name.lower())


def srgb_to_linear(values: Floats) -> Floats:
    """IEC 61966-2-1, decoding; mirrored about 0."""
    x = np.abs(values)
    out = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    return np.copysign(out, values).astype(values.dtype)


def linear_to_srgb(values: Floats) -> Floats:
    """IEC 61966-2-1, encoding; mirrored about 0."""
    x = np.abs(values)
    out = np.where(x <= 0.0031308, x * 12.92, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.copysign(out, values).astype(values.dtype)


def curve_to_linear(values: Floats, transfer: str | float) -> Floats:
    """Undoes a transfer function of SPACES; mirrored about 0."""
    if transfer == "srgb":
        return srgb_to_linear(values)
    if isinstance(transfer, float):
        return np.copysign(np.abs(values) ** transfer, values).astype(values.dtype)
    return values


def to_linear_rec709(rgb: F32, space: str) -> F32:
    """``rgb`` (..., 3) of colour space ``space`` (a key of SPACES) as linear Rec.709."""
    primaries, white, transfer = SPACES[space]
    rgb = curve_to_linear(rgb, transfer)
    if primaries == "rec709":
        return rgb  # bit for bit where the file is linear Rec.709 already
    return rgb @ matrix_to_rec709(primaries, white).T.astype(np.float32)


@lru_cache
def matrix_to_rec709(primaries: str, white: tuple[float, float]) -> F64:
    """(3, 3): linear RGB of ``primaries`` and ``white`` to linear Rec.709."""
    source = np.eye(3) if primaries == "xyz" else _rgb_to_xyz(primaries, white)
    cones_from, cones_to = _BRADFORD @ _xyz(white), _BRADFORD @ _xyz(D65)
    adapt = np.linalg.inv(_BRADFORD) @ np.diag(cones_to / cones_from) @ _BRADFORD
    return np.asarray(np.linalg.inv(_rgb_to_xyz("rec709", D65)) @ adapt @ source)


def _xyz(xy: tuple[float, float]) -> F64:
    return np.array([xy[0] / xy[1], 1.0, (1 - xy[0] - xy[1]) / xy[1]])


def _rgb_to_xyz(primaries: str, white: tuple[float, float]) -> F64:
    """SMPTE RP 177-1993, section 3.3."""
    columns = np.array([[x, y, 1 - x - y] for x, y in PRIMARIES[primaries]]).T
    return np.asarray(columns * np.linalg.solve(columns, _xyz(white)))
