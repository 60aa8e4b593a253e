"""Geometry in: what read_scene gives against Blender's own data and mathutils, one object at a time."""

from __future__ import annotations

import math

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from irpso_addon.core.errors import BadInput


def replace_mesh(obj, build):
    """Puts the faces that ``build(bm)`` makes on ``obj``, with UVs x, y; the material stays."""
    bm = bmesh.new()
    build(bm)
    layer = bm.loops.layers.uv.new("UVMap")
    for face in bm.faces:
        for loop in face.loops:
            loop[layer].uv = (loop.vert.co.x, loop.vert.co.y)
    bm.to_mesh(obj.data)
    bm.free()


def ball(bm):
    bmesh.ops.create_uvsphere(bm, u_segments=12, v_segments=7, radius=1)


def area(triangles):
    a, b, c = triangles.swapaxes(0, 1)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def face_normals(mesh):
    n = np.cross(mesh.positions[:, 1] - mesh.positions[:, 0], mesh.positions[:, 2] - mesh.positions[:, 0])
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def test_ngons_become_triangles_of_the_same_area(stage):
    def ngon(bm):
        corners = [(0, 0), (2, 0), (2, 2), (1, 0.5), (0, 2)]  # not convex
        bm.faces.new([bm.verts.new((x, y, 0)) for x, y in corners])

    replace_mesh(stage.subject, ngon)
    mesh = stage.read().mesh
    assert mesh.positions.shape == (3, 3, 3) and mesh.normals.dtype == np.float32
    assert area(mesh.positions) == pytest.approx(stage.subject.data.polygons[0].area, rel=1e-6)
    np.testing.assert_allclose(mesh.uvs, mesh.positions[..., :2], atol=1e-6)
    assert (face_normals(mesh)[:, 2] > 0.999).all()


@pytest.mark.parametrize("scale", [(1, 1, 1), (1.5, 0.4, 2), (-1, 1, 1), (-1, 1.4, -0.7), (-2, -0.5, -1)])
def test_normals_under_scale(stage, scale):
    """A ball becomes an ellipsoid, whose true normal is the gradient of its equation."""
    replace_mesh(stage.subject, ball)
    stage.subject.data.shade_smooth()
    stage.subject.data.normals_split_custom_set_from_vertices([v.co.normalized() for v in stage.subject.data.vertices])
    place = Matrix.Translation((3, 1, -2)) @ Matrix.Rotation(0.7, 4, "Y")
    stage.subject.matrix_world = place @ Matrix.Diagonal((*scale, 1))
    read = stage.read()
    mesh = read.mesh
    assert any("mirrored" in w for w in read.warnings) == (math.prod(scale) < 0)
    turn = np.array(Matrix.Rotation(0.7, 3, "Y"))
    local = (mesh.positions - np.float32([3, 1, -2])) @ turn
    gradient = local / np.square(np.float32(scale))
    true = gradient / np.linalg.norm(gradient, axis=-1, keepdims=True) @ turn.T
    degrees = np.degrees(np.arccos(np.clip((mesh.normals * true).sum(-1), -1, 1)))
    assert degrees.max() < 0.1  # custom normals are stored in 16 bits
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-6)
    # Counter-clockwise from outside, mirrored or not.
    assert ((face_normals(mesh) * mesh.normals.mean(1)).sum(-1) > 0.5).all()


def test_flat_and_custom_normals(stage):
    replace_mesh(stage.subject, ball)
    stage.subject.data.shade_flat()
    mesh = stage.read().mesh
    np.testing.assert_allclose(mesh.normals, np.repeat(face_normals(mesh)[:, None], 3, 1), atol=2e-3)
    stage.subject.data.shade_smooth()
    wanted = Vector((0.3, 0.2, 0.9)).normalized()
    stage.subject.data.normals_split_custom_set([wanted] * len(stage.subject.data.loops))
    np.testing.assert_allclose(stage.read().mesh.normals, np.broadcast_to(wanted, (*mesh.slots.shape, 3, 3)), atol=2e-3)


def test_modifiers_parents_and_constraints(stage):
    empty = bpy.data.objects.new("Parent", None)
    stage.scene.collection.objects.link(empty)
    empty.matrix_world = Matrix.Rotation(0.5, 4, "X") @ Matrix.Diagonal((2, 1, 0.5, 1))
    stage.subject.parent = empty
    stage.subject.location = (0, 0, 1)
    limit = stage.subject.constraints.new("COPY_ROTATION")
    limit.target = stage.key
    stage.key.rotation_euler = (0, 0, 0.3)
    array = stage.subject.modifiers.new("Array", "ARRAY")
    array.count = 3
    mesh = stage.read().mesh
    assert len(mesh.slots) == 6
    bpy.context.view_layer.update()
    world = stage.subject.matrix_world
    corners = [world @ (v.co + Vector((2 * i, 0, 0))) for v in stage.subject.data.vertices for i in range(3)]
    distance = np.linalg.norm(mesh.positions.reshape(-1, 1, 3) - np.array(corners), axis=-1)
    assert distance.min(0).max() < 1e-5 and distance.min(1).max() < 1e-5


