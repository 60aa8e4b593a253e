"""Odd numbers, words, names and bytes: what every kind of case is made from.  ``rng`` decides everything."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from random import Random
from typing import Any

INTERESTING = (0, 1, -1, 2, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1)
NUMBERS = (0.0, -0.0, 1.0, -1.0, 1e-45, 1e-30, 1e-12, 1e12, 3.4e38, 1e300, -1e300, float("inf"), float("-inf"),
           float("nan"), 10**400, 2**63, 64.0, -64.0)
WORDS = (
    "", " ", ".", "..", "../../../escape", "..\\..\\escape", "/etc/passwd", "/dev/zero", "C:\\Windows\\x",
    "//host/share", "CON", "a" * 300, "a/" * 2500 + "b", "ü" * 100, "日本語.exr", "\u202egnp.exr", "e\u0301",
    "\U0001f3fa", "\x00", "a\nb", "a\tb", "\x7f", "\ud800", "%s%n%d", "{0}", "$(touch escape)", "`touch escape`",
    "; touch escape", "'\"",
    "<UDIM>", "a.%04d.exr", "refs/", "~", "~root", "-", "--help", "\ufeff", "NaN", "null", "true", "1e999",
)
DEVICES = ("/dev/null", "/dev/zero", "/dev/urandom", "/proc/self/environ", "/proc/self/mem", "/dev/stdin")


def number(rng: Random) -> float | int:
    """A number that few expect."""
    kind = rng.random()
    if kind < 0.6:
        return rng.choice(NUMBERS)
    if kind < 0.8:
        return rng.choice(INTERESTING)
    return float(struct.unpack("<d", rng.randbytes(8))[0])


def float32(rng: Random) -> float:
    """The same, of 32 bits."""
    if rng.random() < 0.7:
        return rng.choice((0.0, -0.0, 1e-45, 1e-30, 1e-6, 1.0, -1.0, 1e6, 1e30, 3.4e38, -3.4e38, float("inf"),
                           float("-inf"), float("nan"), rng.uniform(-10, 10)))
    return float(struct.unpack("<f", rng.randbytes(4))[0])


def word(rng: Random) -> str:
    """Text that few expect."""
    if rng.random() < 0.7:
        return rng.choice(WORDS)
    return "".join(chr(rng.choice((rng.randrange(32, 127), rng.randrange(0x20, 0xD7FF), rng.randrange(0x110000))))
                   for _ in range(rng.randrange(1, 40)))


def file_name(rng: Random, suffix: str = "") -> str:
    """A name that a file can have here."""
    name = rng.choice((
        "plain", "mit Leerzeichen", "größe", "日本語", "\U0001f3fa", "a" * 200, "ü" * 100, "e\u0301", "%s%n", "$(x)",
        "a;b", "-x", "#1", "a'b", 'a"b', "a.b.c", "a\nb", "null", "CON", "<UDIM>", "a%04d", "a?b=c",
        "x" * (255 - len(suffix)),
    ))
    return name + suffix


def value(rng: Random, depth: int = 0) -> Any:
    """Anything that JSON can say."""
    kind = rng.randrange(7 if depth < 3 else 5)
    if kind == 5:
        return [value(rng, depth + 1) for _ in range(rng.randrange(4))]
    if kind == 6:
        return {word(rng): value(rng, depth + 1) for _ in range(rng.randrange(4))}
    return (None, rng.random() < 0.5, number(rng), word(rng), rng.choice(INTERESTING))[kind]


def spoilt(data: bytes, rng: Random) -> bytes:
    """``data`` with one to some bytes flipped, cut, doubled, lost or overwritten."""
    content = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        if not content:
            break
        at = rng.randrange(len(content)) if rng.random() < 0.5 else rng.randrange(min(len(content), 600))
        kind = rng.randrange(7)
        if kind == 0:
            content[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            content[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
        elif kind == 2:
            del content[at:]
        elif kind == 3:
            del content[at:at + rng.randrange(1, 64)]
        elif kind == 4:
            content[at:at] = content[max(0, at - rng.randrange(1, 64)):at]
        elif kind == 5:
            width, order = rng.choice((("H", 2), ("I", 4), ("Q", 8))), rng.choice("<>")
            content[at:at + width[1]] = struct.pack(order + width[0], rng.choice(INTERESTING) % 256**width[1])
        else:
            content[at:at + 16] = rng.randbytes(16)
    return bytes(content)


def odd_place(path: Path, rng: Random) -> Path:
    """Something at ``path``, or another path, that is no plain file."""
    kind = rng.randrange(9)
    path.unlink(missing_ok=True)
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.mkdir()
    elif kind == 2:
        path.symlink_to(path.name)
    elif kind == 3:
        path.symlink_to("nowhere")
    elif kind == 4:
        path.symlink_to(rng.choice(DEVICES))
    elif kind == 5:
        return Path(rng.choice(DEVICES))
    elif kind == 6:
        return path.parent / ("d/" * rng.choice((100, 2500)) + path.name)
    elif kind == 7:
        return path.parent / ("n" * rng.choice((256, 5000)) + path.suffix)
    else:
        return path.parent / ".." / path.parent.name / path.name
    return path
