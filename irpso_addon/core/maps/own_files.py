"""Maps that were written here: known by their names, and by the description that each of them has."""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import BadInput
from ..images.image_file import open_image
from .export import KINDS, LAYERS
from .targets import TARGETS

_NAMES = [f"{{}}_{layer}" for layer in LAYERS] + [file.name for target in TARGETS.values() for file in target.files]
_NAME = re.compile("(?:" + "|".join(sorted({re.escape(name).replace(r"\{\}", ".+") for name in _NAMES}))
                   + r")(?:\.\d{4})?", re.DOTALL)


def is_own(path: Path) -> bool:
    """Whether the file is such a map, not a picture.  Opens those alone that are named like one."""
    if path.suffix.lower().lstrip(".") not in KINDS or not _NAME.fullmatch(path.stem):
        return False
    try:
        return open_image(path).own
    except BadInput:
        return False
