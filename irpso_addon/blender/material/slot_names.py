"""The names under which materials were solved, and those that they have now: a material may be renamed at any time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import bpy

from ...core.data import Solution
from .tags import TAG

Names = Mapping[int, str]  # session_uid of a material -> the name under which it was solved


def solved_name(slot: bpy.types.MaterialSlot, model: Mapping[str, str]) -> str | None:
    """The name under which the slot's material was solved; None: it was not."""
    name = slot.material.name if slot.material else ""
    # A material that we made or copied for the slot has another name than when it was solved.
    keys = [key for key in (name, slot.material.get(TAG) if slot.material else None) if key in model]
    return keys[0] if keys else None


def solved_slots(obj: bpy.types.Object, model: Mapping[str, str]) -> list[tuple[bpy.types.MaterialSlot, str]]:
    """The slots whose materials were solved, and under which names.

    A linked material may have the name of one of this file: then it was not solved, which a linked one never is to
    take maps.
    """
    found = [(slot, name) for slot in obj.material_slots if (name := solved_name(slot, model)) is not None]
    own = {name for slot, name in found if not _is_linked(slot)}
    return [(slot, name) for slot, name in found if name not in own or not _is_linked(slot)]


def _is_linked(slot: bpy.types.MaterialSlot) -> bool:
    return slot.material is not None and slot.material.library is not None


def names_of(obj: bpy.types.Object, model: Mapping[str, str]) -> dict[int, str]:
    """Of the materials that the object's slots have now."""
    return {slot.material.session_uid: name for slot, name in solved_slots(obj, model) if slot.material is not None}


def present_names(obj: bpy.types.Object, names: Names) -> dict[str, str]:
    """The names under which materials were solved -> those that the object's materials have now, where they differ."""
    slots = [slot.material for slot in obj.material_slots if slot.material is not None]
    now = {names[material.session_uid]: material.name for material in slots if material.session_uid in names}
    return {before: after for before, after in now.items() if before != after}


def renamed(solution: Solution, now: Mapping[str, str]) -> Solution:
    """The solution with other names of materials."""
    if not now:
        return solution

    def of(values: Mapping[str, Any]) -> dict[str, Any]:
        return {now.get(name, name): value for name, value in values.items()}

    return replace(solution, model=of(solution.model), why=of(solution.why), levels=of(solution.levels),
                   predictions=of(solution.predictions), priors=of(solution.priors), metallic=of(solution.metallic),
                   coats=of(solution.coats), diffuse_roughness=of(solution.diffuse_roughness), paint=of(solution.paint))
