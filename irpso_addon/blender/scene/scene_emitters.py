"""Meshes that glow as the solver's emitters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...core.data import F64, I32, Emitter
from ...core.errors import BadInput
from ..glow import Unmodelled, glows, radiance_of
from .scene_mesh import corners_of, evaluated_mesh
from .scene_objects import FAR, world_matrix

Warn = Callable[[str], None]
BRIGHTEST = 1e30  # W/(m^2 sr)


def read_emitter(obj: Any, depsgraph: Any, warn: Warn) -> Emitter | None:
    """The light of ``obj``; None where it has none, or none that is modelled, which a warning then says.

    Raises BadInput for numbers that no light can have.
    """
    name, evaluated = f"object '{obj.name}'", obj.evaluated_get(depsgraph)
    materials = [slot.material for slot in evaluated.material_slots]
    try:
        sent = np.array([radiance_of(material) for material in materials] or [np.zeros(3)])
    except Unmodelled:
        warn(f"{name}: glows by nodes other than one color and strength, which are not modelled, so it counts as "
             "indirect light; give its Emission a plain color and strength")
        return None
    if not (np.abs(sent) <= BRIGHTEST).all() or (sent < 0).any():
        raise BadInput(f"{name}: its emission is negative, not finite or too large; set it again")
    if not sent.any():
        return None
    found, slots, closed = _triangles(obj, depsgraph)
    radiance = sent[np.minimum(slots, len(sent) - 1)]
    lit = radiance.any(-1)
    if not lit.any():
        return None
    _warn_of_visibility(obj, name, warn)
    return Emitter(obj.name, found[lit].astype(np.float32), radiance[lit].astype(np.float32), not closed)


def name_instances(depsgraph: Any, warn: Warn) -> None:
    """Warns of instances that glow: objects alone are emitters."""
    for instance in depsgraph.object_instances:
        obj = instance.object.original
        if instance.is_instance and instance.parent is not None and instance.parent.original != obj and glows(obj):
            warn(f"object '{obj.name}': glows as an instance of '{instance.parent.original.name}', which is not "
                 "modelled, so it counts as indirect light; make instances real (Object > Apply)")


def _warn_of_visibility(obj: Any, name: str, warn: Warn) -> None:
    if obj.light_linking.receiver_collection or obj.light_linking.blocker_collection:
        warn(f"{name}: light linking is not modelled; unlink it for the pictures")
    if not (obj.visible_diffuse and obj.visible_glossy):
        warn(f"{name}: glows, but is hidden from diffuse or glossy rays, which is not modelled; make it visible to "
             "both")


def _triangles(obj: Any, depsgraph: Any) -> tuple[F64, I32, bool]:
    """World corners (T, 3, 3), material of each, and whether they are the outside of a closed shape."""
    world = world_matrix(obj, depsgraph)
    with evaluated_mesh(obj, depsgraph) as mesh:
        if mesh is None or not mesh.polygons:
            return np.zeros((0, 3, 3)), np.zeros(0, np.int32), False
        local, slots = corners_of(mesh)
    corners = local.astype(np.float64) @ world[:3, :3].T + world[:3, 3]
    if not (np.abs(corners) <= FAR).all():
        raise BadInput(f"object '{obj.name}': glows and is too large or too far away; scale it down or move it closer")
    _, welded = np.unique(local.reshape(-1, 3), axis=0, return_inverse=True)  # a curve's caps share no vertices
    vertices = welded.reshape(-1, 3)
    edges = np.sort(np.stack([vertices, np.roll(vertices, -1, 1)], -1).reshape(-1, 2), 1)
    along = (vertices < np.roll(vertices, -1, 1)).ravel()  # each edge of a closed shape is run through once each way
    _, number, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    closed = bool((count == 2).all() and (np.bincount(number.ravel(), along) == 1).all())
    volume = float((corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum()) if closed else 0.0
    return corners[:, [0, 2, 1]] if volume < 0 else corners, slots, closed
