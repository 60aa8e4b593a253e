"""Which colour space an ICC profile is, by its numbers: programs and cameras give one space many names.

ICC.1:2010, 7.2 (header), 7.3 (table of tags), 10.5 (curveType), 10.15 (parametricCurveType), 10.31 (XYZType), and
F.3 (an RGB profile of a matrix and three curves).
"""

from __future__ import annotations

import struct

import numpy as np

from ..data import F64
from .colour import SPACES, curve_to_linear, matrix_to_rec709

D50 = (0.34567, 0.35850)  # of the profile connection space
NEAR_MATRIX, NEAR_CURVE = 0.02, 0.002  # profiles have five digits, and adapt whites in their own ways
_AT = np.linspace(0.0, 1.0, 33)


def space_of_profile(profile: bytes) -> str | None:
    """A key of SPACES, or None where the profile is another space, not one of a matrix, or damaged."""
    try:
        found = _matrix_and_curve(profile)
    except (struct.error, ValueError, OverflowError):
        return None
    if found is None:
        return None
    matrix, curve = found
    for name, (primaries, white, transfer) in SPACES.items():
        if np.abs(matrix - matrix_to_rec709(primaries, white)).max() < NEAR_MATRIX and (
                np.abs(curve - curve_to_linear(_AT, transfer)).max() < NEAR_CURVE):
            return name
    return None


def _matrix_and_curve(profile: bytes) -> tuple[F64, F64] | None:
    """(3, 3) from the profile's linear values to linear Rec.709, and its curve at _AT."""
    if profile[16:24] != b"RGB XYZ ":
        return None
    count, = struct.unpack_from(">I", profile, 128)
    tags = {}
    for at in range(132, 132 + 12 * min(count, 100), 12):
        name, start, length = struct.unpack_from(">4sII", profile, at)
        tags[name] = profile[start:start + length]
    names = [colour + kind for kind in (b"XYZ", b"TRC") for colour in (b"r", b"g", b"b")]
    if b"A2B0" in tags or any(name not in tags for name in names):  # a table comes before the matrix
        return None
    columns = np.array([struct.unpack_from(">3i", tags[name], 8) for name in names[:3]]).T / 65536
    curves = [_curve(tags[name]) for name in names[3:]]
    if not (np.isfinite(curves).all() and np.ptp(curves, axis=0).max() < NEAR_CURVE):
        return None
    return matrix_to_rec709("xyz", D50) @ columns, curves[0]


def _curve(tag: bytes) -> F64:
    """A curve's values at _AT.  Raises struct.error or ValueError where it has none."""
    if tag[:4] == b"curv":
        count, = struct.unpack_from(">I", tag, 8)
        table = np.array(struct.unpack_from(f">{min(count, 65536)}H", tag, 12), np.float64)
        if count == 0:
            return _AT.copy()
        if count == 1:
            return np.asarray(_AT ** (table[0] / 256), np.float64)
        return np.asarray(np.interp(_AT, np.linspace(0, 1, len(table)), table / 65535), np.float64)
    kind, = struct.unpack_from(">H", tag, 8)
    if tag[:4] != b"para" or kind > 4:
        raise ValueError("no curve")
    g, a, b, c, d, e, f = (_parameters(tag, kind) + [0.0] * 7)[:7]
    if kind == 0:
        a, d = 1.0, -1.0
    elif kind in (1, 2):  # 0 (1: nothing, 2: c) below -b / a
        e, f, c, d = (c, c, 0.0, -b / a) if a else (0.0, 0.0, 0.0, -1.0)
    with np.errstate(all="ignore"):
        return np.asarray(np.where(_AT >= d, (a * _AT + b) ** g + e, c * _AT + f), np.float64)


def _parameters(tag: bytes, kind: int) -> list[float]:
    count = (1, 3, 4, 5, 7)[kind]
    return [value / 65536 for value in struct.unpack_from(f">{count}i", tag, 12)]
