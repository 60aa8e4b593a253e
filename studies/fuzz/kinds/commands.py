"""Command lines: odd words and numbers for every argument; whatever they are, it ends with one of the exit codes."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import os
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

from irpso_addon.__main__ import MODULES, main
from irpso_addon.cli import options
from irpso_addon.core.errors import BadInput

from .. import spoil
from ..case import Box

# These go on for long once all is well with what they were given.
LONG = ("demo", "doctor")
WRITTEN = {"out", "log", "report"}


def prepare(_folder: Path) -> dict[str, list[argparse.Action]]:
    """The arguments of each command, all of which are loaded: Blender's module takes seconds."""
    top = options.parser()
    commands = next(action for action in top._actions if isinstance(action, argparse._SubParsersAction))
    for name in commands.choices:
        importlib.import_module(f"irpso_addon.cli.{MODULES.get(name, name)}")
    return {name: parser._actions for name, parser in commands.choices.items()}


def make(shared: dict[str, list[argparse.Action]], rng: Random, box: Box) -> Callable[[], None]:
    """A command with some of its arguments, more or less as they should be; there is nothing that it could solve."""
    command = rng.choice(sorted(shared))
    words = [command] if rng.random() < 0.98 else [spoil.word(rng)]
    for action in shared[command]:
        if action.option_strings and rng.random() < 0.75:
            continue
        if action.option_strings:
            words.append(rng.choice(action.option_strings))
        if action.nargs != 0:
            words.append(_value(action, rng, box))
    if rng.random() < 0.05:
        words.insert(rng.randrange(len(words) + 1), spoil.word(rng))
    if command in LONG:
        words.append("--no-such-option")
    return partial(run, [word.replace("\0", "") for word in words])


def _value(action: argparse.Action, rng: Random, box: Box) -> str:
    kind = rng.random()
    if kind < 0.3 and action.choices:
        return str(rng.choice(list(action.choices)))
    if kind < 0.3 or action.type is Path or action.dest in {"scene", "work"}:
        return _path(rng, box.out if action.dest in WRITTEN else box.given, box.out)
    if kind < 0.6:
        return str(spoil.number(rng)) if rng.random() < 0.99 else "9" * 6000
    return spoil.word(rng)


def _path(rng: Random, folder: Path, out: Path) -> str:
    """A path to something that is no scene, or to nothing, in ``folder``."""
    path = folder / spoil.file_name(rng, rng.choice((".blend", ".json", "")))
    kind = rng.randrange(6)
    if kind == 0:
        data = rng.choice((b"BLENDER", b"", b"{}", rng.randbytes(40), b"\x28\xb5\x2f\xfd1234"))
        with contextlib.suppress(OSError):  # an argument before this one has made something else there
            path.write_bytes(data)
    elif kind == 1:
        path = spoil.odd_place(path, rng)
    elif kind == 2:
        path = folder / os.fsdecode(bytes(b for b in rng.randbytes(10) if b not in b"/\0"))
    elif kind == 3:
        path = out
    return str(path)


def run(words: list[str]) -> None:
    """As the shell calls it.  Refused is what ends with 2 or 3."""
    said = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="backslashreplace")  # as Python's own stderr
    told: Any = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # and stdout
    with redirect_stderr(said), redirect_stdout(told):
        code = main(words)
    said.flush()
    told.flush()
    logged = said.buffer.getvalue().decode().splitlines()
    errors = "\n".join(line for line in logged if not line.startswith("{"))  # --verbose: JSON
    assert code in {0, 2, 3}, f"exit code {code}: {words}\n{errors}"
    assert "Traceback" not in errors, errors
    if code == 3:
        lines = [line for line in errors.splitlines() if line.startswith("irpso: ")]
        assert len(lines) == len(errors.splitlines()), errors
        raise BadInput(lines[-1])
    if code == 2:
        raise BadInput(errors.splitlines()[-1] if errors else "wrong usage")
