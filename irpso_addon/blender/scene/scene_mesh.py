"""Evaluated geometry as triangles: the object that is solved, and what else stands in the scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...core.data import F32, F64, I32, MeshArrays, NormalMap
from ...core.errors import BadInput
from ...core.phrases import percent
from ..glow import SOLID
from .mesh_noise import degrees_of_noise
from .scene_material import SlotNormalMap
from .scene_objects import FAR, ignored, rendered_objects, require_whole, world_matrix

AT_ONCE = 1 << 15  # triangles that are transformed together
SCAN, PLANES = 10_000, 500  # triangles from which on a mesh is a scan, and directions that an object of planes has not
NOISY = 0.5  # degrees: more makes roughness wrong
MAX_TRIANGLES = 20_000_000  # of the occluders: 720 MB

Warn = Callable[[str], None]


@dataclass(frozen=True)
class _Corners:
    """Corners of the triangles, in object space."""

    positions: F32  # (T, 3, 3)
    normals: F32  # (T, 3, 3)
    uvs: F32  # (T, 3, 2)
    slots: I32  # (T,)
    tangents: F32 | None  # (T, 3, 4) where there is a normal map


def read_mesh(obj: Any, depsgraph: Any, maps: dict[int, SlotNormalMap], warn: Warn) -> MeshArrays:
    """``obj`` after its modifiers, in world space.

    A mirrored object (negative scale) has its corners turned round, so that triangles are
    counter-clockwise from outside.  Raises BadInput: no faces, no UV map, a UV map without area, not evaluated.
    """
    require_whole(obj, depsgraph)
    world = world_matrix(obj, depsgraph)
    linear = world[:3, :3]
    if not np.isfinite(world).all() or abs(np.linalg.det(linear)) < 1e-20:
        raise BadInput(f"object '{obj.name}': its scale is 0 or its matrix not finite; set its scale")
    normal_matrix = np.linalg.inv(linear).T
    mirrored = bool(np.linalg.det(linear) < 0)
    if mirrored:
        warn(f"object '{obj.name}': is mirrored by a negative scale; it is read as Blender shows it")
    local = _read_corners(obj, depsgraph, maps, warn)
    with np.errstate(over="ignore"):
        positions = _mapped(local.positions, lambda part: part @ linear.T + world[:3, 3])
    normals = _mapped(local.normals, lambda part: _unit(part @ normal_matrix.T))
    if not ((np.abs(positions) <= FAR).all() and np.isfinite(normals).all()):
        raise BadInput(f"object '{obj.name}': is too large or too far away; scale it down or move it closer")
    order = [0, 2, 1] if mirrored else slice(None)
    unit = bpy.app.version >= (5, 0, 0)
    return MeshArrays(
        name=obj.name, positions=positions[:, order], normals=normals[:, order],
        uvs=local.uvs[:, order], slots=local.slots,
        slot_names=tuple(s.material.name if s.material else "" for s in obj.material_slots) or ("",),
        object_normals=local.normals[:, order] if maps else None,
        tangents=None if local.tangents is None else local.tangents[:, order],
        normal_matrix=normal_matrix.astype(np.float32), unit_normal=unit,
        normal_maps={slot: NormalMap(m.pixels, m.strength, unit) for slot, m in maps.items()},
    )


def _read_corners(obj: Any, depsgraph: Any, maps: dict[int, SlotNormalMap], warn: Warn) -> _Corners:
    with evaluated_mesh(obj, depsgraph) as mesh:
        if mesh is None or not mesh.polygons:
            raise BadInput(f"object '{obj.name}': has no faces after its modifiers; add faces or change the modifiers")
        layer = _active_uv(obj, mesh, warn)
        loops, vertices, slots = triangles(mesh)
        positions = _floats(mesh.vertices, "co", 3)[vertices]
        normals = _floats(mesh.corner_normals, "vector", 3)[loops]
        uvs = _floats(mesh.uv_layers[layer].uv, "vector", 2)[loops]
        _check(obj, positions, uvs)
        if _is_flat(normals):
            warn(f"object '{obj.name}': is shaded flat, so its {len(loops):,} facets count as the surface's own; use "
                 "Object > Shade Smooth")
        elif len(loops) >= SCAN and (degrees := degrees_of_noise(mesh)) >= NOISY:
            warn(f"object '{obj.name}': the noise of its corners turns its normals by {degrees:.1f}°; use "
                 "Denoise Normals (panel Shoot)")
        _check_materials(obj, obj.evaluated_get(depsgraph), slots, warn)
        slots = _slots_of(obj, slots)
        if maps and not mesh.is_editable:  # also of its temporary copy: tangents of what cannot be set crash Blender
            raise BadInput(f"object '{obj.name}': its mesh is linked from a library and has a normal map; "
                           "make it local first (Object > Relations)")
        tangents = _slot_tangents(mesh, normals, loops, slots, maps, layer) if maps else None
    return _Corners(positions, normals, uvs, slots, tangents)


def _is_flat(normals: F32) -> bool:
    """Whether it is a scan with a normal for each facet: many triangles (T, 3, 3), whose planes differ."""
    some = normals[::max(1, len(normals) // SCAN)]
    return bool(len(some) >= SCAN and (some == some[:, :1]).all()
                and len(np.unique(some[:, 0].round(2), axis=0)) > PLANES)


def face_slots(obj: Any, depsgraph: Any) -> I32:
    """(faces,) indices of the material slots that faces have after modifiers; nothing where there are none."""
    with evaluated_mesh(obj, depsgraph) as mesh:
        return _slots_of(obj, integers(() if mesh is None else mesh.polygons, "material_index", 1)[:, 0])


def _slots_of(obj: Any, indices: I32) -> I32:
    """What Blender shows by the material indices of faces: those beyond the slots have the last one."""
    return np.clip(indices, 0, max(1, len(obj.material_slots)) - 1)


@contextmanager
def evaluated_mesh(obj: Any, depsgraph: Any) -> Iterator[Any]:
    """A temporary copy of the mesh after modifiers, in no list of the file; None when there is none."""
    evaluated = obj.evaluated_get(depsgraph)
    try:
        mesh = evaluated.to_mesh()
    except RuntimeError:  # Blender: "Object does not have geometry data"
        mesh = None
    try:
        yield mesh
    finally:
        evaluated.to_mesh_clear()


def _active_uv(obj: Any, mesh: Any, warn: Warn) -> str:
    """Name of the UV map that renders use."""
    layers = mesh.uv_layers
    if not len(layers):
        raise BadInput(f"object '{obj.name}': has no UV map; unwrap it")
    used = next((layer.name for layer in layers if layer.active_render), layers[0].name)
    if layers.active is not None and layers.active.name != used:
        warn(f"object '{obj.name}': UV map '{used}' is used (its camera icon is on), not the selected "
             f"'{layers.active.name}'")
    return used


def triangles(mesh: Any) -> tuple[I32, I32, I32]:
    """Loops (T, 3), vertices (T, 3) and material index (T,) of the triangulated faces."""
    mesh.calc_loop_triangles()
    found = mesh.loop_triangles
    loops = integers(found, "loops", 3)
    vertices = integers(found, "vertices", 3)
    return loops, vertices, integers(found, "material_index", 1)[:, 0]


def corners_of(mesh: Any) -> tuple[F32, I32]:
    """Corners (T, 3, 3) in object space and material index (T,) of the triangulated faces."""
    _, vertices, slots = triangles(mesh)
    return _floats(mesh.vertices, "co", 3)[vertices], slots


def uvs_of(mesh: Any, name: str) -> F32:
    """Corners (T, 3, 2) in the UV map of that name, "": that which renders use; 0 where there is none."""
    loops, _, _ = triangles(mesh)
    layer = mesh.uv_layers.get(name) if name else next((found for found in mesh.uv_layers if found.active_render), None)
    return np.zeros((len(loops), 3, 2), np.float32) if layer is None else _floats(layer.uv, "vector", 2)[loops]


def _check(obj: Any, local: F32, uvs: F32) -> None:
    if not np.isfinite(local).all():
        raise BadInput(f"object '{obj.name}': has vertices that are not finite; run Mesh > Clean Up")
    if not np.isfinite(uvs).all():
        raise BadInput(f"object '{obj.name}': has UVs that are not finite; unwrap it again")
    a, b = (uvs[:, i].astype(np.float64) - uvs[:, 0] for i in (1, 2))
    if not (np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > 1e-12).any():
        raise BadInput(f"object '{obj.name}': its UV map has no area; unwrap it")


def _check_materials(obj: Any, evaluated: Any, slots: I32, warn: Warn) -> None:
    """Of faces to which modifiers give materials that are in none of the slots: maps on the slots do not show there.

    Raises BadInput where no other face is left.
    """
    own = [slot.material for slot in obj.material_slots]
    shown = [slot.material.original if slot.material is not None else None for slot in evaluated.material_slots]
    foreign = {index: material for index, material in enumerate(shown)
               if material is not None and (index >= len(own) or material != own[index])}
    given = np.isin(np.minimum(slots, len(shown) - 1), list(foreign))
    if not given.any():
        return
    material = foreign[int(min(slots[given].min(), len(shown) - 1))]
    line = f"object '{obj.name}': its modifiers give {{}} material '{material.name}', on which no map can show"
    if given.all():
        raise BadInput(f"{line.format('all faces')}; take it off there, and put it in a slot of the object")
    warn(f"{line.format(f'{percent(given.mean())} of its faces')}; apply the modifiers to solve these")


def _slot_tangents(
    mesh: Any, normals: F32, loops: I32, slots: I32, maps: dict[int, SlotNormalMap], active: str,
) -> F32:
    """(T, 3, 4) MikkTSpace tangents in object space, for each slot by the UV map that its normal map names."""
    names = {slot: m.uv_map or active for slot, m in maps.items()}
    layers = {name: _floats(mesh.uv_layers[name].uv, "vector", 2)[loops] for name in {active, *names.values()}
              if name in mesh.uv_layers}
    vertices = integers(mesh.loops, "vertex_index", 1)[:, 0][loops]
    every = _mikktspace(mesh, vertices, normals, layers)
    tangents = every[active].copy()
    for slot, name in names.items():
        if name in every:
            tangents[slots == slot] = every[name][slots == slot]
    return tangents


def _mikktspace(mesh: Any, vertices: I32, normals: F32, layers: dict[str, F32]) -> dict[str, F32]:
    """(T, 3, 4) tangents and signs for each UV layer.

    The temporary ``mesh`` is rebuilt as triangles first: Blender's tangents want no n-gons, and Cycles
    takes them over triangles, not quads.  The corner normals are given back to it as custom normals.
    """
    coordinates = _floats(mesh.vertices, "co", 3)
    count = len(vertices)
    mesh.clear_geometry()
    mesh.vertices.add(len(coordinates))
    mesh.vertices.foreach_set("co", coordinates.ravel())
    mesh.loops.add(3 * count)
    mesh.loops.foreach_set("vertex_index", vertices.ravel())
    mesh.polygons.add(count)
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    for name, uvs in layers.items():
        mesh.uv_layers.new(name=name, do_init=False).uv.foreach_set("vector", uvs.ravel())
    mesh.normals_split_custom_set(normals.reshape(-1, 3).tolist())
    found = {}
    for name in layers:
        mesh.calc_tangents(uvmap=name)
        tangent = np.nan_to_num(_floats(mesh.loops, "tangent", 3), posinf=0.0, neginf=0.0)  # of faces without area
        sign = _floats(mesh.loops, "bitangent_sign", 1)
        found[name] = np.concatenate([tangent, sign], 1).reshape(-1, 3, 4)
    return found


def read_occluders(subject: Any, depsgraph: Any, warn: Warn) -> tuple[F32, F32]:
    """(O, 3, 3) world triangles of all other objects and instances that a render shows: seen by cameras, and not."""
    shapes: dict[int, F32] = {}
    found: tuple[list[F32], list[F32]] = [], []
    total = 0
    for obj, key, matrix in _solids(subject, depsgraph, warn):
        if key not in shapes:
            shapes[key] = _local_triangles(obj)
        total += len(shapes[key])
        if total > MAX_TRIANGLES:
            raise BadInput(f"object '{obj.name}': the scene has more than {MAX_TRIANGLES // 1_000_000} "
                           "million triangles besides the object; hide some objects from renders")
        unseen = not obj.original.visible_camera
        found[unseen].append((shapes[key] @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32))
    return _near(found[0]), _near(found[1])


def _near(found: Sequence[F32]) -> F32:
    """All triangles together, without those that no place could be."""
    together = np.concatenate([np.zeros((0, 3, 3), np.float32), *found])
    return together[(np.abs(together) <= FAR).all((1, 2))]


def _solids(subject: Any, depsgraph: Any, warn: Warn) -> Iterator[tuple[Any, int, F64]]:
    """Evaluated object, key of its shape and world matrix of whatever renders beside the subject."""
    shown = rendered_objects(depsgraph.view_layer)
    iterated = set()
    for instance in depsgraph.object_instances:
        obj, original = instance.object, instance.object.original
        iterated.add(original.name_full)
        if instance.is_instance:
            # A curve's or text's own mesh comes as an instance of it, too.
            own = instance.parent is None or instance.parent.original == original
            visible = (instance.parent or obj).original.name_full in shown and not original.hide_render
            if own and original == subject:
                warn(f"object '{subject.name}': its modifiers make instances, which are ignored; realize them")
                continue
        else:
            # Curves, texts and metaballs follow as meshes; an instancer may be there for its instances alone.
            visible = original.name_full in shown and original != subject and obj.type == "MESH"
            visible = visible and (original.instance_type == "NONE" or original.show_instancer_for_render)
        if visible and obj.type in SOLID and (original.visible_camera or original.visible_shadow):
            yield obj, hash((obj.as_pointer(), obj.data.as_pointer())), np.array(instance.matrix_world, np.float64)
    # What is hidden in the viewport alone still renders.
    for name, obj in shown.items():
        if name in iterated or obj == subject or obj.type not in SOLID:
            continue
        evaluated = obj.evaluated_get(depsgraph)
        if line := ignored(obj, depsgraph):
            warn(line)
        yield evaluated, hash((evaluated.as_pointer(), evaluated.data.as_pointer())), world_matrix(obj, depsgraph)


def _local_triangles(obj: Any) -> F32:
    """(T, 3, 3) in object space of an evaluated object."""
    try:
        mesh = obj.to_mesh()
    except RuntimeError:  # nothing that a mesh could be made of
        return np.zeros((0, 3, 3), np.float32)
    try:
        if mesh is None or not mesh.polygons:
            return np.zeros((0, 3, 3), np.float32)
        return corners_of(mesh)[0]
    finally:
        obj.to_mesh_clear()


def _floats(collection: Any, attribute: str, width: int) -> F32:
    out = np.empty(len(collection) * width, np.float32)
    collection.foreach_get(attribute, out)
    return out.reshape(-1, width)


def integers(collection: Any, attribute: str, width: int) -> I32:
    """(N, width) of an attribute of a collection."""
    out = np.empty(len(collection) * width, np.int32)
    collection.foreach_get(attribute, out)
    return out.reshape(-1, width)


def _mapped(vectors: F32, function: Callable[[F32], F64]) -> F32:
    """The function of vectors (T, 3, 3), a few at a time: in float64, a dense mesh takes gigabytes."""
    out = np.empty(vectors.shape, np.float32)
    for first in range(0, len(out), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        out[part] = function(vectors[part])
    return out


def _unit(vectors: F64 | F32) -> F64:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-30))
