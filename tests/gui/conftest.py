"""The Blender with a window that BLENDER names, with the built zip installed, and a scene that it can see."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from . import program, window


@pytest.fixture(scope="session")
def blender() -> window.Blender:
    """Skips where there is none; `make test-gui` sees to it that there is."""
    if not os.environ.get("BLENDER"):
        pytest.skip("BLENDER names no Blender with a window: use 'make test-gui'")
    return replace(program.blender(), plain=True)


@pytest.fixture(scope="session")
def ball() -> Path:
    """The folder of a small scene with references.  Read only."""
    return program.ball()


@pytest.fixture
def folder(request: pytest.FixtureRequest) -> Path:
    """A test's own: log, screenshots, what its Blender wrote.  Kept until the next run."""
    return window.WORK / "runs" / request.node.name.replace("[", "-").replace("]", "")
