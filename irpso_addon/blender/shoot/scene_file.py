"""Cameras out of an Alembic or USD file: Blender's importers bring them into a scene that goes again."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.errors import BadInput
from ...core.shoot.scene_cameras import ALEMBIC, FilmCamera, SceneCamera, SceneFile, numbered, plain
from . import rollback

NOWHERE = 1_000_000  # a frame that no file begins at


def read_scene_file(path: Path, pictures: list[str]) -> SceneFile:
    """The cameras of ``path``, and whether it has a mesh; ``pictures``: stems of all that are in the folder.

    Nothing of it stays in the open file.  Raises BadInput.
    """
    if not path.is_file():
        raise BadInput(f"{path}: file not found; choose the file that the cameras were exported to")
    with _own_scene() as scene:
        try:
            with redirect_stderr(io.StringIO()), bpy.context.temp_override(
                    scene=scene, view_layer=scene.view_layers[0], collection=scene.collection):
                _bring(path)
        except (RuntimeError, AttributeError) as error:
            why = (str(error).strip().splitlines() or ["unknown error"])[-1].removeprefix("Error: ")
            raise BadInput(f"{path}: Blender cannot read it ({why}); export the cameras again") from None
        if not scene.objects:
            raise BadInput(f"{path}: Blender cannot read it, or nothing is in it; export the cameras again")
        cameras = sorted((obj for obj in scene.objects if obj.type == "CAMERA"), key=lambda obj: obj.name)
        ranged = scene.frame_start != NOWHERE
        frames = (scene.frame_start, scene.frame_end) if ranged else (0, 0)
        scene.frame_set(frames[0])
        found = [SceneCamera(_names(obj), _film(scene, obj)) for obj in cameras]
        if len(found) == 1 and ranged and frames[1] > frames[0]:
            found = [_moving(path, scene, cameras[0], found[0], pictures, frames)]
        mesh = any(obj.type == "MESH" and len(obj.data.polygons) for obj in scene.objects)
        rate = scene.render.fps / scene.render.fps_base
    return SceneFile(path, tuple(found), frames, rate, mesh)


def _bring(path: Path) -> None:
    if path.suffix.lower() in ALEMBIC:
        bpy.ops.wm.alembic_import(filepath=str(path.resolve()), set_frame_range=True, as_background_job=False)
    else:  # (merged with their parents, cameras would lose the objects' names)
        bpy.ops.wm.usd_import(filepath=str(path.resolve()), set_frame_range=True, import_lights=False,
                              import_materials=False, merge_parent_xform=False)


@contextmanager
def _own_scene() -> Iterator[bpy.types.Scene]:
    """A scene with the open one's frame rate; what was made meanwhile goes with it."""
    before, given = rollback.blocks(), bpy.context.scene.render
    scene = bpy.data.scenes.new("IRPSO Import")
    try:
        scene.render.fps, scene.render.fps_base = given.fps, given.fps_base
        scene.frame_start = NOWHERE
        yield scene
    finally:
        bpy.data.scenes.remove(scene)
        rollback.remove(rollback.blocks() - before)


def _names(obj: bpy.types.Object) -> tuple[str, ...]:
    """The parent's first: USD has the object's name there, and below it that of the camera's data.

    Such files have no dots in names; Blender appends a number where a name is taken.
    """
    return tuple(re.sub(r"\.[0-9]{3}$", "", each.name) for each in (obj.parent, obj) if each is not None)


def _moving(
    path: Path, scene: bpy.types.Scene, obj: bpy.types.Object, camera: SceneCamera, pictures: list[str],
    frames: tuple[int, int],
) -> SceneCamera:
    """With what it is at the frames that pictures are numbered by, unless it is one picture's own."""
    if {plain(name) for name in camera.names} & {plain(stem) for stem in pictures}:
        return camera
    moving = {}
    for number in (number for number in numbered(path, pictures) if frames[0] <= number <= frames[1]):
        scene.frame_set(number)
        moving[number] = _film(scene, obj)
    return SceneCamera(camera.names, camera.still, moving)


def _film(scene: bpy.types.Scene, obj: bpy.types.Object) -> FilmCamera:
    """The camera at the scene's frame."""
    seen: Any = obj.evaluated_get(scene.view_layers[0].depsgraph)
    data = seen.data
    fit = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    return FilmCamera(data.lens, (data.sensor_width, data.sensor_height), (data.shift_x * fit, data.shift_y * fit),
                      np.array(seen.matrix_world, np.float64), data.type == "PERSP")
