"""What the readers of JSON projects share."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..errors import BadInput
from ..storage.text_file import read_text
from .project import MOST_CAMERAS

LARGE = "write it without its points: in Meshroom, by ConvertSfMFormat with Structure off"


def read_object(path: Path) -> dict[str, Any]:
    """The JSON object in ``path``.  Raises BadInput."""
    try:
        content = json.loads(read_text(path, LARGE))
    except (ValueError, RecursionError):
        raise BadInput(f"{path}: is not complete JSON; write it again with the program it comes from") from None
    return content if isinstance(content, dict) else {}


def records(content: dict[str, Any], key: str, path: Path) -> list[dict[str, Any]]:
    """The objects listed under ``key``.  Raises BadInput."""
    found = content.get(key) or []  # AliceVision writes an empty list as ""
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise BadInput(f'{path}: "{key}" is not a list of objects; write it again with the program it comes from')
    if len(found) > MOST_CAMERAS:
        raise BadInput(f'{path}: "{key}" has more than {MOST_CAMERAS} entries; export fewer of them')
    return found


def text(value: object, who: str, what: str) -> str:
    """A text that has to be there.  Raises BadInput."""
    if not isinstance(value, str):
        raise BadInput(f"{who}: {what} is missing or not text; write it again with the program it comes from")
    return value
