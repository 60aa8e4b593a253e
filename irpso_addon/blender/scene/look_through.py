"""The scene as a view shows it: through its camera, its own lamps on.  What was before is kept in the scene."""

from __future__ import annotations

import bpy

from ..glow import is_light
from .scene_views import NamedView, SceneViews

NO_CAMERA = "NO CAMERA"  # what `looked` says where the scene had none


def named_view(context: bpy.types.Context, index: int) -> NamedView | None:
    """The list's view of that place, as a solve takes it; None where there is none with a camera and lamps."""
    if is_looking(context.scene):
        lamps_back(context.scene)
    views = SceneViews(context.scene, context.view_layer).from_scene().views
    view = views[index] if index < len(views) else None
    return None if view is None or (view.faults and context.scene.objects.get(view.camera) is None) else view


def look_through(scene: bpy.types.Scene, view: NamedView) -> None:
    """Through its camera, and of all lamps those on that were on; of meshes that glow, if views name them."""
    named = {item.light for entry in scene.irpso.views for item in entry.lights}
    lamps = [obj for obj in scene.objects if obj.type == "LIGHT" or (obj in named and is_light(obj))]
    if not is_looking(scene):
        _remember(scene, lamps)
    scene.camera = scene.objects[view.camera]
    for lamp in lamps:
        lamp.hide_render = lamp.hide_viewport = lamp.name not in view.lights + view.emitters


def _remember(scene: bpy.types.Scene, lamps: list[bpy.types.Object]) -> None:
    """Camera and lamps as they are, by pointers, which follow renaming and saving."""
    panel = scene.irpso
    panel.looked, panel.looked_camera = "CAMERA" if scene.camera else NO_CAMERA, scene.camera
    panel.looked_lamps.clear()
    for lamp in lamps:
        entry = panel.looked_lamps.add()
        entry.light, entry.hide_render, entry.hide_viewport = lamp, lamp.hide_render, lamp.hide_viewport


def look_back(scene: bpy.types.Scene) -> None:
    """Camera and lamps as they were."""
    panel = scene.irpso
    lamps_back(scene)
    cameras = [obj for obj in scene.objects if obj.type == "CAMERA" and obj == panel.looked_camera]
    if cameras or panel.looked == NO_CAMERA:
        scene.camera = cameras[0] if cameras else None
    panel.looked, panel.looked_camera = "", None
    panel.looked_lamps.clear()


def lamps_back(scene: bpy.types.Scene) -> None:
    """The lamps as they were; those that are new stay."""
    for entry in scene.irpso.looked_lamps:
        lamp = entry.light
        if lamp is not None and is_light(lamp):
            lamp.hide_render, lamp.hide_viewport = entry.hide_render, entry.hide_viewport


def is_looking(scene: bpy.types.Scene) -> bool:
    """Whether the scene is as a view shows it."""
    return bool(scene.irpso.looked)
