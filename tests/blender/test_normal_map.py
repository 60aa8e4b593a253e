"""The normal map of a result on materials: its tangents are Blender's, and what was linked comes back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import bpy
import numpy as np

from irpso_addon.blender.export_object import export_object
from irpso_addon.blender.files import map_files, read_maps
from irpso_addon.blender.jobs.solve_region import with_part
from irpso_addon.blender.material import material
from irpso_addon.blender.material.surfaces import solved_surfaces
from irpso_addon.blender.scene.scene_material import SlotNormalMap, read_normal_maps
from irpso_addon.blender.scene.scene_mesh import read_mesh
from irpso_addon.core.data import Maps, MeshArrays, SceneData, Solution
from irpso_addon.core.images.image_file import open_image
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.maps.export import as_stored, layers
from irpso_addon.core.normals.tangent_map import tangents
from tests.blender.materials import SIZE, make_maps, make_plane, make_solution, principled_of, tree_state

ONE = {"Skin": "one-lobe"}


def read(obj: bpy.types.Object, maps: dict[int, SlotNormalMap]) -> MeshArrays:
    bpy.context.view_layer.update()
    return read_mesh(obj, bpy.context.evaluated_depsgraph_get(), maps, lambda _: None)


def with_normals(seed: int = 0) -> Maps:
    maps = make_maps(seed=seed)
    bent = np.random.default_rng(seed).uniform(0.3, 0.7, (SIZE, SIZE, 2)).astype("f4")
    return replace(maps, normal=np.concatenate([bent, np.full((SIZE, SIZE, 1), 0.9, "f4")], -1))


def test_tangents_are_blenders(empty) -> None:
    """Of a monkey with sharp edges, mirrored UVs, n-gons made triangles, unevenly scaled: calc_tangents' own."""
    bpy.ops.mesh.primitive_monkey_add(rotation=(0.3, 0.5, 1.0))
    obj = bpy.context.object
    obj.scale = (1.0, 1.4, -0.7)
    mesh = obj.data
    for face in mesh.polygons:
        face.use_smooth = face.index % 5 != 0
    if not mesh.uv_layers:
        mesh.uv_layers.new(name="UVMap")
    for corner in mesh.uv_layers.active.data:
        corner.uv = abs(corner.uv[0] - 0.5), corner.uv[1]
    flat = SlotNormalMap(np.full((2, 2, 3), 0.5, np.float32), 1.0, "")
    arrays = read(obj, {0: flat})
    found = tangents(arrays)
    assert arrays.tangents is not None
    one, other = (arrays.uvs[:, k] - arrays.uvs[:, 0] for k in (1, 2))
    whole = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) > 1e-9
    cosine = (found[..., :3] * arrays.tangents[..., :3]).sum(-1)[whole]
    degrees = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert np.mean(found[whole, :, 3] == arrays.tangents[whole, :, 3]) > 0.999
    assert np.median(degrees) < 0.05 and np.quantile(degrees, 0.97) < 0.5


def test_the_map_is_linked_and_goes_again(empty) -> None:
    """A result with normals, twice, then one without: what was linked to Normal is linked again."""
    obj = make_plane()
    tree = obj.material_slots[0].material.node_tree
    principled = principled_of(obj.material_slots[0].material)
    bump = tree.nodes.new("ShaderNodeBump")
    tree.links.new(bump.outputs["Normal"], principled.inputs["Normal"])
    material.write_maps(obj, make_solution(ONE))
    before = tree_state(tree)
    for seed in (0, 1):
        assert not material.write_maps(obj, make_solution(ONE, with_normals(seed)))
        node = principled.inputs["Normal"].links[0].from_node
        texture = node.inputs["Color"].links[0].from_node
        assert node.bl_idname == "ShaderNodeNormalMap" and node.space == "TANGENT"
        assert node.inputs["Strength"].default_value == 1.0
        assert texture.image.colorspace_settings.is_data and texture.image.name == "Plane_normal"
        assert len([n for n in tree.nodes if n.bl_idname == "ShaderNodeNormalMap"]) == 1
    np.testing.assert_allclose(read_maps(obj).normal, with_normals(1).normal, atol=1e-7)
    material.write_maps(obj, make_solution(ONE))
    assert tree_state(tree) == before
    assert "Plane_normal" not in bpy.data.images and read_maps(obj).normal is None


def test_the_next_solve_reads_what_the_user_had(empty) -> None:
    """Its own normals would be refined once more."""
    obj = make_plane()
    shader = obj.material_slots[0].material
    tree = shader.node_tree
    texture, node = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image = bpy.data.images.new("Mine", 4, 4, float_buffer=True, is_data=True)
    texture.image.pixels.foreach_set(np.tile(np.float32([0.6, 0.4, 0.9, 1.0]), 16))
    tree.links.new(texture.outputs["Color"], node.inputs["Color"])
    tree.links.new(node.outputs["Normal"], principled_of(shader).inputs["Normal"])
    material.write_maps(obj, make_solution(ONE, with_normals()))
    found = read_normal_maps(obj, lambda _: None)
    np.testing.assert_allclose(found[0].pixels[0, 0], [0.6, 0.4, 0.9], atol=1e-6)
    plain = make_plane("Plain", ("Bare",))
    material.write_maps(plain, make_solution({"Bare": "one-lobe"}, with_normals()))
    assert not read_normal_maps(plain, lambda _: None)


