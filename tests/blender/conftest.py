"""What the Blender tests share: an empty file for each test, and the checkout loaded as the extension."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

bpy = pytest.importorskip("bpy")


@pytest.fixture
def empty():
    """The current scene of an empty file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


@pytest.fixture(scope="session")
def extension():
    """The checkout as Blender loads an extension: one package, whose name is not ours to choose.

    Its modules are ``irpso_ext.irpso_addon...``: never mix them with ``irpso_addon...`` in one test.
    """
    spec = importlib.util.spec_from_file_location(
        "irpso_ext", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules["irpso_ext"] = package
    spec.loader.exec_module(package)
    package.register()
    yield package
    package.unregister()
