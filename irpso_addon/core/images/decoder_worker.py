"""The process in which image files are decoded (decoder_pool.py starts it).

It reads a JSON list per line from standard input, and answers in JSON lines on standard output:

    ["header", path, full]                                {"header": {...}}
    ["bands", path, picture, first, last, at_once]        {"rows": n} and the array's bytes, ..., {"end": true}

or {"wrong": message} for the user, {"failed": message} for us; {"ready": true} is its first word.  The arguments of
"bands" are those of `oiio_reader.bands` and `raw_reader.bands`, the picture a list of its fields; "full" is that of
`raw_reader.header`.  The end of standard
input ends the process.
"""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
import traceback
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from ..child_process import take_stdin, take_stdout
from ..errors import BadInput

THREADS = 4  # that decode, at most: each takes memory


def main(memory: int) -> None:
    """Serve until standard input ends; hold at most ``memory`` bytes."""
    answers = take_stdout()
    _limit(memory)
    orders: queue.SimpleQueue[list[Any]] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(take_stdin(), orders), daemon=True).start()
    try:
        os.environ["OPENBLAS_NUM_THREADS"] = "1"  # numpy's, which takes memory for each
        import OpenImageIO

        for name in ("threads", "exr_threads"):
            OpenImageIO.attribute(name, min(THREADS, os.cpu_count() or 1))
        _answer(answers, ready=True)
    except ImportError as error:
        _answer(answers, failed=f"OpenImageIO cannot be loaded: {error}")
        os._exit(1)
    while True:
        order, path, *rest = orders.get()
        try:
            _serve(answers, order, Path(path), rest)
        except BrokenPipeError:
            os._exit(0)
        except BadInput as wrong:
            _answer(answers, wrong=str(wrong))
        except MemoryError:
            _answer(answers, wrong=f"{path}: cannot be read (it is too large for memory); save it smaller")
        except Exception as error:  # of the library's binding, about what the file holds
            traceback.print_exc()
            _answer(answers, wrong=f"{path}: cannot be read ({type(error).__name__}); save it again")


def _limit(memory: int) -> None:
    if sys.platform == "win32":
        return
    import resource

    # Linux counts as data what is really taken; the address space would count what libraries reserve.
    for what, most in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_DATA, memory)):
        with suppress(ValueError, OSError):  # a lower limit holds already
            resource.setrlimit(what, (most, most))


def _listen(stdin: IO[bytes], orders: queue.SimpleQueue[list[Any]]) -> None:
    """A thread, because a decoder may be stuck while Blender goes."""
    for line in stdin:
        orders.put(json.loads(line))
    os._exit(0)


def _serve(answers: IO[bytes], order: str, path: Path, rest: list[Any]) -> None:
    from . import oiio_reader, raw_reader

    reader = raw_reader if raw_reader.is_raw(path) else oiio_reader
    if order == "header":
        (full,) = rest
        _answer(answers, header=raw_reader.header(path, full) if reader is raw_reader else oiio_reader.header(path))
        return
    (part, channels, form, size), first, last, at_once = rest
    picture = oiio_reader.StoredPicture(part, tuple(channels), form, tuple(size))
    for band in reader.bands(path, picture, first, last, at_once):
        for row in range(0, len(band), step := max(1, at_once // band.shape[1])):  # rows of tiles may be tall
            piece = band[row:row + step]
            _answer(answers, rows=len(piece))
            answers.write(memoryview(piece).cast("B"))
    _answer(answers, end=True)


def _answer(answers: IO[bytes], **message: object) -> None:
    answers.write(json.dumps(message).encode() + b"\n")
    answers.flush()