def test_a_part_is_solved_under_the_normals_of_the_rest(empty) -> None:
    obj = make_plane()
    material.write_maps(obj, make_solution(ONE, with_normals()))
    mesh = read(obj, {})
    data = SceneData("scene", mesh, np.zeros((0, 3, 3), np.float32), ())
    group = obj.vertex_groups.new(name="Part")
    group.add([0, 1, 2, 3], 1.0, "REPLACE")
    part = with_part(bpy.context, obj, data, "anew", "GROUP", "Part")
    assert part.mesh.normal_maps[0].strength == 1.0 and part.mesh.tangents is not None
    np.testing.assert_allclose(part.mesh.normal_maps[0].pixels, with_normals().normal, atol=1e-7)


def test_exports_have_it(empty, tmp_path: Path) -> None:
    """glTF's green is up, Unreal's down."""
    obj, maps = make_plane(), with_normals()
    solution: Solution = make_solution(ONE, maps)
    material.write_maps(obj, solution)
    for target, name, green in (("gltf", "Plane_normal.png", 1), ("unreal", "T_Plane_N.png", -1)):
        paths, _ = export_object(obj, maps, solved_surfaces(obj, solution), target, tmp_path / target)
        assert tmp_path / target / name in paths
        file = open_image(tmp_path / target / name)
        stored = file.read(0, file.height)[::-1, :, :3]
        expected = (maps.normal - 0.5) * [1, green, 1] + 0.5
        np.testing.assert_allclose(stored, expected, atol=0.003)


def test_exports_have_the_normals_of_the_result_that_is_exported(empty, tmp_path: Path) -> None:
    """Whatever the material shows now: nothing, or another result's."""
    obj, with_map, without = make_plane(), with_normals(), make_solution(ONE, make_maps(seed=1))
    solution = make_solution(ONE, with_map)
    paths, lost = export_object(obj, with_map, solved_surfaces(obj, solution), "gltf", tmp_path / "bare")
    assert tmp_path / "bare" / "Plane_normal.png" in paths and not lost
    material.write_maps(obj, solution)
    paths, _ = export_object(obj, without.maps, solved_surfaces(obj, without), "gltf", tmp_path / "other")
    assert not [path for path in paths if "normal" in path.name]


def test_normal_maps_of_several_udims(empty, tmp_path: Path) -> None:
    """Linked as one tiled image of data, and exported one by one; MaterialX names all of them in one path."""
    obj, udims = make_plane(), (1001, 1002)
    each = {udim: with_normals(udim) for udim in udims}
    solution = make_solution(ONE, each[1001])
    files = material.files_of("Plane", solution.maps, tmp_path, "exr", udims)
    for udim, maps in each.items():
        for layer, array in layers(maps).items():
            write_image(files.of(layer, udim), as_stored(layer, array), kind="exr", color=layer == "basecolor")
    assert not material.link_maps(obj, solution, tmp_path, "exr", udims)
    node = principled_of(obj.material_slots[0].material).inputs["Normal"].links[0].from_node
    image = node.inputs["Color"].links[0].from_node.image
    assert node.bl_idname == "ShaderNodeNormalMap" and image.source == "TILED" and image.colorspace_settings.is_data
    assert tuple(tile.number for tile in image.tiles) == udims and image.filepath.endswith("Plane_normal.<UDIM>.exr")
    kept = map_files(obj)
    assert kept is not None and "normal" in kept.paths
    for target, name, green in (("unreal", "T_Plane_N", -1), ("materialx", "Plane_geometry_normal", 1)):
        paths, lost = export_object(obj, kept, solved_surfaces(obj, solution), target, tmp_path / target)
        assert not lost
        for udim, maps in each.items():
            path = tmp_path / target / f"{name}.{udim}.png"
            assert path in paths
            file = open_image(path)
            stored = file.read(0, file.height)[::-1, :, :3]
            np.testing.assert_allclose(stored, (maps.normal - 0.5) * [1, green, 1] + 0.5, atol=0.003)
    document = ElementTree.parse(tmp_path / "materialx" / "Plane.mtlx")
    assert "Plane_geometry_normal.<UDIM>.png" in {value.get("value") for value in document.iter("input")}


def test_a_normal_map_is_read_though_somebody_deleted_the_node_that_replaced_it(empty) -> None:
    obj = make_plane()
    principled = principled_of(obj.data.materials[0])
    tree = principled.id_data
    own, texture = tree.nodes.new("ShaderNodeNormalMap"), tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("Bumps", 4, 4, float_buffer=True, is_data=True)
    tree.links.new(texture.outputs["Color"], own.inputs["Color"])
    tree.links.new(own.outputs["Normal"], principled.inputs["Normal"])
    material.write_maps(obj, make_solution(ONE, with_normals()))
    tree.nodes.remove(principled.inputs["Normal"].links[0].from_node)
    assert read_normal_maps(obj, lambda _: None)[0].pixels.shape == (4, 4, 3)
