"""Where the log (core/log.py) lies: in the user's configuration folder, beside what is learnt of speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ..core import log
from ..core.versions import versions
from .files import blender_version


def path() -> Path:
    """The file."""
    return Path(bpy.utils.user_resource("CONFIG")) / log.FILE


def begin(what: str, **fields: Any) -> None:
    """Something begins: with which versions."""
    log.to_file(path())
    log.info(what, **fields, **versions(), blender=blender_version(), window=not bpy.app.background)
