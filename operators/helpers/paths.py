"""Where the panel says files are and go."""

from pathlib import Path

import bpy

from ...irpso_addon.core.errors import BadInput


def captures_path(scene: bpy.types.Scene) -> Path | None:
    """The panel's captures.json as an absolute path; None: the scene's own views are used."""
    text = scene.irpso.captures
    return Path(absolute(text)) if text else None


def absolute(text: str) -> str:
    """``text`` without Blender's leading ``//``.  Raises BadInput where that means nothing yet."""
    if text.startswith("//") and not bpy.data.filepath:
        raise BadInput(f"{text}: is relative to a .blend that was never saved; save it, or choose another path")
    return bpy.path.abspath(text)


def out_folder(text: str) -> Path:
    """Where files go.  Raises BadInput as `absolute`, and where no folder is named."""
    if not text.strip():  # Python would take it for the folder in which Blender was started
        raise BadInput("Folder: is empty; enter one, such as //irpso")
    return Path(absolute(text))


def stored(path: Path | None) -> str:
    """As the .blend stores a path: relative to itself where it has a place; "" for none."""
    if path is None:
        return ""
    text = str(path.resolve())
    try:
        return bpy.path.relpath(text) if bpy.data.filepath else text
    except ValueError:  # on another drive
        return text
