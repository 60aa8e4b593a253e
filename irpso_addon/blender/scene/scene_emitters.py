"""Meshes that glow as the solver's emitters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...core.data import F64, I32, Emitter
from ...core.errors import BadInput
from ...core.shading.environment import reduced
from ..glow import Glow, Unmodelled, is_light, radiance_of
from .scene_mesh import corners_of, evaluated_mesh, uvs_of
from .scene_objects import FAR, require_whole, world_matrix
from .scene_world import pixels_of

Warn = Callable[[str], None]
BRIGHTEST = 1e30  # W/(m^2 sr)
PIECES = 1 << 14  # triangles into which a mesh with a picture is cut, at least; each has one color
WIDTH = 128  # pixels to which its picture is reduced


def read_emitter(obj: Any, depsgraph: Any, warn: Warn) -> Emitter | None:
    """The light of ``obj``; None where it has none, or none that is modelled, which a warning then says.

    Raises BadInput for numbers that no light can have.
    """
    name, evaluated = f"object '{obj.name}'", obj.evaluated_get(depsgraph)
    try:
        sent = [radiance_of(slot.material) for slot in evaluated.material_slots] or [[]]
    except Unmodelled:
        warn(f"{name}: glows by nodes other than one colour or image and one strength, which are not modelled, so it "
             "counts as indirect light; give its Emission a plain colour and strength")
        return None
    factors = np.array([glow.factor for glows_of in sent for glow in glows_of]).reshape(-1, 3)
    if not (np.abs(factors) <= BRIGHTEST).all() or (factors < 0).any():
        raise BadInput(f"{name}: its emission is negative, not finite or too large; set it again")
    if not factors.any():
        return None
    maps = {glow.uv_map for found in sent for glow in found if glow.image is not None}
    corners, uvs, slots, closed = _triangles(obj, depsgraph, maps)
    if missing := sorted(maps - set(uvs)):
        which = f" '{missing[0]}'" if missing[0] else ""
        warn(f"{name}: glows by an image and lacks its UV map{which}, so it counts as indirect light; unwrap it, or "
             "choose a UV map that it has")
        return None
    if maps:
        corners, uvs, slots = _cut(corners, uvs, slots)
    radiance = _sent(obj, sent, uvs, np.minimum(slots, len(sent) - 1), warn)
    lit = radiance.any(-1)
    if not lit.any():
        return None
    _warn_of_visibility(obj, name, warn)
    return Emitter(obj.name, corners[lit].astype(np.float32), radiance[lit].astype(np.float32), not closed)


def _sent(obj: Any, sent: list[list[Glow]], uvs: dict[str, F64], slots: I32, warn: Warn) -> F64:
    """(T, 3) of each triangle, by the color in its middle."""
    radiance = np.zeros((len(slots), 3))
    for slot, found in enumerate(sent):
        chosen = slots == slot
        for glow in found:
            if glow.image is None:
                radiance[chosen] += glow.factor
                continue
            picture = reduced(pixels_of(glow.image, warn, f"object '{obj.name}'"), WIDTH)
            size = np.array(picture.shape[1::-1])
            at = np.floor(uvs[glow.uv_map][chosen].mean(1) * size).astype(int)
            x, y = (at % size if glow.repeats else np.clip(at, 0, size - 1)).T
            radiance[chosen] += glow.factor * picture[y, x]
    return radiance


def _cut(corners: F64, uvs: dict[str, F64], slots: I32) -> tuple[F64, dict[str, F64], I32]:
    """The same triangles halved across their longest edges until each is a small part of the whole."""
    both = np.concatenate([corners, *uvs.values()], -1)

    def area(found: F64) -> F64:
        return np.linalg.norm(np.cross(found[:, 1, :3] - found[:, 0, :3], found[:, 2, :3] - found[:, 0, :3]), axis=-1)

    limit = float(area(both).sum()) / PIECES
    while (large := area(both) > limit).any():
        some = both[large]
        edges = np.linalg.norm((np.roll(some, -1, 1) - some)[..., :3], axis=-1)  # from each corner to the next
        first = edges.argmax(1)[:, None]
        a, b, c = (np.take_along_axis(some, ((first + k) % 3)[..., None], 1)[:, 0] for k in range(3))
        halves = np.concatenate([np.stack([a, (a + b) / 2, c], 1), np.stack([(a + b) / 2, b, c], 1)])
        both = np.concatenate([both[~large], halves])
        slots = np.concatenate([slots[~large], slots[large], slots[large]])
    parts = np.split(both[..., 3:], len(uvs), -1) if uvs else []
    return both[..., :3], dict(zip(uvs, parts, strict=True)), slots


def name_instances(depsgraph: Any, warn: Warn) -> None:
    """Warns of instances that shine: lamps and emitters are objects alone."""
    for instance in depsgraph.object_instances:
        if not instance.is_instance or instance.parent is None:
            continue
        obj, parent = instance.object.original, instance.parent.original
        if parent == obj or obj.hide_render or parent.hide_render or not is_light(obj):
            continue
        kind, does = ("light", "shines") if obj.type == "LIGHT" else ("object", "glows")
        warn(f"{kind} '{obj.name}': {does} as an instance of '{parent.name}', which is not modelled, so it counts as "
             "indirect light; make instances real (Object > Apply)")


def _warn_of_visibility(obj: Any, name: str, warn: Warn) -> None:
    if obj.light_linking.receiver_collection or obj.light_linking.blocker_collection:
        warn(f"{name}: light linking is not modelled; unlink it for the pictures")
    if not (obj.visible_diffuse and obj.visible_glossy):
        warn(f"{name}: glows, but is hidden from diffuse or glossy rays, which is not modelled; make it visible to "
             "both")


def _triangles(obj: Any, depsgraph: Any, uv_maps: set[str]) -> tuple[F64, dict[str, F64], I32, bool]:
    """World corners (T, 3, 3), their UVs by map, material of each, and whether they are a closed shape's outside.

    Maps that the mesh lacks are left out.
    """
    require_whole(obj, depsgraph)
    world = world_matrix(obj, depsgraph)
    with evaluated_mesh(obj, depsgraph) as mesh:
        if mesh is None or not mesh.polygons:
            return np.zeros((0, 3, 3)), {name: np.zeros((0, 3, 2)) for name in uv_maps}, np.zeros(0, np.int32), False
        local, slots = corners_of(mesh)
        there = {layer.name for layer in mesh.uv_layers} | ({""} if mesh.uv_layers else set())
        uvs = {name: uvs_of(mesh, name).astype(np.float64) for name in uv_maps & there}
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
    order = [0, 2, 1] if volume < 0 else [0, 1, 2]
    return corners[:, order], {name: uv[:, order] for name, uv in uvs.items()}, slots, closed
