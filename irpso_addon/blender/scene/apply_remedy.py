"""A remedy of a warning, carried out on the scene."""

from __future__ import annotations

from typing import Any

from ...core.checks.remedies import Remedy
from ...core.errors import BadInput
from .move_light import check_place, check_power, moved_matrix, multiply_power, object_named, place


def is_done(scene: Any, remedy: Remedy) -> bool:
    """Whether the scene has what the remedy would set.  A light's power and place do not show it."""
    if remedy.kind == "setting":
        return bool(getattr(scene.irpso, remedy.target) == remedy.value)
    return remedy.kind == "colorspace" and all(view.colorspace == remedy.value for view in scene.irpso.views)


def apply_remedy(scene: Any, remedy: Remedy) -> None:
    """Changes the scene as the remedy says.  Raises BadInput, and changes nothing, where what it is about is gone."""
    if remedy.kind == "setting":
        setattr(scene.irpso, remedy.target, remedy.value)
    elif remedy.kind == "colorspace":
        if scene.irpso.captures:
            raise BadInput(f"{scene.irpso.captures}: names the colour space of its views; change it there, or load it "
                           "into the list")
        for view in scene.irpso.views:
            view.colorspace = remedy.value
    else:
        light = object_named(scene, remedy.target)
        if remedy.kind == "power":
            check_power(light)
            multiply_power([light], remedy.factor)
        else:
            check_place(light)
            place(light, moved_matrix(light, remedy.offset))
