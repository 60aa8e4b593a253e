"""Images that the add-on shows and no file keeps: packed, so that they have no unsaved pixels and outlive an undo."""

from __future__ import annotations

from pathlib import Path

import bpy


def still_image(name: str) -> bpy.types.Image | None:
    """The one of this name, where there is one."""
    return next((image for image in bpy.data.images if image.name == name and image.is_runtime_data), None)


def load_still(name: str, path: Path) -> bpy.types.Image:
    """The file's picture as the image of this name; the file may go after it."""
    found = still_image(name)
    if found is None:
        found = bpy.data.images.load(str(path))
        found.name, found.is_runtime_data = name, True
    else:
        found.unpack(method="REMOVE")
        found.filepath = str(path)
        found.reload()
    found.pack()
    found.filepath = ""
    return found
