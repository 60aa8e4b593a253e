"""Files that somebody else wrote, or their beginnings."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from ..errors import BadInput

UTF16 = (b"\xff\xfe", b"\xfe\xff")  # its byte order marks
MOST = 64_000_000  # bytes: no list of views is as long


def read_text(path: Path, remedy: str = "check whether it is the right file") -> str:
    """A file's text (UTF-8, a byte order mark left out).  Raises BadInput; ``remedy``: of a file too large."""
    data = first_bytes(path, MOST + 1)
    if len(data) > MOST:
        raise BadInput(f"{path}: is larger than {MOST // 1_000_000} MB; {remedy}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput(f"{path}: is not UTF-8 text; save it as such") from None


def first_bytes(path: Path, count: int) -> bytes:
    """At most so many bytes of a file.  Raises BadInput; never waits, as opening a pipe would."""
    with opened(path) as file:
        return file.read(count)


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """A file, to be read piece by piece; what goes wrong on the way is a BadInput too."""
    try:
        with open(path, "rb", opener=_opener) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise BadInput(f"{path}: is not a file; check the path")
            yield file
    except OSError as error:
        raise BadInput(f"{path}: cannot be opened ({error.strerror}); check the path") from None
    except ValueError:  # a path with a zero byte, or letters that no path can have
        raise BadInput(f"{path}: is not a path; check it") from None


def _opener(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
