"""Maps and truth under a lamp and from a camera that no picture had."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO

from irpso_addon.blender import files
from irpso_addon.core.data import F32, F64, Maps
from irpso_addon.core.images import colour
from studies.environment import shoot
from studies.intervals.assets import Asset, truth

PLACE = (1.6, -3.0, 1.2)  # of the lamp, metres
SIDE = math.radians(22), 0.45  # of the camera: about the object, and above the horizon
PIXELS, SAMPLES = 256, 64
WHITE = 99.5  # per cent of the true picture that are darker than a display's white


def relit(blend: Path, asset: Asset, maps: Maps) -> float:
    """PSNR, dB, of the display's values of all pixels that show the object alone."""
    size = len(maps.roughness)
    with tempfile.TemporaryDirectory() as folder:
        true, solved = (_picture(blend, base, rough, Path(folder) / "a.exr")
                        for base, rough in (truth(asset, size), (maps.base_color, maps.roughness)))
    inside = true[..., 3] > 0.999
    white = float(np.percentile(true[inside][:, :3], WHITE))
    first, second = (colour.linear_to_srgb(np.clip(of[inside][:, :3] / white, 0, 1)) for of in (true, solved))
    return float(-10 * np.log10(np.mean((first - second) ** 2)))


def _picture(blend: Path, base: F32, roughness: F32, path: Path) -> F64:
    files.open_blend(blend)
    scene = bpy.context.scene
    scene.world = None
    for other in [o for o in bpy.data.objects if o.type == "LIGHT"]:
        bpy.data.objects.remove(other)
    subject = bpy.data.objects[shoot.NAME]
    subject.material_slots[0].material = shoot.painted_with(base, roughness)
    shoot.lamp("New Lamp", PLACE)
    scene.camera = shoot.camera("New Camera", *SIDE)
    scene.render.resolution_x = scene.render.resolution_y = PIXELS
    scene.cycles.samples = SAMPLES
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return np.asarray(OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.FLOAT), np.float64)
