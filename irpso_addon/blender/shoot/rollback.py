"""What an import adds to a file, and how all of it is taken out again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

# Types of data that Blender's importers make; the rest of a file (scenes, screens, brushes) is never ours to remove.
KINDS = ("objects", "meshes", "materials", "images", "collections", "cameras", "lights", "armatures", "actions",
         "curves", "hair_curves", "pointclouds", "volumes", "textures", "node_groups", "worlds", "cache_files")


def blocks() -> set[Any]:
    """The data blocks of the open file of those types."""
    return {block for kind in KINDS for block in getattr(bpy.data, kind, ())}


def remove(unwanted: set[Any]) -> None:
    """Data blocks, wherever they are used."""
    bpy.data.batch_remove(list(unwanted))


@contextmanager
def all_or_nothing(context: bpy.types.Context) -> Iterator[None]:
    """Leaves file, scene and selection as they were if what it holds raises."""
    before = blocks()
    scene, layer = context.scene, context.view_layer
    active, selected = layer.objects.active, [obj for obj in layer.objects if obj.select_get()]
    views, settings = len(scene.irpso.views), (scene.irpso.photographs, scene.irpso.scale_known)
    render, world = scene.render, scene.world
    size = render.resolution_x, render.resolution_y, render.resolution_percentage
    try:
        yield
    except BaseException:
        while len(scene.irpso.views) > views:
            scene.irpso.views.remove(len(scene.irpso.views) - 1)
        scene.irpso.photographs, scene.irpso.scale_known = settings
        render.resolution_x, render.resolution_y, render.resolution_percentage = size
        scene.world = world
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        for obj in layer.objects:
            obj.select_set(obj in selected)
        remove(blocks() - before)
        layer.objects.active = active
        raise
