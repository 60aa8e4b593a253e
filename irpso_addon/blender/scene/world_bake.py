"""A world of any nodes as a picture: rendered once by a second Blender, with a panoramic camera.

The open file stays as it is: the world alone is written to a small file.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from ...core.data import F32
from ...core.errors import BadInput
from .. import second_blender

HEIGHT, SAMPLES = 512, 4
PATIENCE = 120.0  # seconds
BLEND, PICTURE = "world.blend", "world.exr"


def baked(world: Any) -> F32:
    """(HEIGHT, 2 HEIGHT, 3) linear, row 0 at the bottom.  Only on the main thread.  Raises BadInput."""
    import bpy

    with tempfile.TemporaryDirectory(prefix="irpso-world-") as name:
        folder = Path(name)
        bpy.data.libraries.write(str(folder / BLEND), {world}, path_remap="ABSOLUTE", fake_user=True)
        child = second_blender.Child(second_blender.command(), "blender.scene.world_bake_child", folder)
        try:
            end = time.monotonic() + PATIENCE
            while child.status is None and time.monotonic() < end:
                time.sleep(0.05)
            if child.status != 0:
                why = child.last_line() if child.status is not None else f"it took longer than {PATIENCE:.0f} s"
                raise BadInput(f"world '{world.name}': cannot be rendered ({why}); change its nodes, or use an "
                               "Environment Texture or a plain color")
        finally:
            child.end()
        return _read(folder / PICTURE)


def _read(path: Path) -> F32:
    import OpenImageIO

    pixels = OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.FLOAT)
    rgb = np.asarray(pixels[::-1, :, :3], np.float32)
    return np.where(np.isfinite(rgb) & (rgb > 0), rgb, np.float32(0))
