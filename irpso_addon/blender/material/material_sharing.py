"""Materials that other objects show too: who they are, and what the solved object may change instead."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from .tags import TAG


class Own:
    """Materials that the object may change: made where a slot has none, copied where other objects show them too."""

    def __init__(self, obj: bpy.types.Object, share: bool) -> None:
        """``share``: change also those that others show."""
        self.obj, self.share = obj, share
        self.messages: list[str] = []
        self._copies: dict[bpy.types.Material, bpy.types.Material] = {}

    def material(self, slot: bpy.types.MaterialSlot, solved: str) -> bpy.types.Material:
        """The slot's, which was ``solved`` under that name."""
        obj, material = self.obj, slot.material
        if material is not None and material not in self._copies:
            others = _others(obj, material)
            if not others:
                return material
            if self.share:
                self.messages.append(f"material '{material.name}': {named(others)} shows the maps too")
                return material
            if obj in _given(material):  # a copy would not show there
                self.messages.append(f"material '{material.name}': {named(others)} shows the maps too, because "
                                     f"Geometry Nodes give it to {obj.name}; give {obj.name} a group and a material of "
                                     "its own to keep them apart")
                return material
        if obj.data.users > 1 or not obj.data.is_editable:
            slot.link = "OBJECT"  # else the slots of the other objects with this mesh would change as well
        if material is None:
            slot.material = bpy.data.materials.new(obj.name)
            slot.material[TAG] = ""
            self.messages.append(f"{obj.name}: had an empty material slot; made material '{slot.material.name}'")
        else:
            if material not in self._copies:
                self._copies[material] = material.copy()
                self._copies[material][TAG] = solved
                self.messages.append(f"material '{material.name}': {named(others)} uses it too; made "
                                     f"'{self._copies[material].name}' for {obj.name}")
            slot.material = self._copies[material]
        return slot.material


def shares(scene: bpy.types.Scene) -> bool:
    """Whether materials that other objects show too are to show the maps there as well."""
    return bool(_has_settings() and scene.irpso.shared_material == "SHARE")


def or_open_scene(share: bool | None) -> bool:
    """``share``, or, where it is None, what the open scene says."""
    return shares(bpy.context.scene) if share is None else share


def _has_settings() -> bool:
    """Whether scenes have IRPSO's settings."""
    return hasattr(bpy.types.Scene, "irpso")


def shared_with(obj: bpy.types.Object) -> dict[str, list[str]]:
    """The object's materials that others show too, with these objects' names; for panels, which are drawn often."""
    alone = obj.data is None or obj.data.users < 2
    materials = dict.fromkeys(slot.material for slot in obj.material_slots if slot.material is not None
                              and not (alone and slot.material.users < 2))
    found = {material.name: _others(obj, material) for material in materials}
    return {name: others for name, others in found.items() if others}


def named(others: Sequence[str]) -> str:
    """"'Vase' and 2 more"."""
    return f"'{others[0]}'" + (f" and {len(others) - 1} more" if len(others) > 1 else "")


def is_shared(obj: bpy.types.Object, material: bpy.types.Material) -> bool:
    """Whether another object shows it."""
    return bool(_others(obj, material))


def _others(obj: bpy.types.Object, material: bpy.types.Material) -> list[str]:
    """The names of the other objects that show it, by a slot or by Geometry Nodes."""
    given = _given(material)
    return [other.name for other in bpy.data.objects if other != obj
            and (other in given or any(slot.material == material for slot in other.material_slots))]


def _given(material: bpy.types.Material) -> set[bpy.types.Object]:
    """The objects whose Geometry Nodes may put it on faces."""
    found: set[bpy.types.Object] = set()
    waiting, seen = [material], set()
    while waiting:
        data = waiting.pop()
        seen.add(data)
        users = bpy.data.user_map(subset={data}, value_types={"NODETREE", "OBJECT"})[data]
        found |= {user for user in users if isinstance(user, bpy.types.Object)}
        waiting += [user for user in users if isinstance(user, bpy.types.NodeTree) and user not in seen]
    return {obj for obj in found if any(modifier.type == "NODES" for modifier in obj.modifiers)}