def test_material_slots(stage):
    replace_mesh(stage.subject, lambda bm: bmesh.ops.create_grid(bm, x_segments=3, y_segments=1, size=1))
    stage.subject.data.materials.append(None)
    stage.subject.data.materials.append(bpy.data.materials.new("Object's own"))
    stage.subject.material_slots[0].link = "OBJECT"
    stage.subject.material_slots[0].material = stage.subject.data.materials[2]
    for polygon, index in zip(stage.subject.data.polygons, (2, 1, 30), strict=True):
        polygon.material_index = index  # 30: beyond the slots, as other programs leave it
    mesh = stage.read().mesh
    assert mesh.slot_names == ("Object's own", "", "Object's own")
    assert mesh.slots.tolist() == [2, 2, 1, 1, 2, 2] and mesh.slots.dtype == np.int32


@pytest.mark.parametrize("slots", ["one", "empty", "none"])
def test_materials_that_geometry_nodes_set(stage, slots):
    """Cycles shows theirs and not the slots': maps on the slots would be seen nowhere."""
    subject, clay = stage.subject, bpy.data.materials.new("Clay")
    if slots == "none":
        subject.data.materials.clear()
    elif slots == "empty":
        subject.material_slots[0].material = None
    group = bpy.data.node_groups.new("Sets", "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    given, put, result = (group.nodes.new(kind) for kind in (
        "NodeGroupInput", "GeometryNodeSetMaterial", "NodeGroupOutput"))
    group.links.new(given.outputs[0], put.inputs["Geometry"])
    group.links.new(put.outputs[0], result.inputs[0])
    subject.modifiers.new("Clay", "NODES").node_group = group
    put.inputs["Material"].default_value = clay
    with pytest.raises(BadInput, match=r"^object 'Subject': its modifiers give all faces material 'Clay'"):
        stage.read()
    put.inputs["Selection"].default_value = False
    assert not any("Clay" in line for line in stage.read().warnings)
    put.inputs["Selection"].default_value = True
    subject.data.materials.clear()
    subject.data.materials.append(clay)
    read = stage.read()
    assert read.mesh.slot_names == ("Clay",) and not any("modifiers" in line for line in read.warnings)


def test_materials_that_a_boolean_brings_along(stage):
    bpy.ops.mesh.primitive_cube_add(size=1)
    cutter = bpy.context.object
    cutter.data.materials.append(bpy.data.materials.new("Cut"))
    cutter.hide_render = True
    replace_mesh(stage.subject, lambda bm: bmesh.ops.create_cube(bm, size=1, calc_uvs=True))
    cutter.location = (0.5, 0.5, 0.5)
    modifier = stage.subject.modifiers.new("Cut", "BOOLEAN")
    modifier.object, modifier.material_mode = cutter, "TRANSFER"
    read = stage.read()
    assert [line for line in read.warnings if "its modifiers give" in line and "'Cut'" in line]
    assert set(read.mesh.slots) == {0}
    cutter.material_slots[0].material = None
    assert stage.read().mesh.slots.min() >= 0  # Blender 5.2 gives these faces material -1


def test_the_uv_map_that_renders(stage):
    layers = stage.subject.data.uv_layers
    other = layers.new(name="Other")
    for item in other.uv:
        item.vector = (0.25, 0.25)
    layers.active = other
    read = stage.read()
    assert np.ptp(read.mesh.uvs) == 1 and any("'UVMap' is used" in w for w in read.warnings)
    other.active_render = True
    with pytest.raises(BadInput, match="'Subject': its UV map has no area"):
        stage.read()


def test_edit_mode(stage):
    before = stage.read().mesh
    with bpy.context.temp_override(active_object=stage.subject, object=stage.subject):
        bpy.context.view_layer.objects.active = stage.subject
        bpy.ops.object.mode_set(mode="EDIT")
        bm = bmesh.from_edit_mesh(stage.subject.data)
        for vertex in bm.verts:
            vertex.co.z += 0.5
        bmesh.update_edit_mesh(stage.subject.data)
    mesh = stage.read().mesh
    assert stage.subject.mode == "EDIT"
    np.testing.assert_allclose(mesh.positions[..., 2], before.positions[..., 2] + 0.5, atol=1e-6)
    bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda o: o.data.clear_geometry(), "no faces"),
    (lambda o: o.data.uv_layers.remove(o.data.uv_layers[0]), "no UV map"),
    (lambda o: [setattr(d, "vector", (0.5, 0.5)) for d in o.data.uv_layers[0].uv], "no area"),
    (lambda o: setattr(o.data.uv_layers[0].uv[1], "vector", (math.nan, 0)), "UVs that are not finite"),
    (lambda o: o.data.vertices.foreach_set("co", np.full(12, np.inf, np.float32)), "vertices that are not finite"),
    (lambda o: setattr(o, "scale", (1, 0, 1)), "scale is 0"),
    (lambda o: setattr(o, "scale", (0, 0, 0)), "scale is 0"),
])
def test_unusable_objects(stage, spoil, words):
    spoil(stage.subject)
    stage.subject.data.update()
    with pytest.raises(BadInput, match=f"^object 'Subject': .*{words}") as caught:
        stage.read()
    assert "\n" not in str(caught.value)


