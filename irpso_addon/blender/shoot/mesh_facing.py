"""Whether a mesh's faces look to the cameras: some programs write them inside out."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ...core.data import F64
from ...core.phrases import percent
from ...core.shoot.picture_lens import PictureCamera

CAMERAS, PLACES = 16, 64  # from each of so many, rays to so many places of the mesh
FEW = 50  # hits that tell nothing
INWARDS = 0.5  # share of the hits that see a back, from which on the whole mesh is taken to be inside out


def face_cameras(mesh: bpy.types.Object, cameras: Sequence[PictureCamera], scale: float) -> list[str]:
    """Turns all faces round where the cameras, whose project has units of ``scale`` metres, see backs; a line then."""
    bpy.context.view_layer.update()
    chosen = np.unique(np.linspace(0, len(cameras) - 1, CAMERAS).astype(int)) if cameras else []
    share = _backs(mesh, np.array([cameras[i].world_from_camera[:3, 3] * scale for i in chosen]))
    if not share > INWARDS:
        return []
    mesh.data.flip_normals()
    _turn_custom_normals(mesh.data)
    return [f"'{mesh.name}': its faces look inwards ({percent(share)} of what the cameras see of them are backs); they "
            "were turned round"]


def _backs(mesh: bpy.types.Object, places: F64) -> float:
    """Share of backs, by corners' order, among the faces that are seen first from ``places`` (n, 3); NaN: too few."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    shape = mesh.evaluated_get(depsgraph)
    tree, faces = BVHTree.FromObject(shape, depsgraph), shape.data.polygons
    inverse = shape.matrix_world.inverted_safe()
    rng = np.random.default_rng(0)
    backs = []
    for place in places:
        origin = inverse @ Vector(place)
        for face in rng.integers(len(faces), size=PLACES).tolist():
            way = faces[face].center - origin
            hit, normal, _, _ = tree.ray_cast(origin, way.normalized())
            if hit is not None:
                backs.append(normal.dot(way) > 0)
    return float(np.mean(backs)) if len(backs) >= FEW else float("nan")


def _turn_custom_normals(mesh: bpy.types.Mesh) -> None:
    """Those of the file may have looked outwards before, and were turned along with the faces."""
    if not mesh.has_custom_normals:
        return
    normals = [normal.vector.copy() for normal in mesh.corner_normals]
    flat = [face.normal for face in mesh.polygons for _ in face.loop_indices]
    if np.mean([normal.dot(face) < 0 for normal, face in zip(normals, flat, strict=True)]) > INWARDS:
        mesh.normals_split_custom_set([tuple(-normal) for normal in normals])
