"""How code of this library starts in another Python process, and what such a process does first.

Every child imports the same copy of the library that its parent runs, whatever that is called in Blender.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import BinaryIO

PACKAGE = Path(__file__).resolve().parents[1]
NO_CONSOLE: int = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # creation flag on Windows


def code(module: str, *arguments: object, whole_path: bool = True) -> str:
    """Python code that calls ``main(*arguments)`` of ``module``, named below this package ("process.worker").

    ``whole_path``: give the child this process's import path.  A second Blender has its own; then only the library's
    folder is put before it.
    """
    path = [str(PACKAGE.parent), *(map(str, sys.path) if whole_path else ())]
    place = "sys.path[:]" if whole_path else "sys.path[:0]"
    call = ", ".join(map(repr, arguments))
    # Ctrl-C in a terminal is for the parent alone, which ends its children.
    return ("import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); "
            f"import sys, importlib; {place} = {path!r}; "
            f"importlib.import_module({f'{PACKAGE.name}.{module}'!r}).main({call})")


def python(program: str) -> list[str]:
    """The command line of an isolated Python that runs `code`."""
    return [sys.executable, "-I", "-c", program]


def take_stdin(buffering: int = -1) -> BinaryIO:
    """In the child: its standard input as a stream of its own; descriptor 0 reads nothing from now on.

    On Windows, libraries that look at standard input while they load would wait for whoever reads it.
    """
    stream = os.fdopen(os.dup(0), "rb", buffering=buffering)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    return stream


def take_stdout(buffering: int = -1) -> BinaryIO:
    """In the child: its standard output as a stream of its own; what libraries print goes to standard error."""
    stream = os.fdopen(os.dup(1), "wb", buffering=buffering)
    os.dup2(2, 1)
    return stream
