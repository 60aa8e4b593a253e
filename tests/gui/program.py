"""What the commands of this folder and its tests share: the Blender that BLENDER names, and the scenes it sees."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from . import window


def blender() -> window.Blender:
    """With the add-on installed.  Ends the program where there is none."""
    program = os.environ.get("BLENDER")
    if not program:
        raise SystemExit("BLENDER names no Blender with a window: BLENDER=$(bash tools/gui_setup.sh)")
    return window.installed(program)


def ball() -> Path:
    """The folder of tests/support/make_scenes.py's scene, where the window's Blender can read it."""
    made = window.WORK / "scenes"
    shutil.rmtree(made, ignore_errors=True)
    done = subprocess.run([sys.executable, str(window.ROOT / "tests" / "support" / "make_scenes.py"), str(made)],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return made / "good"
