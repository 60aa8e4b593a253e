"""Worlds as a solve has put them right: turned in the list of views, and brighter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import bpy

from ...core.change_records import WorldChange
from ...core.errors import BadInput
from ...core.phrases import counted

SAME = 1e-6  # radians: turns are kept as float32


def strengthened(worlds: Sequence[WorldChange]) -> dict[Any, float]:
    """The worlds whose strength changes, and the factors.  Raises BadInput where that is impossible."""
    found = {}
    for change in worlds:
        if not change.sure_strength:
            continue
        world = bpy.data.worlds.get(change.world)
        if world is None:
            raise BadInput(f"world '{change.world}': is not in the file any more; solve again")
        if world.library is not None or not _strengths(world):
            raise BadInput(f"world '{change.world}': no Background node in it has a strength that can be set; multiply "
                           f"its light by {change.strength:.3f}")
        found[world] = change.strength
    return found


def multiply_strength(world: Any, factor: float) -> None:
    """Of all that it sends out."""
    for socket in _strengths(world):
        socket.default_value *= factor


def turn_views(scene: Any, worlds: Sequence[WorldChange]) -> str:
    """Turns the world in the list's views; says what became of that."""
    turns = {change.given: change.turn for change in worlds
             if scene.world is not None and change.world == scene.world.name}
    if not any(turns.values()):
        return ""
    if scene.irpso.captures:
        return f"the views of {bpy.path.basename(scene.irpso.captures)} keep their world turn"
    if not scene.irpso.views:
        return "background images have no world turn to be changed"
    count = 0
    for view in scene.irpso.views:
        by = next((turn for given, turn in turns.items() if abs(math.radians(view.turn) - given) < SAME), 0.0)
        view.turn += math.degrees(by)
        count += by != 0
    return f"world turn of {counted(count, 'view')} changed"


def _strengths(world: Any) -> list[Any]:
    """The sockets that all of its light goes through; none where something else decides on some of it."""
    if world.node_tree is None:
        return []
    nodes = [node for node in world.node_tree.nodes if node.type == "BACKGROUND"]
    if any(node.inputs["Strength"].is_linked for node in nodes) or world.node_tree.animation_data is not None:
        return []
    return [node.inputs["Strength"] for node in nodes]
