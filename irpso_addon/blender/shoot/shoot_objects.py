"""Cameras, flashes and views of a shoot in the open scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core.lens import Lens
from ...core.params import ShootSettings
from ...core.projection import FLIP
from ...core.shoot.picture_files import PictureFiles
from ...core.shoot.picture_lens import PictureCamera
from ..scene.camera_lens import write_lens

COLLECTION = "Shoot"
SPACES = {"file": "", "srgb": "sRGB", "linear": "Linear Rec.709"}
SHOWN = 0.1  # size of a camera in the viewport, project's units
CLIPPED = 100  # how many times nearer than the object is hidden, and how many times further

Objects = dict[str, bpy.types.Object]  # by the picture's name


def add_cameras(cameras: Sequence[PictureCamera], scale: float) -> Objects:
    """A camera object for each, in a collection of their own; those of one lens share their data."""
    collection = bpy.data.collections.new(COLLECTION)
    bpy.context.scene.collection.children.link(collection)
    blocks: dict[Lens, Any] = {}
    objects = {}
    for camera in cameras:
        lens = camera.lens
        if lens not in blocks:
            blocks[lens] = bpy.data.cameras.new(f"{lens.width} x {lens.height}, {lens.fx:.0f} pixels")
            write_lens(blocks[lens], lens)
            blocks[lens].display_size = SHOWN * scale
        obj = bpy.data.objects.new(Path(camera.name.replace("\\", "/")).stem, blocks[lens])
        matrix = camera.world_from_camera @ FLIP
        matrix[:3, 3] *= scale
        obj.matrix_world = Matrix(matrix)
        collection.objects.link(obj)
        objects[camera.name] = obj
    return objects


def show_mesh(objects: Objects, mesh: bpy.types.Object) -> None:
    """Cameras show, in the viewport and in renders of indirect light, what lies about as far away as ``mesh``.

    The default, 0.1 m to 1 km, hides what was photographed from a hand's breadth, and a project of many units.
    """
    corners = np.array([mesh.matrix_world @ Vector(corner) for corner in mesh.bound_box])
    away: dict[Any, list[float]] = {}
    for obj in objects.values():
        away.setdefault(obj.data, []).append(float(np.linalg.norm(np.array(obj.matrix_world)[:3, 3] - corners.mean(0))))
    for data, distances in away.items():
        data.clip_start, data.clip_end = min(distances) / CLIPPED, max(distances) * CLIPPED


def add_flashes(cameras: Sequence[PictureCamera], objects: Objects, settings: ShootSettings) -> Objects:
    """The one flash, hung on every camera: objects that share their light.

    Its offset is that from the camera's body, also where the camera was held upright.
    """
    light = bpy.data.lights.new("Flash", "POINT")
    light.energy = settings.flash_power or 1.0
    light.shadow_soft_size = settings.flash_size / 2000
    body = np.array([settings.flash_right, -settings.flash_above]) / 1000
    flashes = {}
    for camera in cameras:
        right, down = camera.upright_from_body @ body
        obj = objects[camera.name]
        flash = bpy.data.objects.new(f"Flash {obj.name}", light)
        flash.parent = obj
        flash.location = right, -down, -settings.flash_front / 1000
        # Hundreds of lamps at once would light the viewport, renders, and every view that names no lamp.
        flash.hide_viewport = flash.hide_render = True
        obj.users_collection[0].objects.link(flash)
        flashes[camera.name] = flash
    return flashes


def add_views(
    scene: bpy.types.Scene, cameras: Objects, flashes: Objects, pictures: PictureFiles, exposures: Mapping[str, float],
    colors: str,
) -> list[Any]:
    """A view for each camera, with absolute paths."""
    first = len(scene.irpso.views)
    for name, camera in cameras.items():
        view = scene.irpso.views.add()
        view.image, view.camera = str(pictures.files[name].resolve()), camera
        view.exposure, view.colorspace = exposures[name], SPACES[colors]
        if name in pictures.masks:
            view.mask = str(pictures.masks[name].resolve())
        if name in flashes:
            view.lights.add().light = flashes[name]
    return list(scene.irpso.views)[first:]
