"""The command line: ``python -m irpso_addon ...`` and ``blender -b --command irpso ...`` are the same.

Exit codes: 0 done, 1 unexpected error, 2 wrong usage, 3 bad input, 130 cancelled.
"""

from __future__ import annotations

import argparse
import importlib
import signal
import sys
import traceback

from .cli import console, options
from .core.errors import BadInput, Cancelled

WITHOUT_BLENDER = ("tile", "merge")  # commands of a farm's workers, which have none


def main(argv: list[str]) -> int:
    """Run one command; returns the exit code and never raises."""
    try:
        arguments = options.parser().parse_args(argv)
    except SystemExit as stop:  # argparse has said why: 0 after --help, 2 after wrong usage
        return int(stop.code or 0)
    # Blender installs no handler for Ctrl-C that Python would hear of.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return _run(arguments)
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)


def _run(arguments: argparse.Namespace) -> int:
    try:
        # Imported here, because Blender's module takes a second to load and --help must not.
        if arguments.command not in WITHOUT_BLENDER:
            with console.quiet():
                importlib.import_module(".blender.oiio", __package__).ensure_openimageio()
        importlib.import_module(f".cli.{arguments.command}", __package__).run(arguments)
    except BadInput as error:
        console.warn(str(error))
        return 3
    except (Cancelled, KeyboardInterrupt) as stop:
        kept = getattr(stop, "partial", None) is not None
        console.warn("cancelled; the maps found until then are kept" if kept else "cancelled; nothing was written")
        return 130
    except Exception:
        traceback.print_exc()
        console.warn("this is a bug: please report the lines above")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
