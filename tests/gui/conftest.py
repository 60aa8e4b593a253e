"""The Blender with a window that BLENDER names, with the built zip installed, and scenes that it can see."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from . import window


@pytest.fixture(scope="session")
def blender() -> window.Blender:
    """Skips where there is none; `make test-gui` sees to it that there is."""
    program = os.environ.get("BLENDER")
    if not program:
        pytest.skip("BLENDER names no Blender with a window: use 'make test-gui'")
    return window.installed(program)


@pytest.fixture(scope="session")
def ball(scenes: Path) -> Path:
    """The folder of tests/make_scenes.py's scene, where the window's Blender can read it."""
    copy = window.WORK / "ball"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(scenes / "good", copy)
    return copy


@pytest.fixture
def folder(request: pytest.FixtureRequest) -> Iterator[Path]:
    """A test's own: log, screenshots, what its Blender wrote.  Kept until the next run."""
    yield window.WORK / "runs" / request.node.name.replace("[", "-").replace("]", "")
