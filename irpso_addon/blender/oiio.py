"""Makes ``import OpenImageIO`` work wherever Blender runs.

Blender ships OpenImageIO in its own site-packages.  In the program that folder is on ``sys.path``; in
the ``bpy`` module from PyPI it is not.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import bpy


def ensure_openimageio() -> None:
    """Append Blender's own site-packages to ``sys.path`` when OpenImageIO cannot be found otherwise.

    Appended last, so that nothing the environment already has is replaced.
    """
    if importlib.util.find_spec("OpenImageIO") is not None:
        return
    bundled = Path(bpy.utils.resource_path("LOCAL")) / "python" / "lib"
    sys.path += [str(folder) for folder in sorted(bundled.glob("python3*/site-packages"))]
