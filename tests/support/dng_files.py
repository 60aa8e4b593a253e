"""Minimal DNG files, written by the specification alone (Adobe, DNG 1.4; TIFF 6.0; EXIF 2.3)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

BAYER = np.array([[0, 1], [1, 2]])  # RGGB
# Fujifilm's 6 x 6 pattern
XTRANS = np.array([[1, 0, 1, 1, 2, 1], [2, 1, 2, 0, 1, 0], [1, 0, 1, 1, 2, 1],
                   [1, 2, 1, 1, 0, 1], [0, 1, 0, 2, 1, 2], [1, 2, 1, 1, 0, 1]])
# XYZ (D65) to a camera's colours, not unlike that of a real one
COLOUR_MATRIX = np.array([[0.7034, -0.0804, -0.1014], [-0.4420, 1.2564, 0.2058], [-0.0851, 0.1994, 0.5758]])
SIZES = {"B": 1, "H": 2, "I": 4, "s": 1, "R": 8, "r": 8}
KINDS = {"B": 1, "s": 2, "H": 3, "I": 4, "R": 5, "r": 10}  # numbers of the types, TIFF 6.0 section 2


@dataclass(frozen=True)
class Shot:
    """What a DNG says beside its pixels."""

    black: int = 512
    white: int = 15000
    neutral: tuple[float, float, float] = (0.5, 1.0, 0.625)  # AsShotNeutral: what a white thing shows
    matrix: np.ndarray | None = None  # None: COLOUR_MATRIX; (0, 0) has none
    orientation: int = 1
    exposure: tuple[float, float, int] | None = (1 / 125, 8.0, 200)  # seconds, f-number, ISO
    pattern: np.ndarray | None = None  # None: BAYER
    linear: float | None = None  # LinearResponseLimit: up to there, of the range from black to white


Entry = tuple[int, str, list]


def save_dng(path: Path, raw: np.ndarray, shot: Shot | None = None) -> Path:
    """Writes raw values of 16 bits (32 where they are floats), row 0 at the top, uncompressed.

    (h, w) of a sensor's pattern, or (h, w, 3): a LinearRaw DNG, whose pixels have all colours.
    """
    shot = shot or Shot()
    pattern = BAYER if shot.pattern is None else shot.pattern
    matrix = COLOUR_MATRIX if shot.matrix is None else shot.matrix
    colours, floats = raw.shape[2] if raw.ndim == 3 else 1, raw.dtype.kind == "f"
    pixels = raw.astype("<f4" if floats else "<u2").tobytes()
    entries: list[Entry] = [
        (254, "I", [0]), (256, "I", [raw.shape[1]]), (257, "I", [raw.shape[0]]), (259, "H", [1]),
        (271, "s", ["Acme"]), (272, "s", ["Model One"]), (273, "I", [0]),
        (274, "H", [shot.orientation]), (278, "I", [raw.shape[0]]), (279, "I", [len(pixels)]),
        (284, "H", [1]), (306, "s", ["2026:03:04 05:06:07"]),
        (50706, "B", [1, 4, 0, 0]), (50707, "B", [1, 1, 0, 0]), (50708, "s", ["Acme Model One"]),
        (50713, "H", [1, 1]), (50714, "I", [shot.black] * colours), (50717, "I", [shot.white] * colours),
        (50728, "R", list(shot.neutral)), (50778, "H", [21]),
    ]
    entries += [(258, "H", [32 if floats else 16] * colours), (277, "H", [colours])]
    entries += [(339, "H", [3] * colours)] if floats else []
    if colours == 3:
        entries.append((262, "H", [34892]))
    else:
        entries += [(262, "H", [32803]), (33421, "H", list(pattern.shape)), (33422, "B", list(pattern.ravel()))]
    if matrix.size:
        entries.append((50721, "r", list(matrix.ravel())))
    if shot.linear is not None:
        entries.append((50734, "R", [shot.linear]))
    exif: list[Entry] = []
    if shot.exposure is not None:
        time, f_number, iso = shot.exposure
        exif = [(33434, "R", [time]), (33437, "R", [f_number]), (34855, "H", [iso]), (37386, "R", [50.0])]
        entries.append((34665, "I", [0]))
    path.write_bytes(tiff(entries, exif, pixels))
    return path


def tiff(entries: list[Entry], exif: list[Entry], pixels: bytes) -> bytes:
    """A TIFF file of one directory, with that of EXIF and one strip where the entries ask for them (with 0)."""
    entries = sorted(entries, key=lambda entry: entry[0])
    start = 8
    exif_at = start + _length(entries)
    pixels_at = exif_at + (_length(exif) if exif else 0)
    at = {273: pixels_at, 34665: exif_at}
    filled = [(tag, kind, [at[tag]] if tag in at else values) for tag, kind, values in entries]
    return (struct.pack("<2sHI", b"II", 42, start) + _directory(filled, start)
            + (_directory(exif, exif_at) if exif else b"") + pixels)


def _length(entries: list[Entry]) -> int:
    more = [len(_packed(kind, values)) for _, kind, values in entries]
    return 6 + 12 * len(entries) + sum(n + n % 2 for n in more if n > 4)


def _directory(entries: list[Entry], start: int) -> bytes:
    rows, more = b"", b""
    behind = start + 6 + 12 * len(entries)
    for tag, kind, values in entries:
        data = _packed(kind, values)
        rows += struct.pack("<HHI", tag, KINDS[kind], len(data) // SIZES[kind])
        if len(data) <= 4:
            rows += data.ljust(4, b"\0")
        else:
            rows += struct.pack("<I", behind + len(more))
            more += data + b"\0" * (len(data) % 2)
    return struct.pack("<H", len(entries)) + rows + struct.pack("<I", 0) + more


def _packed(kind: str, values: list) -> bytes:
    if kind == "s":
        return values[0].encode() + b"\0"
    if kind in "Rr":
        pairs = [Fraction(float(value)).limit_denominator(10_000) for value in values]
        return b"".join(struct.pack("<II" if kind == "R" else "<ii", p.numerator, p.denominator) for p in pairs)
    return struct.pack(f"<{len(values)}{kind}", *(int(v) for v in values))