def test_what_casts_shadows(stage):
    """One triangle each, marked by its height; only what a render shows counts."""

    def triangle(name, z):
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
        obj = bpy.data.objects.new(name, mesh)
        obj.location.z = z
        stage.scene.collection.objects.link(obj)
        return obj

    triangle("plain", 1)
    triangle("eye", 2).hide_set(True)
    triangle("monitor", 3).hide_viewport = True
    triangle("camera icon", 4).hide_render = True
    mirrored = triangle("array", 5)
    mirrored.modifiers.new("A", "ARRAY").relative_offset_displace = (0, 0, 0)
    mirrored.modifiers["A"].constant_offset_displace = (0, 0, 1)
    mirrored.modifiers["A"].use_constant_offset = True
    unseen = triangle("unseen", 7)
    unseen.visible_camera = unseen.visible_shadow = False
    triangle("screen", 30).visible_camera = False
    for name, z, where in (("excluded", 8, "exclude"), ("collection", 9, "hide_render"), ("instanced", 10, "exclude")):
        collection = bpy.data.collections.new(name)
        stage.scene.collection.children.link(collection)
        obj = triangle(name, z)
        stage.scene.collection.objects.unlink(obj)
        collection.objects.link(obj)
        layer = bpy.context.view_layer.layer_collection.children[name]
        if where == "exclude":
            layer.exclude = True
        else:
            collection.hide_render = True
    instancer = bpy.data.objects.new("Instancer", None)
    instancer.instance_type, instancer.instance_collection = "COLLECTION", bpy.data.collections["instanced"]
    instancer.location.z, instancer.scale = 1, (2, 2, 2)
    stage.scene.collection.objects.link(instancer)
    read = stage.read()
    assert sorted(read.occluders[:, 0, 2].tolist()) == [1, 2, 3, 5, 6, 21]
    assert read.unseen[:, 0, 2].tolist() == [30]
    assert sorted(read.casters[:, 0, 2].tolist()) == [1, 2, 3, 5, 6, 21, 30]
    assert len(read.mesh.slots) == 2 and not read.warnings


def test_curves_text_and_metaballs_cast_shadows_once(stage):
    assert len(stage.read().occluders) == 0
    bpy.ops.object.text_add()
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.modifiers.new("Sub", "SUBSURF").levels = 1
    bpy.context.object.modifiers["Sub"].render_levels = 1
    count = len(stage.read().occluders)
    text = bpy.data.objects["Text"].evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    text.calc_loop_triangles()
    assert count == len(text.loop_triangles) + 48
    bpy.data.objects["Text"].evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh_clear()
    for add in (bpy.ops.object.metaball_add, bpy.ops.surface.primitive_nurbs_surface_torus_add):
        add()
        more = len(stage.read().occluders)
        assert more > count
        count = more


def test_modifiers_that_differ_in_render_are_named(stage):
    sub = stage.subject.modifiers.new("Subdivision", "SUBSURF")
    sub.levels, sub.render_levels = 1, 2
    assert any("'Subdivision' differs" in w for w in stage.read().warnings)
    sub.levels = 2
    assert not stage.read().warnings
    assert len(stage.read().mesh.slots) == 32


def test_instances_of_geometry_nodes_are_named(stage):
    group = bpy.data.node_groups.new("Points", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeInstanceOnPoints", "GeometryNodeMeshCube", "GeometryNodeJoinGeometry",
             "NodeGroupOutput")
    source, instance, cube, join, output = (group.nodes.new(kind) for kind in kinds)
    group.links.new(source.outputs[0], instance.inputs["Points"])
    group.links.new(cube.outputs[0], instance.inputs["Instance"])
    group.links.new(instance.outputs[0], join.inputs[0])
    group.links.new(source.outputs[0], join.inputs[0])
    group.links.new(join.outputs[0], output.inputs[0])
    stage.subject.modifiers.new("Nodes", "NODES").node_group = group
    read = stage.read()
    assert len(read.mesh.slots) == 2 and len(read.occluders) == 0
    assert any("realize" in w for w in read.warnings)


def test_too_much_geometry(stage, monkeypatch):
    from irpso_addon.blender.scene import scene_mesh

    monkeypatch.setattr(scene_mesh, "MAX_TRIANGLES", 10_000)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=6)
    with pytest.raises(BadInput, match="'Icosphere': the scene has more than"):
        stage.read()
