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
BLEND, PICTURE, BRIGHT = "world.blend", "world.exr", "bright.exr"
BRIGHTER = 20.0  # times the mean: pixels that are rendered again, with all others of their rectangle
MOST_AGAIN, MOST_SAMPLES = 1 << 22, 1024  # samples of that rectangle, and of a pixel in it


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
        return seen(folder)


def seen(folder: Path) -> F32:
    """What has been rendered: of a pixel that was rendered twice, the second."""
    import OpenImageIO

    found = np.zeros((HEIGHT, 2 * HEIGHT, 3), np.float32)
    for name in (PICTURE, BRIGHT):
        if (folder / name).exists():
            pixels = OpenImageIO.ImageBuf(str(folder / name)).get_pixels(OpenImageIO.FLOAT)[::-1]
            there = pixels[..., 3] > 0
            found[there] = pixels[there, :3]
    return np.where(np.isfinite(found) & (found > 0), found, np.float32(0))


def bright_part(picture: F32) -> tuple[tuple[int, int, int, int], int] | None:
    """Left, bottom, right and top of the small lights in a picture, and samples for its pixels; None: it has none.

    A sun is as small as two pixels, whose few samples do not tell how much of them it covers.
    """
    weight = np.cos(np.pi * ((np.arange(HEIGHT) + 0.5) / HEIGHT - 0.5))[:, None]
    light = picture.max(-1)
    rows, columns = np.nonzero(light > BRIGHTER * float((light * weight).sum() / (weight.sum() * light.shape[1])))
    if not len(rows):
        return None
    left, right = max(0, int(columns.min()) - 2), min(2 * HEIGHT, int(columns.max()) + 3)
    bottom, top = max(0, int(rows.min()) - 2), min(HEIGHT, int(rows.max()) + 3)
    samples = min(MOST_SAMPLES, MOST_AGAIN // ((right - left) * (top - bottom)))
    return ((left, bottom, right, top), samples) if samples > SAMPLES else None
