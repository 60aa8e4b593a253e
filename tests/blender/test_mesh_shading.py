"""A scan whose file has no normals, or those of its rough corners: how it is shaded."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from irpso_addon.blender.shoot.mesh_file import shade


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("noise", [0.0, 0.15])
def test_a_scan_has_smooth_normals_without_noise(empty, noise, given) -> None:
    """A ball whose corners are off by a part of an edge: they then are nearer to the ball's than the mesh's own."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=6)
    obj = bpy.context.object
    data = obj.data
    corners = np.empty((len(data.vertices), 3), np.float32)
    data.vertices.foreach_get("co", corners.ravel())
    exact = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    edge = np.sqrt(4 * np.pi / len(data.polygons))
    rough = corners + np.random.default_rng(0).normal(0, max(noise, 1e-6) * edge, corners.shape)
    data.vertices.foreach_set("co", rough.astype(np.float32).ravel())
    data.update()
    own = np.empty((len(data.vertices), 3), np.float32)
    data.vertices.foreach_get("normal", own.ravel())
    if given:  # as many programs write them: the mesh's own
        data.shade_smooth()
        data.normals_split_custom_set_from_vertices(own.tolist())
    assert shade(obj) == [f"'{obj.name}': {line}" for line, there in (
        ("its file has no normals, so it was shaded smooth", not given),
        ("the noise of its corners was taken out of its normals (now custom normals)", noise > 0)) if there]
    vertex = np.empty(len(data.loops), np.int32)
    data.loops.foreach_get("vertex_index", vertex)
    of_corner = np.empty((len(data.loops), 3), np.float32)
    data.corner_normals.foreach_get("vector", of_corner.ravel())
    errors = [np.degrees(np.median(np.arccos(np.einsum("nk,nk->n", normals, exact[index]).clip(-1, 1))))
              for normals, index in ((of_corner, vertex), (own, slice(None)))]
    assert errors[0] < (0.7 if noise else 1.01) * errors[1] + 0.05
    assert shade(obj) == []  # it is smooth now


def test_sharp_edges_and_smaller_meshes_stay(empty) -> None:
    """Of a box of many faces, whose edges are sharp; and of what has few."""
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    assert shade(cube) == ["'Cube': its file has no normals, so it was shaded smooth"]
    assert sum(edge.use_edge_sharp for edge in cube.data.edges) == 12
    bpy.ops.mesh.primitive_uv_sphere_add(segments=160, ring_count=80)
    ball = bpy.context.object
    for n, face in enumerate(ball.data.polygons):
        face.use_smooth = n % 3 > 0
    assert shade(ball) == []
    assert not ball.data.has_custom_normals
