"""A process that runs cases: ``python -m studies.fuzz.worker KIND SEED FOLDER``; asked and answering in lines of JSON.

Whatever the cases do to it, the process that asks survives (drive.py).
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import shutil
import stat
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from random import Random
from typing import Any

from .case import Box, Outcome, says, snapshot

ADDRESS_SPACE = 12_000_000_000  # bytes: more, and the machine would suffer
_WRITES = {"os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate", "os.chmod",
           "shutil.rmtree", "shutil.move", "shutil.copyfile"}

_watched: list[str] | None = None  # what Python wrote, and where; None: nobody asks


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    """Hears of every file that Python opens or moves.  (What libraries write themselves, the snapshots tell.)"""
    if _watched is None:
        return
    if event == "open":
        path, mode, flags = arguments
        writes = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC) if isinstance(flags, int) else False
        if isinstance(mode, str):
            writes = any(letter in mode for letter in "wax+")
        if writes and isinstance(path, (str, bytes)):
            _watched.append(os.fsdecode(path))
    elif event in _WRITES and not any(isinstance(a, int) and a >= 0 for a in arguments[1:]):  # relative to a folder
        _watched.extend(os.fsdecode(a) for a in arguments[:2] if isinstance(a, (str, bytes)))


@contextlib.contextmanager
def _watching() -> Iterator[list[str]]:
    global _watched
    _watched = written = []
    try:
        yield written
    finally:
        _watched = None


def run_case(
    kind: str, shared: Any, rng: Random, index: int, root: Path, note: Any = None, keep: bool = False,
) -> Outcome:
    """Makes and runs one case in the folder ``root``, which is emptied before and after."""
    from irpso_addon.core.errors import BadInput

    box = Box(root, index)
    box.note = note or box.note
    _empty(box)
    tempfile.tempdir = str(root / "tmp")
    module = importlib.import_module(f".kinds.{kind}", __package__)
    action = module.make(shared, rng, box)
    before, start_memory = snapshot(root, box.out), _forget_peaks()
    begun, started = time.time(), time.monotonic()
    outcome = Outcome(index, "accepted")
    with _watching() as written:
        try:
            action()
        except BadInput as error:
            outcome.verdict, outcome.message = "refused", str(error)
            outcome.nameless = not says(outcome.message, box.names)
        except BaseException as error:  # also MemoryError, SystemExit: nothing else may come out
            if isinstance(error, KeyboardInterrupt):
                raise
            outcome.verdict, outcome.message = "crash", traceback.format_exc()
    outcome.seconds = time.monotonic() - started
    outcome.memory = max(0, _peaks() - start_memory)
    outcome.over = outcome.memory > box.memory
    after = snapshot(root, box.out)
    outcome.stray = sorted(path for path in before.keys() | after.keys() if before.get(path) != after.get(path))
    log = os.path.join(os.path.expanduser("~"), ".config", "blender")  # where Blender keeps what it is told to keep
    allowed = (str(box.out), str(root / "tmp"), log)
    outcome.stray += [path for path in map(os.path.realpath, written)
                      if not path.startswith((*allowed, "/proc/")) and path not in before and _touched(path, begun)]
    if outcome.stray and not keep:
        shutil.rmtree(root)
    return outcome


def _touched(path: str, since: float) -> bool:
    """Whether a file was really written, or came and went: to ask for it may have been in vain."""
    with contextlib.suppress(OSError):
        told = os.stat(path)
        return stat.S_ISREG(told.st_mode) and told.st_mtime > since - 0.1
    with contextlib.suppress(OSError):
        return os.stat(os.path.dirname(path)).st_mtime > since - 0.1
    return False


def random_of(kind: str, seed: int, index: int) -> Random:
    """What decides a case."""
    return Random(f"{seed} {kind} {index}")


def _empty(box: Box) -> None:
    """The folders of a case, without anything in them."""
    for folder in (box.given, box.out, box.root / "tmp"):
        try:
            entries = list(os.scandir(folder))
        except FileNotFoundError:
            folder.mkdir(parents=True)
            continue
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path)
            else:
                os.unlink(entry.path)


def _processes() -> list[str]:
    """This process and its children (of the thread that runs cases; where Linux tells)."""
    try:
        with open(f"/proc/self/task/{os.getpid()}/children", "rb") as file:
            return ["self", *file.read().decode().split()]
    except OSError:
        return ["self"]


def _field(process: str, name: bytes) -> int:
    try:
        with open(f"/proc/{process}/status", "rb") as file:
            status = file.read()
        return 1024 * int(status[status.index(name) + len(name):].split(maxsplit=1)[0])
    except (OSError, ValueError):
        return 0


def _forget_peaks() -> int:
    """Begins to measure; bytes now."""
    total = 0
    for process in _processes():
        with contextlib.suppress(OSError), open(f"/proc/{process}/clear_refs", "wb", buffering=0) as file:
            file.write(b"5")
        total += _field(process, b"VmRSS:")
    return total


def _peaks() -> int:
    return sum(_field(process, b"VmHWM:") for process in _processes())


def main(kind: str, seed: int, folder: Path) -> None:
    """Asked on stdin "first last", answers an Outcome for each."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)

    def answer(**what: Any) -> None:
        print(json.dumps(what), file=answers, flush=True)

    with contextlib.suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, resource.getrlimit(resource.RLIMIT_AS)[1]))
    sys.addaudithook(_hook)
    shared = importlib.import_module(f".kinds.{kind}", __package__).prepare(folder)
    answer(ready=True)
    for line in sys.stdin:
        first, last = map(int, line.split())
        for index in range(first, last):
            outcome = run_case(kind, shared, random_of(kind, seed, index), index, folder / "box",
                               lambda text: answer(note=text))
            answer(**asdict(outcome))
    os._exit(0)  # Blender's module may take its time to end, or crash in it


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
