"""Small pictures of every format, compression and layout that OpenImageIO writes, and headers that lie about them."""

from __future__ import annotations

import binascii
import re
import struct
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

SIZES = (0, 1, 2, 255, 19_999, 20_000, 20_001, 65_535, 100_000, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
# (suffix, type, channels, attributes)
FORMS: tuple[tuple[str, str, int, dict[str, Any]], ...] = (
    *((".exr", form, channels, {"compression": compression})
      for form, channels, compression in (
          ("half", 3, "none"), ("half", 4, "rle"), ("half", 3, "zip"), ("float", 4, "zips"), ("half", 3, "piz"),
          ("float", 3, "pxr24"), ("half", 3, "b44"), ("half", 4, "b44a"), ("half", 3, "dwaa"), ("half", 3, "dwab"),
          ("float", 1, "zip"), ("uint32", 3, "zip"))),
    (".exr", "half", 4, {"compression": "zip", "tile": 16}),
    (".exr", "float", 3, {"compression": "piz", "tile": 16}),
    (".exr", "half", 40, {"compression": "zip"}),
    *((".png", form, channels, {}) for form in ("uint8", "uint16") for channels in (1, 2, 3, 4)),
    *((".tif", form, channels, {"compression": compression})
      for form, channels, compression in (
          ("uint8", 3, "none"), ("uint8", 4, "lzw"), ("uint16", 3, "zip"), ("float", 3, "none"), ("float", 4, "zip"),
          ("half", 3, "zip"), ("uint8", 3, "packbits"), ("uint8", 3, "jpeg"), ("uint32", 3, "lzw"))),
    (".tif", "uint8", 3, {"compression": "none", "tile": 16}),
    (".tif", "uint16", 4, {"compression": "zip", "tile": 16, "planarconfig": "separate"}),
    (".jpg", "uint8", 3, {}), (".jpg", "uint8", 1, {}), (".hdr", "float", 3, {}),
    (".bmp", "uint8", 3, {}), (".tga", "uint8", 4, {"compression": "rle"}), (".dpx", "uint16", 3, {}),
    (".ppm", "uint8", 3, {}), (".pfm", "float", 3, {}), (".gif", "uint8", 3, {}), (".webp", "uint8", 3, {}),
    (".sgi", "uint8", 3, {}), (".ico", "uint8", 4, {}), (".fits", "float", 1, {}), (".rla", "uint8", 3, {}),
    (".jp2", "uint8", 3, {}), (".jxl", "uint8", 3, {}), (".heic", "uint8", 3, {}), (".iff", "uint8", 4, {}),
    (".zfile", "float", 1, {}), (".psd", "uint8", 3, {}),
)


def write(path: Path, pixels: Any, form: str, attributes: dict[str, Any]) -> bool:
    """Whether OpenImageIO could write ``pixels`` (h, w, c)."""
    import OpenImageIO

    height, width, channels = pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, form)
    spec.tile_width = spec.tile_height = attributes.get("tile", 0)
    for key, value in attributes.items():
        if key != "tile":
            spec.attribute(key, value)
    file = OpenImageIO.ImageOutput.create(str(path))
    return bool(file is not None and file.open(str(path), spec) and file.write_image(pixels) and file.close())


def bases(folder: Path) -> list[tuple[str, bytes]]:
    """(suffix, bytes) of each of FORMS that can be written here, 36 x 24 pixels."""
    import OpenImageIO

    rng = np.random.default_rng(1)
    found = []
    for suffix, form, channels, attributes in FORMS:
        ramp = np.linspace(0.05, 0.9, 24 * 36).reshape(24, 36, 1)
        pixels = (ramp * rng.uniform(0.5, 1, channels)).astype(np.float32)
        if channels in (2, 4):
            pixels[..., -1] = ramp[..., 0] > 0.2
        path = folder / f"base{suffix}"
        try:
            if write(path, pixels, form, attributes):
                found.append((suffix, path.read_bytes()))
        finally:
            path.unlink(missing_ok=True)
    OpenImageIO.geterror()  # of formats that it cannot write, else told when the process ends
    found += [(".exr", _parts(folder / "parts.exr")), (".exr", _moved(folder / "moved.exr"))]
    return found


def _parts(path: Path) -> bytes:
    """Two parts, the second the picture."""
    import OpenImageIO

    specs = []
    for name in ("depth", "Combined"):
        specs.append(OpenImageIO.ImageSpec(36, 24, 4, "half"))
        specs[-1].attribute("oiio:subimagename", name)
    file = OpenImageIO.ImageOutput.create(str(path))
    file.open(str(path), tuple(specs))
    pixels = np.full((24, 36, 4), 0.5, np.float32)
    file.write_image(pixels)
    file.open(str(path), specs[1], "AppendSubimage")
    file.write_image(pixels)
    file.close()
    data = path.read_bytes()
    path.unlink()
    return data


