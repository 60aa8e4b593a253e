"""The command line of a Python that has no Blender, and of one whose output cannot hold every letter."""

from __future__ import annotations

import os
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


def test_a_pipe_that_lacks_letters_fails_no_task(tmp_path: Path) -> None:
    """Of a farm's worker on Windows, whose language is another than that of a folder's name."""
    done = subprocess.run([sys.executable, "-m", "irpso_addon", "merge", str(tmp_path / "日本"), "--udim", "1001",
                           "--out", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, encoding="cp1252",
                          env={**os.environ, "PYTHONIOENCODING": "cp1252"})
    line, = done.stdout.splitlines()
    assert done.returncode == 3, done.stderr
    assert line.startswith("openjd_fail: ") and r"\u65e5\u672c: is not" in line
