"""What an export takes from an object's materials, and what of them it names as lost."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest

from irpso_addon.blender.export_object import with_strength
from irpso_addon.blender.material import material
from irpso_addon.blender.material.surfaces import shown_surfaces, solved_surfaces
from irpso_addon.core.maps.target_export import Surface
from tests.blender import cycles_rig
from tests.blender.export_ball import TEXELS, TOLERANCE, add_normal_map, ball, difference, export, smooth_maps, solution
from tests.blender.materials import make_plane, principled_of


def test_surfaces_are_the_same_by_nodes_and_by_solution(empty) -> None:
    maps = replace(smooth_maps(specular=True), lobes=np.full((TEXELS, TEXELS, 3), 0.5, "f4"))
    maps = replace(maps, metallic=np.zeros((TEXELS, TEXELS), "f4"))
    for number, (model, values, expected) in enumerate([
        ("one-lobe-metallic", {"metallic": {"Skin": 0.75}, "paint": {"Skin": 0.5}}, Surface("Skin", None, 0.5)),
        ("lambert", {}, Surface("Skin", 0.0, 0.0)), ("one-lobe", {}, Surface("Skin", 0.0, 0.5)),
        ("one-lobe-specular", {}, Surface("Skin", 0.0, None)),
        ("one-lobe-specular", {"levels": {"Skin": 0.25}}, Surface("Skin", 0.0, 0.25)),
        ("one-lobe-metallic", {"metallic": {"Skin": 0.75}}, Surface("Skin", 0.75, 0.5)),
        ("two-lobe", {}, Surface("Skin", 0.0, 0.5, "ggx")),
        ("two-lobe", {"ndf": "beckmann"}, Surface("Skin", 0.0, 0.5, "beckmann")),
    ]):
        obj = bpy.data.objects.get("Plane") or make_plane()
        found = solution(model, maps, **values)
        material.write_maps(obj, found)
        assert shown_surfaces(obj, pytest.fail) == solved_surfaces(obj, found) == (expected,), number


def test_what_the_user_linked_is_named(empty, tmp_path: Path) -> None:
    obj = make_plane()
    material.write_maps(obj, solution("one-lobe"))
    shader = obj.data.materials[0]
    noise = shader.node_tree.nodes.new("ShaderNodeTexNoise")
    shader.node_tree.links.new(noise.outputs[0], principled_of(shader).inputs["Metallic"])
    (line,) = export(obj, "blender", tmp_path)
    assert "'Skin'" in line and "Metallic" in line


def test_what_else_a_material_has_is_named(empty, tmp_path: Path) -> None:
    obj = make_plane()
    material.write_maps(obj, solution("one-lobe"))
    inputs = principled_of(obj.data.materials[0]).inputs
    inputs["Emission Strength"].default_value, inputs["Emission Color"].default_value = 1.0, (0, 0, 0, 1)  # dark
    assert export(obj, "blender", tmp_path) == []
    inputs["Sheen Weight"].default_value = 0.5
    assert export(obj, "unity", tmp_path) == [
        "material 'Skin': Sheen Weight is not exported; set it in the other program"]
    inputs["IOR"].default_value, inputs["Specular Tint"].default_value = 1.3, (1, 0.2, 0.1, 1)
    assert export(obj, "gltf", tmp_path) == [
        "material 'Skin': IOR, Sheen Weight, Specular Tint are not exported; set them in the other program"]


def test_files_of_an_earlier_export_are_named(empty, tmp_path: Path) -> None:
    obj = make_plane()
    material.write_maps(obj, solution("one-lobe-specular", levels={"Skin": 0.2}))
    for target in ("blender", "unreal"):
        assert export(obj, target, tmp_path) == export(obj, target, tmp_path) == []
    (tmp_path / "Plane_Normal_2.png").touch()  # somebody else's
    material.write_maps(obj, solution("one-lobe"))
    for target, name in (("blender", "Plane_Specular.png"), ("unreal", "T_Plane_S.png")):
        assert export(obj, target, tmp_path) == [
            f"{tmp_path}: an earlier export left {name}; delete these files, or choose another folder"]


def test_normal_maps_that_differ_are_left_out_and_named(empty, tmp_path: Path) -> None:
    obj = make_plane(materials=("Skin", "Shell"))
    obj.data.polygons[0].material_index = 1
    add_normal_map(obj.data.materials[0])  # no face has it
    pixels = add_normal_map(obj.data.materials[1], strength=1.0)
    material.write_maps(obj, replace(solution("one-lobe"), model={"Skin": "one-lobe", "Shell": "one-lobe"}))
    assert export(obj, "blender", tmp_path / "one") == []
    read = np.asarray(oiio.ImageBuf(str(tmp_path / "one" / "Plane_Normal.png")).get_pixels(oiio.FLOAT))[::-1]
    np.testing.assert_allclose(read, pixels, atol=1e-5)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide()
    bpy.ops.object.mode_set(mode="OBJECT")
    obj.data.polygons[0].material_index = 0
    (line,) = export(obj, "blender", tmp_path / "two")
    assert "Plane" in line and "normal map" in line
    assert not (tmp_path / "two" / "Plane_Normal.png").exists()


@pytest.mark.parametrize(("scale", "bumps", "named"), [
    ((1.4, 1.0, 0.6), True, True), ((1.4, 1.0, 0.6), False, False), ((-1.0, 1.0, 1.0), True, False)])
def test_a_normal_map_on_what_is_scaled_unevenly_is_named(tmp_path: Path, scale, bumps: bool, named: bool) -> None:
    """The glTF then shows the object otherwise than Blender; not without a normal map, nor where it is mirrored."""
    obj = ball(normal_map=bumps)
    obj.scale = scale
    bpy.context.view_layer.update()
    material.write_maps(obj, solution("one-lobe"))
    before = cycles_rig.render()["rgb"]
    assert export(obj, "blender", tmp_path / "blender") == []
    lines = export(obj, "gltf", tmp_path / "out")
    assert [line.partition(": is scaled unevenly")[0] for line in lines] == (["object 'Ball'"] if named else [])
    bpy.data.objects.remove(obj)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "out" / "Ball.glb"))
    assert (difference(before, cycles_rig.render()["rgb"]) > 2 * TOLERANCE[8]) == named


def test_strength_is_applied_as_cycles_does(empty) -> None:
    flat = np.full((2, 2, 3), [0.7, 0.4, 0.9], np.float32)
    np.testing.assert_array_equal(with_strength(flat, 1.0), flat)
    np.testing.assert_allclose(with_strength(flat, 0.0), np.full((2, 2, 3), [0.5, 0.5, 1.0]), atol=1e-7)
    n = np.array([0.4 * 0.5, -0.2 * 0.5, 1 + (0.8 - 1) * 0.5])
    np.testing.assert_allclose(with_strength(flat, 0.5)[0, 0], n / np.linalg.norm(n) / 2 + 0.5, atol=1e-6)
