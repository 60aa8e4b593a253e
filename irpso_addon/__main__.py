"""The command line: ``python -m irpso_addon ...`` and ``blender -b --command irpso ...`` are the same.

Exit codes: 0 done, 1 unexpected error, 2 wrong usage, 3 bad input, 130 cancelled.
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import signal
import sys
import traceback
from pathlib import Path
from types import FrameType

from .cli import console, options
from .core import log
from .core.errors import BadInput, Cancelled, StoppedWithWork
from .core.reporting.report import peak_memory

MODULES = {"import": "import_shoot"}  # commands whose names are Python's own words
WITHOUT_BLENDER = ("tile", "merge")  # commands of a farm's workers, which have none


def main(argv: list[str]) -> int:
    """Run one command; returns the exit code and never raises."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # a pipe on Windows has the few letters of the system's language
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        arguments = options.parser().parse_args(argv, argparse.Namespace(given=argv))
    except SystemExit as stop:  # argparse has said why: 0 after --help, 2 after wrong usage
        return int(stop.code or 0)
    # Blender installs no handler for Ctrl-C that Python would hear of.  Until it is loaded, none may interrupt it.
    before = signal.signal(signal.SIGINT, _left)
    try:
        return _run(arguments)
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)


def _run(arguments: argparse.Namespace) -> int:
    try:
        if arguments.log is not None:
            _to_file(arguments.log)
        if arguments.verbose:
            log.to_stream(sys.stderr)
        # Imported here, because Blender's module takes a second to load and --help must not.
        blender = arguments.command not in WITHOUT_BLENDER
        if blender:
            _import_blender(arguments.command)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if blender:
            given = [log.name_alone(argument) for argument in arguments.given]
            importlib.import_module(".blender.logs", __package__).begin("command", arguments=given)
        module = MODULES.get(arguments.command, arguments.command)
        importlib.import_module(f".cli.{module}", __package__).run(arguments)
    except BadInput as error:
        log.failure("refused", error)
        console.warn(str(error))
        return 3
    except (Cancelled, KeyboardInterrupt) as stop:
        console.warn(f"cancelled; {_what_is_kept(stop)}")
        return 130
    except Exception as error:
        log.failure("bug", error)
        traceback.print_exc()
        console.warn("this is a bug: report the lines above and the output of 'irpso doctor'")
        return 1
    finally:
        log.info("end", peak_memory_bytes=peak_memory())
        log.close()
    return 0


def _left(number: int, frame: FrameType | None) -> None:
    """Ends the process at once, before anything was begun."""
    console.warn("cancelled; nothing was written")
    os._exit(130)


def _import_blender(command: str) -> None:
    """Raises BadInput where this Python has none."""
    try:
        with console.quiet():
            importlib.import_module(".blender.oiio", __package__).ensure_openimageio()
    except ModuleNotFoundError as error:
        if error.name != "bpy":
            raise
        raise BadInput(f"{command}: {sys.executable} has no Blender (module bpy); install bpy for this Python, or run "
                       f"blender -b --command irpso {command}") from None


def _what_is_kept(stop: Cancelled | KeyboardInterrupt) -> str:
    if isinstance(stop, StoppedWithWork):
        return (f"the plan and {stop.blocks} finished blocks are kept in {stop.folder}; the same command continues "
                "from them")
    if isinstance(stop, Cancelled) and stop.partial is not None:
        return "the maps found so far are kept"
    return "nothing was written"


def _to_file(path: Path) -> None:
    """The log there too.  Raises BadInput where that is impossible."""
    try:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | getattr(os, "O_NONBLOCK", 0), 0o666))  # a pipe nobody reads
    except OSError as error:
        raise BadInput(f"{path}: the log cannot be written ({error.strerror}); choose another place") from None
    log.to_file(path)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
