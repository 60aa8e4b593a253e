"""EXIF that a PNG file has after its pixels, where OpenImageIO does not look.

Sources: PNG, third edition (eXIf may stand anywhere but between the pixels' chunks); TIFF 6.0, section 2; EXIF (CIPA
DC-008), 4.6.
"""

from __future__ import annotations

import struct
from pathlib import Path

SIGNATURE = 8  # bytes before the first chunk
MOST = 1 << 16  # bytes of such a chunk that is looked at
MORE = 34665  # tag of the directory with the exposure
# OpenImageIO's names of the tags that anything relies on
NAMES = {274: "Orientation", 33434: "ExposureTime", 33437: "FNumber", 34855: "Exif:PhotographicSensitivity",
         34865: "Exif:StandardOutputSensitivity", 34866: "Exif:RecommendedExposureIndex", 34867: "Exif:ISOSpeed",
         37377: "Exif:ShutterSpeedValue", 37378: "Exif:ApertureValue"}
NUMBERS = {3: "H", 4: "I"}  # SHORT, LONG
FRACTIONS = {5: "II", 10: "ii"}  # RATIONAL, SRATIONAL: at an offset


def png_exif(path: Path) -> dict[str, float]:
    """Values by OpenImageIO's names; nothing where there is no such chunk, or it is damaged."""
    data = _chunk(path)
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    if order is None:
        return {}
    found: dict[int, float] = {}
    try:
        found = _directory(data, struct.unpack_from(f"{order}I", data, 4)[0], order)
        if MORE in found:
            found |= _directory(data, int(found[MORE]), order)
    except struct.error:  # beyond the end
        pass
    return {NAMES[tag]: value for tag, value in found.items() if tag in NAMES}


def _chunk(path: Path) -> bytes:
    with path.open("rb", buffering=0) as file:
        file.seek(SIGNATURE)
        while len(head := file.read(8)) == 8:
            length, kind = struct.unpack(">I4s", head)
            if kind == b"eXIf":
                return file.read(min(length, MOST))
            file.seek(length + 4, 1)
    return b""


def _directory(data: bytes, start: int, order: str) -> dict[int, float]:
    """The first number of each entry.  Raises struct.error."""
    found = {}
    for entry in range(struct.unpack_from(f"{order}H", data, start)[0]):
        at = start + 2 + 12 * entry
        tag, kind = struct.unpack_from(f"{order}HH", data, at)
        if kind in NUMBERS:
            found[tag] = struct.unpack_from(order + NUMBERS[kind], data, at + 8)[0]
        elif kind in FRACTIONS:
            over, under = struct.unpack_from(
                order + FRACTIONS[kind], data, struct.unpack_from(f"{order}I", data, at + 8)[0])
            found[tag] = over / under if under else 0.0
    return found
