"""What every test may use: the checkout's root, and small scenes with references."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parents[1]
Irpso = Callable[..., subprocess.CompletedProcess[str]]

# The same examples in every run, so that a change alone can fail a test; --hypothesis-profile=default draws others.
settings.register_profile("same", derandomize=True)
settings.load_profile("same")


@pytest.fixture(scope="session")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that tests/support/make_scenes.py fills.  Read only: copy what a test is to change."""
    folder = tmp_path_factory.mktemp("scenes")
    program = ROOT / "tests" / "support" / "make_scenes.py"
    done = subprocess.run([sys.executable, str(program), str(folder)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="session")
def irpso() -> Irpso:
    """``irpso("solve", ...)``: the command line as a program of its own; further options go to subprocess.run."""

    def run(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "irpso_addon", *map(str, arguments)]
        return subprocess.run(command, **{
            "cwd": ROOT, "capture_output": True, "text": True, "timeout": 300, "stdin": subprocess.DEVNULL, **options})

    return run
