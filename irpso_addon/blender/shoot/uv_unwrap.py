"""A UV map for a mesh that has none: Blender's, or charts of its own for a scan."""

from __future__ import annotations

import math

import bpy
import numpy as np

from ...core.data import F64
from ...core.phrases import percent
from ...core.shoot import uv_charts
from ..scene.scene_mesh import integers
from .mesh_file import deselect

MARGIN = 0.002  # of the map between charts
USED = 0.4  # of the map: less is wasted on margins around small islands


def unwrap(mesh: bpy.types.Object) -> list[str]:
    """A material and a UV map where there is none; lines for the user."""
    if not any(slot.material for slot in mesh.material_slots):
        material = bpy.data.materials.new(mesh.name)
        if bpy.app.version < (5, 0, 0):
            material.use_nodes = True
        if not mesh.material_slots:
            mesh.data.materials.append(None)
        for slot in mesh.material_slots:  # which faces and other objects with this mesh may use
            slot.material = material
    if mesh.data.uv_layers:
        return []
    deselect()
    bpy.context.view_layer.objects.active = mesh
    mesh.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.reveal()
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(angle_limit=math.radians(66), island_margin=MARGIN)
    bpy.ops.object.mode_set(mode="OBJECT")
    used, how = _used(mesh.data), "Smart UV Project"
    if used < USED:
        uvs = _floats(mesh.data.uv_layers[0].uv, "vector", 2)
        count = _project(mesh.data)
        if _used(mesh.data) > used:
            how = f"{count} charts, because Smart UV Project would use {percent(used)} of it"
        else:
            mesh.data.uv_layers[0].uv.foreach_set("vector", uvs.astype(np.float32).ravel())
    return [f"'{mesh.name}': has no UV map; one was made ({how})"]


def _used(mesh: bpy.types.Mesh) -> float:
    """Share of the map that faces cover."""
    mesh.calc_loop_triangles()
    uvs = _floats(mesh.uv_layers[0].uv, "vector", 2)[integers(mesh.loop_triangles, "loops", 3)]
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    return float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)


def _project(mesh: bpy.types.Mesh) -> int:
    """The mesh's UVs as charts, packed; how many there are."""
    face = np.repeat(np.arange(len(mesh.polygons)), integers(mesh.polygons, "loop_total", 1)[:, 0])
    edge = integers(mesh.loops, "edge_index", 1)[:, 0]
    order = np.argsort(edge, kind="stable")
    shared = np.flatnonzero(np.diff(edge[order]) == 0)
    centers, normals, areas = (_floats(mesh.polygons, name, width) for name, width in (
        ("center", 3), ("normal", 3), ("area", 1)))
    pairs = np.stack([face[order[shared]], face[order[shared + 1]]], axis=1)
    charts = uv_charts.charts_of(uv_charts.Faces(centers, normals, areas[:, 0], pairs))
    corners = _floats(mesh.vertices, "co", 3)[integers(mesh.loops, "vertex_index", 1)[:, 0]]
    mesh.uv_layers[0].uv.foreach_set("vector", charts.places(face, corners).astype(np.float32).ravel())
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.uv.select_all(action="SELECT")
    # By boxes: by outlines, a million faces take minutes.
    bpy.ops.uv.pack_islands(margin=MARGIN, margin_method="FRACTION", shape_method="AABB")
    bpy.ops.object.mode_set(mode="OBJECT")
    return len(charts.frames)


def _floats(collection: bpy.types.bpy_prop_collection, attribute: str, width: int) -> F64:
    out = np.empty(len(collection) * width, np.float32)
    collection.foreach_get(attribute, out)
    return out.reshape(-1, width).astype(np.float64)
