"""The scene as a view shows it: through its camera, its own lamps on.  What was before is kept in the scene."""

from __future__ import annotations

import json
from typing import Any

import bpy

from ..glow import is_light
from .scene_views import NamedView, SceneViews


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
        before = {"camera": scene.camera.name if scene.camera else "",
                  "lamps": {lamp.name: [lamp.hide_render, lamp.hide_viewport] for lamp in lamps}}
        scene.irpso.looked = json.dumps(before)
    scene.camera = scene.objects[view.camera]
    for lamp in lamps:
        lamp.hide_render = lamp.hide_viewport = lamp.name not in view.lights + view.emitters


def look_back(scene: bpy.types.Scene) -> None:
    """Camera and lamps as they were."""
    name = _before(scene).get("camera")
    lamps_back(scene)
    camera = scene.objects.get(str(name))
    if name == "" or (camera is not None and camera.type == "CAMERA"):
        scene.camera = camera
    scene.irpso.looked = ""


def lamps_back(scene: bpy.types.Scene) -> None:
    """The lamps as they were; those that are new stay."""
    lamps = _before(scene).get("lamps", {})
    for name, hidden in lamps.items() if isinstance(lamps, dict) else ():
        lamp = scene.objects.get(name)
        if lamp is not None and is_light(lamp) and isinstance(hidden, list) and len(hidden) == 2:
            lamp.hide_render, lamp.hide_viewport = bool(hidden[0]), bool(hidden[1])


def is_looking(scene: bpy.types.Scene) -> bool:
    """Whether the scene is as a view shows it."""
    return bool(scene.irpso.looked)


def _before(scene: bpy.types.Scene) -> dict[str, Any]:
    """Camera and lamps before; a file may hold anything there."""
    try:
        found = json.loads(scene.irpso.looked or "{}")
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
