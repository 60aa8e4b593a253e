"""One case: a folder to make it in, what is allowed, what came of it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any, Protocol

MEMORY = 400_000_000  # bytes that a case may take, unless it allows itself more


@dataclass
class Box:
    """The folder of a case.  ``out`` is where may be written; all else under ``root`` has to stay as it was made."""

    root: Path
    index: int = 0  # the case's number
    names: tuple[str, ...] = ()  # a refusal has to say one of them
    memory: int = MEMORY
    note: Callable[[str], None] = lambda _text: None  # "blender": Blender itself reads, its crash is not ours

    @property
    def given(self) -> Path:
        """Where the case's input lies: deep, so that '../../..' ends inside ``root``."""
        return self.root / "one" / "two" / "three" / "in"

    @property
    def out(self) -> Path:
        """Where may be written."""
        return self.root / "one" / "two" / "three" / "out"


class Kind(Protocol):
    """A module of ``kinds``."""

    def prepare(self, folder: Path) -> Any:
        """Once for each process: what the cases share."""

    def make(self, shared: Any, rng: Random, box: Box) -> Callable[[], None]:
        """The input of a case, and what is to be done with it: returns, or raises BadInput."""


@dataclass
class Outcome:
    """What came of a case; ``trouble`` is empty where all is well."""

    index: int
    verdict: str  # accepted, refused, crash, hang, blender
    message: str = ""  # of the refusal or the crash
    stray: list[str] = field(default_factory=list)  # what was written where nothing may be
    nameless: bool = False  # the message does not say which file or object, or has several lines
    memory: int = 0  # bytes more than before
    over: bool = False  # more of them than allowed
    seconds: float = 0.0

    @property
    def bad(self) -> bool:
        """Whether somebody has to look at it."""
        return self.verdict in {"crash", "hang"} or bool(self.stray) or self.nameless or self.over


def snapshot(root: Path, leave: Path) -> dict[str, tuple[int, int, int]]:
    """Kind and size, time of change and inode of everything under ``root`` but for what is in ``leave``."""
    found, waiting = {}, [str(root)]
    while waiting:
        with os.scandir(waiting.pop()) as entries:
            for entry in entries:
                if entry.path == str(leave):
                    continue
                told = entry.stat(follow_symlinks=False)
                is_folder = entry.is_dir(follow_symlinks=False)
                found[entry.path] = (told.st_mode, 0 if is_folder else told.st_size,
                                     0 if is_folder else told.st_mtime_ns)
                if is_folder:
                    waiting.append(entry.path)
    return found


def says(message: str, names: Sequence[str]) -> bool:
    """Whether a message is one line and says one of the names (or nothing is to be named).

    What cannot be printed is "?" in it.
    """
    printed = ("".join(letter if letter.isprintable() else "?" for letter in name) for name in names)
    return len(message.splitlines()) == 1 and (not names or any(name in message for name in printed))
