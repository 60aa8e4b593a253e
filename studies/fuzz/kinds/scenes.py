"""What a .blend may hold: any property at any value, broken meshes, things missing, our own tags misused."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import bpy
import numpy as np

from irpso_addon.blender import files
from irpso_addon.blender.material.tags import PARKED_TAG, SPECULAR_LINK_TAG, SPECULAR_TAG, TAG

from .. import spoil, stage
from ..case import Box

# Properties that make Blender do something for long, or write: not what a file holds.
# (Sockets of nodes get their names anew whenever Blender reads them, and whether there are any.)
LEFT_ALONE = {"is_embedded_data", "use_fake_user", "rna_type", "bl_idname", "frame_current", "frame_start", "frame_end",
              "levels", "render_levels", "count", "segments", "quality", "resolution_u", "resolution_v", "subframe"}
TAGS = (TAG, SPECULAR_TAG, SPECULAR_LINK_TAG, PARKED_TAG)
MODIFIERS = ("SUBSURF", "MIRROR", "TRIANGULATE", "DECIMATE", "ARRAY", "SOLIDIFY", "DISPLACE", "BOOLEAN", "NODES",
             "EDGE_SPLIT", "WEIGHTED_NORMAL", "DATA_TRANSFER", "UV_PROJECT", "MASK")


prepare = stage.prepare  # the files that cases begin with


def make(shared: list[Path], rng: Random, box: Box) -> Callable[[], None]:
    """One of them, opened and made odd."""
    base = rng.choice(shared)
    shutil.copyfile(base.parent / stage.CAPTURES, box.given / stage.CAPTURES)
    path = box.given / "scene.blend"
    shutil.copyfile(base, path)
    box.note("blender")
    files.open_blend(path)
    for _ in range(rng.choice((0, 1, 1, 1, 2, 3, 5))):
        rng.choices((_property, _mesh, _gone, _tag, _structure, _name, _place), (6, 2, 1, 2, 2, 1, 1))[0](rng)
    bpy.context.view_layer.update()
    box.names = (*({item.name for item in stage.everything()} - {""}), path.name, stage.CAPTURES)
    return partial(run, rng, box)


def run(rng: Random, box: Box) -> None:
    """Reads it."""
    box.note("")
    stage.read(rng, box.given)


# ---- what is done to it


def _holders() -> list[Any]:
    """What has properties that the add-on may look at."""
    scene = bpy.context.scene
    found = [scene, scene.render, scene.cycles, scene.view_settings, scene.world, scene.irpso,
             *scene.irpso.views, *(light for view in scene.irpso.views for light in view.lights)]
    for obj in bpy.data.objects:
        found += [obj, obj, obj.data, obj.data, *obj.material_slots, *obj.modifiers, *obj.constraints]
        if obj.type == "CAMERA":
            found += [obj.data.dof, *obj.data.background_images]
        if obj.type == "LIGHT":
            found += [obj.data.cycles]
    for tree in [m.node_tree for m in bpy.data.materials if m.node_tree] + list(bpy.data.node_groups):
        for node in tree.nodes:
            found += [node, *node.inputs]
    for image in bpy.data.images:
        found += [image, image.colorspace_settings]
    found += [*bpy.data.materials, *(material.cycles for material in bpy.data.materials),
              *bpy.context.view_layer.layer_collection.children]
    return [holder for holder in found if holder is not None]


def _property(rng: Random) -> None:
    """Some property of something, at some value."""
    holder = rng.choice(_holders())
    wanted = [p for p in holder.bl_rna.properties if not p.is_readonly and p.identifier not in LEFT_ALONE
              and p.type != "COLLECTION" and not (
                  p.identifier in {"name", "enabled"} and isinstance(holder, bpy.types.NodeSocket))]
    if not wanted:
        return
    which = rng.choice(wanted)
    try:
        setattr(holder, which.identifier, _value(which, rng))
    except (TypeError, ValueError, AttributeError, RuntimeError, OverflowError, ReferenceError):
        pass  # Blender does not hold such a value there


def _value(which: Any, rng: Random) -> Any:
    length = getattr(which, "array_length", 0)
    if length and length <= 64:
        return [_single(which, rng) for _ in range(length)]
    return _single(which, rng)


def _single(which: Any, rng: Random) -> Any:
    if which.type == "FLOAT":
        return spoil.float32(rng)
    if which.type == "INT":
        return max(-(2**31), min(2**31 - 1, rng.choice((*spoil.INTERESTING, 3, 100))))
    if which.type == "BOOLEAN":
        return rng.random() < 0.5
    if which.type == "ENUM":
        items = [item.identifier for item in which.enum_items]
        if which.is_enum_flag:
            return set(rng.sample(items, rng.randrange(len(items) + 1)))
        return rng.choice(items or [""])
    if which.type == "STRING":
        return spoil.word(rng)
    return rng.choice([None, *stage.everything()])


def _mesh(rng: Random) -> None:
    """Numbers of a mesh that are none."""
    mesh = rng.choice(bpy.data.meshes) if bpy.data.meshes else None
    if mesh is None or not len(mesh.vertices):
        return
    kind = rng.randrange(5)
    if kind == 0 and mesh.uv_layers:
        target, attribute, width = mesh.uv_layers[0].uv, "vector", 2
    elif kind == 1:
        target, attribute, width = mesh.polygons, "material_index", 1
    else:
        target, attribute, width = mesh.vertices, "co", 3
    values = np.empty(len(target) * width, np.int32 if width == 1 else np.float32)
    target.foreach_get(attribute, values)
    chosen = np.random.default_rng(rng.randrange(2**32)).random(len(values)) < rng.choice((0.01, 0.3, 1.0))
    with np.errstate(all="ignore"):
        values[chosen] = rng.randrange(0, 32767) if width == 1 else np.float32(spoil.float32(rng))
    target.foreach_set(attribute, values)
    mesh.update()


def _gone(rng: Random) -> None:
    """Something is missing."""
    kind = rng.randrange(6)
    if kind == 0:
        mesh = rng.choice(bpy.data.meshes) if bpy.data.meshes else None
        if mesh is not None and mesh.is_editable:
            mesh.clear_geometry()
    elif kind == 1:
        for mesh in bpy.data.meshes:
            while mesh.uv_layers and mesh.is_editable:
                mesh.uv_layers.remove(mesh.uv_layers[0])
    else:
        items = list(getattr(bpy.data, ("objects", "materials", "images", "cameras")[kind - 2]))
        if items:
            bpy.data.batch_remove([rng.choice(items)])


def _tag(rng: Random) -> None:
    """What we leave in a file, otherwise than we leave it."""
    nodes = [n for m in bpy.data.materials if m.node_tree for n in m.node_tree.nodes]
    holder = rng.choice([*bpy.data.objects, *bpy.data.materials, *nodes, *bpy.data.node_groups, *bpy.data.images])
    roles = ("base_color", "roughness", "confidence", "error", "specular", "two_lobe", "separate", "frame")
    value = rng.choice((
        0, 1, -1.5, "", "x", rng.choice(roles), [1, 2, 3], [0.5], {}, {"base_color": 3}, {"a": {"b": "c"}},
        dict.fromkeys(roles, "x"), {"sockets": 3}, {"hide": 1, "label": "x", "sockets": "a,b"}, b"bytes"))
    try:
        holder[rng.choice(TAGS)] = value
        if rng.random() < 0.3 and bpy.data.images:
            holder[TAG] = dict.fromkeys(rng.sample(roles, 4), rng.choice(bpy.data.images))
    except (TypeError, KeyError, AttributeError):
        pass  # of a library


def _structure(rng: Random) -> None:
    """Parents, constraints, modifiers, links between nodes."""
    objects = list(bpy.data.objects)
    if not objects:
        return
    obj, other = rng.choice(objects), rng.choice(objects)
    kind = rng.randrange(6)
    try:
        if kind == 0:
            obj.parent = other
            obj.parent_type = rng.choice(("OBJECT", "VERTEX", "BONE", "LATTICE"))
        elif kind == 1:
            obj.constraints.new(rng.choice(("TRACK_TO", "COPY_TRANSFORMS", "LIMIT_SCALE", "CHILD_OF"))).target = other
        elif kind == 2 and obj.type == "MESH":
            added = obj.modifiers.new("m", rng.choice(MODIFIERS))
            if hasattr(added, "object"):
                added.object = other
        elif kind == 3 and obj.type == "MESH":
            obj.instance_type = rng.choice(("VERTS", "FACES", "COLLECTION"))
        elif kind == 4:
            obj.data = other.data
        else:
            tree = rng.choice([m.node_tree for m in bpy.data.materials])
            source, target = rng.choice(list(tree.nodes)), rng.choice(list(tree.nodes))
            tree.links.new(rng.choice(list(source.outputs)), rng.choice(list(target.inputs)))
    except (TypeError, IndexError, AttributeError, RuntimeError):
        pass  # not between these


def _name(rng: Random) -> None:
    """Names that are hard to write."""
    items = [item for item in stage.everything() if item.library is None]
    try:
        rng.choice(items).name = spoil.word(rng)
    except (TypeError, AttributeError, UnicodeEncodeError):
        pass


def _place(rng: Random) -> None:
    """A matrix that is none."""
    obj = rng.choice(list(bpy.data.objects)) if bpy.data.objects else None
    if obj is None:
        return
    try:
        if rng.random() < 0.5:
            setattr(obj, rng.choice(("scale", "location", "rotation_euler")), [spoil.float32(rng) for _ in range(3)])
        else:
            obj.matrix_parent_inverse = [[spoil.float32(rng) for _ in range(4)] for _ in range(4)]
    except AttributeError:
        pass  # of a library