def _moved(path: Path) -> bytes:
    """The stored window is a part of the frame."""
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(20, 10, 3, "half")
    spec.x, spec.y, spec.full_width, spec.full_height = 5, 7, 36, 24
    file = OpenImageIO.ImageOutput.create(str(path))
    file.open(str(path), spec)
    file.write_image(np.full((10, 20, 3), 0.5, np.float32))
    file.close()
    data = path.read_bytes()
    path.unlink()
    return data


def lying(data: bytes, suffix: str, rng: Random) -> bytes:
    """``data`` with a header that says another size, number of channels or type; else spoilt at its beginning."""
    liar = _LIARS.get(suffix)
    return liar(bytearray(data), rng) if liar else data


def _exr(data: bytearray, rng: Random) -> bytes:
    kind = rng.randrange(5)
    if kind < 3:
        names = (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0")
        for name in names if kind == 0 else names[kind - 1:kind]:
            at = data.find(name)
            if at >= 0:
                x, y = (rng.choice((0, 0, 0, -5, 2**31 - 2, -(2**31))) for _ in range(2))
                w, h = (rng.choice(SIZES) for _ in range(2))
                box = (x, y, x + w - 1, y + h - 1)
                data[at + len(name) + 4:at + len(name) + 20] = b"".join(
                    struct.pack("<I", value % 2**32) for value in box)
    elif kind == 3:  # other tiles
        at = data.find(b"tiles\0tiledesc\0")
        if at >= 0:
            data[at + 19:at + 27] = struct.pack("<II", rng.choice(SIZES), rng.choice(SIZES))
    else:  # channels: another list
        at = data.find(b"channels\0chlist\0")
        if at >= 0:
            size = struct.unpack_from("<I", data, at + 16)[0]
            count = rng.choice((0, 1, 2, 5, 1000, 5000))
            entries = b"".join(f"{rng.choice(('c', 'R', ''))}{i}".encode() + b"\0" + struct.pack(
                "<IBBBBII", rng.choice((0, 1, 2, 3, 2**31)), 0, 0, 0, 0, rng.choice((1, 1, 2, 0)), 1)
                for i in range(count)) + b"\0"
            data[at + 16:at + 20 + size] = struct.pack("<I", len(entries)) + entries
    return bytes(data)


def _png(data: bytearray, rng: Random) -> bytes:
    """IHDR with a right checksum; its chunks follow."""
    header = bytearray(data[16:29])
    for at in rng.sample(range(7), rng.choice((1, 2))):
        if at < 2:
            header[4 * at:4 * at + 4] = struct.pack(">I", rng.choice(SIZES))
        else:
            header[6 + at] = rng.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
    data[16:29] = header
    data[29:33] = struct.pack(">I", binascii.crc32(b"IHDR" + bytes(header)))
    return bytes(data)


def _tiff(data: bytearray, rng: Random) -> bytes:
    """Values in the first directory."""
    order = "<" if data[:2] == b"II" else ">"
    first = struct.unpack_from(order + "I", data, 4)[0]
    if first + 2 > len(data):
        return bytes(data)
    count = struct.unpack_from(order + "H", data, first)[0]
    for at in (first + 2 + 12 * i for i in range(count)):
        if at + 12 > len(data):
            break
        tag = struct.unpack_from(order + "H", data, at)[0]
        odds = 0.4 if tag in (256, 257, 258, 259, 262, 277, 278, 279, 284, 322, 323, 339) else 0.05
        if rng.random() < odds * rng.random():
            data[at + 8:at + 12] = struct.pack(order + "I", rng.choice((*SIZES, 3, 4, 8, 64, 5000, 65_534)))
            if rng.random() < 0.2:
                data[at + 2:at + 8] = struct.pack(order + "HI", rng.randrange(20), rng.choice(SIZES))
    return bytes(data)


def _jpeg(data: bytearray, rng: Random) -> bytes:
    found = re.search(rb"\xff[\xc0-\xc2]", data)
    if found and found.start() + 10 < len(data):
        struct.pack_into(">HHB", data, found.start() + 5, rng.choice(SIZES) % 65536, rng.choice(SIZES) % 65536,
                         rng.choice((0, 1, 3, 4, 255)))
    return bytes(data)


def _hdr(data: bytearray, rng: Random) -> bytes:
    sizes = (f"{rng.choice('-+')}{a} {rng.choice((*SIZES, -1, 1e30, 'x'))}" for a in rng.choice(("YX", "XY", "YY")))
    return re.sub(rb"-Y \d+ \+X \d+", " ".join(sizes).encode(), bytes(data), count=1)


_LIARS: dict[str, Callable[[bytearray, Random], bytes]] = {
    ".exr": _exr, ".png": _png, ".tif": _tiff, ".jpg": _jpeg, ".hdr": _hdr}
