"""TIFF's tags that no library tells: EXIF that a PNG file has after its pixels, and whether a DNG holds floats.

Sources: PNG, third edition (eXIf may stand anywhere but between the pixels' chunks); TIFF 6.0, section 2; EXIF (CIPA
DC-008), 4.6; Adobe's DNG 1.7.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

SIGNATURE = 8  # bytes before the first chunk
MOST = 1 << 16  # bytes of such a chunk that is looked at
MORE = 34665  # tag of the directory with the exposure
DIRECTORIES, PHOTOMETRIC, SAMPLES, FLOATS = 330, 262, 339, 3  # of a DNG: SubIFDs, and SampleFormat's number for floats
RAW_PICTURES = (32803, 34892)  # photometric interpretations: a colour filter array, LinearRaw
MOST_DIRECTORIES = 64
# OpenImageIO's names of the tags that anything relies on
NAMES = {274: "Orientation", 33434: "ExposureTime", 33437: "FNumber", 34855: "Exif:PhotographicSensitivity",
         34865: "Exif:StandardOutputSensitivity", 34866: "Exif:RecommendedExposureIndex", 34867: "Exif:ISOSpeed",
         37377: "Exif:ShutterSpeedValue", 37378: "Exif:ApertureValue"}
NUMBERS = {3: "H", 4: "I", 13: "I", 5: "II", 10: "ii"}  # SHORT, LONG, IFD; RATIONAL, SRATIONAL: fractions


def png_exif(path: Path) -> dict[str, float]:
    """Values by OpenImageIO's names; nothing where there is no such chunk, or it is damaged."""
    data = _chunk(path)
    found: dict[int, float] = {}
    try:
        order, start = _header(data)
        found = {tag: values[0] for tag, values in _directory(data, start, order).items()}
        if MORE in found:
            found |= {tag: values[0] for tag, values in _directory(data, int(found[MORE]), order).items()}
    except struct.error:  # beyond the end
        pass
    return {NAMES[tag]: value for tag, value in found.items() if tag in NAMES}


def holds_floats(path: Path) -> bool:
    """Whether a DNG's RAW picture is of floats."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        try:
            order, start = _header(data)
            first = _directory(data, start, order)
            others = [_directory(data, int(at), order) for at in first.get(DIRECTORIES, [])[:MOST_DIRECTORIES]]
        except struct.error:
            return False
    return any(each.get(SAMPLES, [0])[0] == FLOATS and each.get(PHOTOMETRIC, [0])[0] in RAW_PICTURES
               for each in (first, *others))


def _header(data: bytes | mmap.mmap) -> tuple[str, int]:
    """Order of bytes, and where the first directory is.  Raises struct.error where it is no TIFF."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    if order is None:
        raise struct.error
    return order, struct.unpack_from(f"{order}I", data, 4)[0]


def _chunk(path: Path) -> bytes:
    with path.open("rb", buffering=0) as file:
        file.seek(SIGNATURE)
        while len(head := file.read(8)) == 8:
            length, kind = struct.unpack(">I4s", head)
            if kind == b"eXIf":
                return file.read(min(length, MOST))
            file.seek(length + 4, 1)
    return b""


def _directory(data: bytes | mmap.mmap, start: int, order: str) -> dict[int, list[float]]:
    """The numbers of each entry, of a long list the first ones.  Raises struct.error."""
    found: dict[int, list[float]] = {}
    for entry in range(struct.unpack_from(f"{order}H", data, start)[0]):
        at = start + 2 + 12 * entry
        tag, kind, count = struct.unpack_from(f"{order}HHI", data, at)
        form = NUMBERS.get(kind)
        count = min(count, MOST_DIRECTORIES)
        if form is None or not count:
            continue
        size = struct.calcsize(order + count * form)
        values = struct.unpack_from(
            order + count * form, data, at + 8 if size <= 4 else struct.unpack_from(f"{order}I", data, at + 8)[0])
        found[tag] = list(values) if len(form) == 1 else [
            over / under if under else 0.0 for over, under in zip(values[::2], values[1::2], strict=True)]
    return found
