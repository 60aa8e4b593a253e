"""The synthetic plane over two UDIM squares, with its pictures in files, as large solves and farms take it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from irpso_addon.core.data import SceneData
from irpso_addon.core.images.image_writer import write_image
from tests.support import synthetic as syn

MARGIN, WIDTH = syn.MARGIN, 1 - 2 * syn.MARGIN


def write_scene(folder: Path, cameras: int = 2, lamps: int = 4, pixels: int = 72) -> SceneData:
    """The plane's left half in UDIM 1001, its right half in 1002; a picture of each camera with each lamp."""
    mesh = syn.plane_mesh()
    right = mesh.uvs[..., 0].mean(axis=1) > 0.5
    uvs = mesh.uvs.copy()
    uvs[..., 0] = MARGIN + (uvs[..., 0] - np.where(right, 0.5, MARGIN)[:, None]) * 2 + right[:, None]
    rig = [(camera, [lamp]) for camera in syn.cameras(cameras) for lamp in syn.lamps(lamps)]
    shoot = syn.shoot(syn.PATCHES, rig, (pixels, pixels), mesh=replace(mesh, uvs=uvs))
    folder.mkdir(parents=True, exist_ok=True)
    views = []
    for view in shoot.scene.views:
        path = folder / view.image.name
        write_image(path, shoot.images[view.image.name].rgb, kind="exr", color=True)
        views.append(replace(view, image=path))
    return replace(shoot.scene, views=tuple(views))
