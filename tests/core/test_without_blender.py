"""The command line of a Python that has no Blender."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_a_command_says_that_blender_is_missing() -> None:
    """In one line, with the code of bad input."""
    code = ("import sys; sys.modules['bpy'] = None\n"
            "from irpso_addon.__main__ import main; sys.exit(main(['doctor']))")
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    line, = done.stderr.splitlines()
    assert done.returncode == 3 and done.stdout == ""
    assert line.startswith("irpso: doctor: ") and line.endswith(
        "has no Blender (module bpy); install bpy for this Python, or run blender -b --command irpso doctor")
