"""One command of irpso, measured: ``python -m studies.budget.command RECORD STARTED COMMAND ...``.

STARTED: seconds since 1970 at which this process was started; what has passed since then is the start's.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from pathlib import Path


def main(record: Path, started: float, command: list[str]) -> int:
    """Run it; write where its seconds went."""
    from irpso_addon.__main__ import MODULES, WITHOUT_BLENDER
    from irpso_addon.__main__ import main as run
    from irpso_addon.cli import console
    from irpso_addon.core.reporting.report import peak_memory
    from studies.budget.instrument import START, instrumented, of_command
    from studies.budget.ledger import PYTHON, Ledger

    ledger, blender = Ledger(), command[0] not in WITHOUT_BLENDER
    if blender:
        with console.quiet():
            importlib.import_module("irpso_addon.blender.oiio").ensure_openimageio()
    importlib.import_module(f"irpso_addon.cli.{MODULES.get(command[0], command[0])}")
    with instrumented(ledger, of_command(blender)):
        ledger.seconds[START, PYTHON] += time.time() - started
        with ledger.lane():
            code = run(command)
    ledger.facts |= {"memory": peak_memory(), "ended": time.time()}
    record.write_text(json.dumps(ledger.record()), encoding="utf-8")
    return code


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), float(sys.argv[2]), sys.argv[3:]))
