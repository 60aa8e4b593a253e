"""A second Blender, which works while the first one's window lives: how one is started, watched and ended.

Imports where there is no ``bpy``: a worker process starts a child too.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from ..core import child_process
from ..core.job import Progress

ERRORS, PROGRESS = "errors", "progress.json"  # in the child's folder: what it said on stderr, how far it is


def command() -> tuple[str, ...]:
    """Starts a Blender that runs the Python code that follows.  Only callable in Blender."""
    import bpy

    if bpy.app.module:
        return (sys.executable, "-c")
    return (bpy.app.binary_path, "--background", "--factory-startup", "--python-exit-code", "1", "--python-expr")


class Child:
    """A Blender at work in ``folder``.  It ends itself when its standard input does."""

    def __init__(self, command: tuple[str, ...], module: str, folder: Path) -> None:
        """``module``, named below this package: its ``main(folder)`` runs in the child, through `as_child`."""
        code = child_process.code(module, str(folder), whole_path=False)
        self.folder = folder
        with open(folder / ERRORS, "wb") as errors:
            self._process = subprocess.Popen([*command, code], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                                             stderr=errors, cwd=folder, creationflags=child_process.NO_CONSOLE)

    @property
    def status(self) -> int | None:
        """Its exit status; None while it works."""
        return self._process.poll()

    def end(self) -> None:
        """Ends it, whatever it does."""
        self._process.kill()
        self._process.wait()
        assert self._process.stdin is not None
        self._process.stdin.close()

    def progress(self) -> Progress | None:
        """What it last told; None: nothing."""
        try:
            told = json.loads((self.folder / PROGRESS).read_text(encoding="utf-8"))
        except OSError:  # not there, or being replaced
            return None
        return Progress(told["fraction"], told["stage"], told["message"])

    def last_line(self) -> str:
        """What it said last, if it failed."""
        lines = (self.folder / ERRORS).read_text(encoding="utf-8", errors="replace").split("\n")
        told = [line.strip() for line in lines if line.strip()]
        return told[-1][:200] if told else "it ended without a message"


def tell(folder: Path, progress: Progress) -> None:
    """In the child: how far it is."""
    fresh = folder / f"{PROGRESS}.new"
    told = {"fraction": progress.fraction, "stage": progress.stage, "message": progress.message}
    fresh.write_text(json.dumps(told), encoding="utf-8")
    with suppress(PermissionError):  # on Windows, while the window reads it; the next one will do
        os.replace(fresh, folder / PROGRESS)


def as_child(work: Callable[[], None]) -> None:
    """In the child: does the work and ends the process; says in one line on stderr why it could not."""
    from .files import one_line

    parent = child_process.take_stdin(buffering=0)
    threading.Thread(target=_end_with_parent, args=(parent,), daemon=True).start()
    status = 0
    try:
        work()
    except Exception as error:
        print(one_line(error) or repr(error), file=sys.stderr, flush=True)
        status = 1
    os._exit(status)  # an orderly end hangs in Blender 4.5 while the thread reads


def _end_with_parent(parent: BinaryIO) -> None:
    """``parent`` is a pipe that nobody writes to: it ends when the parent is gone."""
    parent.read(1)
    os._exit(1)
