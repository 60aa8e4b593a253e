"""Two lobes and the specular level on materials: one set of nodes, nothing of the user's lost, and the way back."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.blender import files
from irpso_addon.blender.jobs import solve_region
from irpso_addon.blender.material import material
from irpso_addon.blender.scene.scene_material import read_normal_maps
from irpso_addon.core.data import Coat, JointPrior, Maps, Solution
from irpso_addon.core.errors import BadInput
from irpso_addon.core.maps.export import layers
from tests.blender.materials import (
    bake,
    make_maps,
    make_material,
    make_plane,
    make_solution,
    principled_of,
    source,
    tree_state,
)


def wide_maps(specular: bool = False) -> Maps:
    """Maps of a solve in which some material has two lobes."""
    maps, rng = make_maps(), np.random.default_rng(9)
    more = rng.uniform(0, 1, (*maps.roughness.shape, 2)).astype("f4")
    level = rng.uniform(0, 1, maps.roughness.shape).astype("f4") if specular else None
    return replace(maps, lobes=np.concatenate([maps.roughness[..., None], more], axis=-1), specular=level)


def two_lobe(ndf: str = "ggx", **model: str) -> Solution:
    return replace(make_solution(model or {"Skin": "two-lobe"}, wide_maps()), ndf=ndf)


def group_of(shader: bpy.types.Material) -> bpy.types.Node:
    (node,) = (n for n in shader.node_tree.nodes if n.bl_idname == "ShaderNodeGroup")
    return node


def rich_plane() -> tuple[bpy.types.Object, bpy.types.Material]:
    """A material with a normal map, a mix shader behind the Principled, values, a link and a frame of the user's."""
    obj = make_plane()
    shader = obj.material_slots[0].material
    nodes, links = shader.node_tree.nodes, shader.node_tree.links
    principled, output = principled_of(shader), shader.node_tree.get_output_node("ALL")
    mix, glossy, frame = (nodes.new(k) for k in ("ShaderNodeMixShader", "ShaderNodeBsdfGlossy", "NodeFrame"))
    links.new(glossy.outputs[0], mix.inputs[1])
    links.new(principled.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], output.inputs["Surface"])
    texture, normal, value = (nodes.new(f"ShaderNode{k}") for k in ("TexImage", "NormalMap", "Value"))
    texture.image = bpy.data.images.new("Bumps", 4, 4, is_data=True)
    links.new(texture.outputs["Color"], normal.inputs["Color"])
    links.new(normal.outputs["Normal"], principled.inputs["Normal"])
    links.new(value.outputs[0], principled.inputs["Metallic"])
    principled.inputs["Coat Weight"].default_value = 0.25
    principled.label, principled.parent, principled.name = "Mine", frame, "Hautfläche"
    return obj, shader


@pytest.mark.parametrize("ndf", ["ggx", "beckmann"])
def test_running_twice_leaves_one_set(empty, ndf: str) -> None:
    obj, shader = rich_plane()
    material.write_maps(obj, two_lobe(ndf))
    once = tree_state(shader.node_tree)
    counts = len(bpy.data.images), len(bpy.data.materials), len(bpy.data.node_groups)
    assert counts[2] == 1
    for _ in range(2):
        assert material.write_maps(obj, two_lobe(ndf)) == ()
    assert tree_state(shader.node_tree) == once
    assert (len(bpy.data.images), len(bpy.data.materials), len(bpy.data.node_groups)) == counts


def test_the_group_takes_the_place_of_the_principled(empty) -> None:
    obj, shader = rich_plane()
    principled, node_of = principled_of(shader), shader.node_tree.nodes
    material.write_maps(obj, two_lobe())
    node = group_of(shader)
    assert not principled.outputs["BSDF"].is_linked
    assert [link.to_node.bl_idname for link in node.outputs["BSDF"].links] == ["ShaderNodeMixShader"]
    assert node.inputs["Normal"].links[0].from_node.bl_idname == "ShaderNodeNormalMap"
    assert node.inputs["Metallic"].links[0].from_node.bl_idname == "ShaderNodeValue"
    assert node.inputs["Coat Weight"].default_value == 0.25
    separate = node.inputs["Weight"].links[0].from_node
    sockets = [node.inputs[name].links[0].from_socket for name in ("Roughness 1", "Roughness 2", "Weight")]
    assert sockets == list(separate.outputs)
    image = separate.inputs[0].links[0].from_node.image
    assert image == bpy.data.images["Plane_roughness"] and image.colorspace_settings.is_data
    assert node.inputs["Base Color"].links[0].from_node.image == bpy.data.images["Plane_basecolor"]
    assert node.node_tree.name == "IRPSO Two-Lobe" and node.parent == principled.parent
    assert node_of["Hautfläche"].hide


def test_back_and_forth_between_the_models(empty) -> None:
    """Whatever came between, the tree is that of a first one-lobe solve, and the reverse."""
    obj, shader = rich_plane()
    tree = shader.node_tree
    one = make_solution({"Skin": "one-lobe"}, make_maps())
    material.write_maps(obj, one)
    before = tree_state(tree)
    level = replace(make_solution({"Skin": "one-lobe-specular"}, make_maps()), levels={"Skin": 0.75})
    metal = replace(make_solution({"Skin": "one-lobe-metallic"}, make_maps()), metallic={"Skin": 0.5})
    for between in (two_lobe(), two_lobe("beckmann"), make_solution({"Skin": "lambert"}), level, metal):
        material.write_maps(obj, between)
        material.write_maps(obj, two_lobe())
        assert group_of(shader).inputs["Specular IOR Level"].default_value == 0.5
        material.write_maps(obj, between)
        assert tree_state(tree) != before
        material.write_maps(obj, one)
        assert tree_state(tree) == before
        assert not bpy.data.node_groups
    assert len(bpy.data.images) == 7  # six maps and the normal map


def test_the_first_solve_may_be_two_lobe(empty) -> None:
    obj, shader = rich_plane()
    before = tree_state(shader.node_tree)
    material.write_maps(obj, two_lobe())
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    after = tree_state(shader.node_tree)
    assert {name: after[name] for name in before if name != "links"} == {
        name: state for name, state in before.items() if name != "links"}
    assert set(before["links"]) < set(after["links"])
    assert {link[2:] for link in set(after["links"]) - set(before["links"])} == {
        ("Hautfläche", "Base Color"), ("Hautfläche", "Roughness")}


def test_a_choice_that_only_a_newer_blender_knows(empty) -> None:
    """A file that 5.2 saved has a subsurface method that 4.5 reads as none: so written here, into the node's memory."""
    obj = make_plane()
    principled = principled_of(obj.data.materials[0])
    memory = (ctypes.c_int16 * 256).from_address(principled.as_pointer())
    states = []
    for method in ("BURLEY", "RANDOM_WALK") * 2:  # twice: what lies behind the node may change meanwhile, too
        principled.subsurface_method = method
        states.append(list(memory))
    (place,) = [i for i, (one, other, *again) in enumerate(zip(*states, strict=True))
                if one != other and again == [one, other]]
    memory[place] = 99
    assert principled.subsurface_method == ""
    material.write_maps(obj, two_lobe())
    assert len(group_of(obj.data.materials[0]).node_tree.nodes) > 2
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert memory[place] == 99  # the user's own is as it was


def test_what_the_user_changes_on_the_group_stays(empty) -> None:
    obj, shader = rich_plane()
    material.write_maps(obj, two_lobe())
    node, tree = group_of(shader), shader.node_tree
    node.inputs["Coat Weight"].default_value = 0.5
    node.location = (123, 456)
    tree.links.remove(node.inputs["Metallic"].links[0])
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs[0], node.inputs["Sheen Weight"])
    material.write_maps(obj, two_lobe())
    assert group_of(shader) == node and tuple(node.location) == (123, 456)
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    principled = principled_of(shader)
    assert principled.inputs["Coat Weight"].default_value == 0.5 and not principled.inputs["Metallic"].is_linked
    assert principled.inputs["Sheen Weight"].links[0].from_node == noise
    assert (principled.label, principled.hide) == ("Mine", False)


def test_a_principled_that_was_deleted_is_made_anew(empty) -> None:
    obj, shader = rich_plane()
    material.write_maps(obj, two_lobe())
    shader.node_tree.nodes.remove(principled_of(shader))
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    principled = principled_of(shader)
    assert principled.inputs["Coat Weight"].default_value == 0.25
    assert principled.inputs["Normal"].links[0].from_node.bl_idname == "ShaderNodeNormalMap"
    assert principled.outputs["BSDF"].links[0].to_node.bl_idname == "ShaderNodeMixShader"
    assert not bpy.data.node_groups


@pytest.mark.parametrize("ndf", ["ggx", "beckmann"])
def test_undo(empty, ndf: str) -> None:
    _, shader = rich_plane()
    before = tree_state(shader.node_tree)
    bpy.ops.ed.undo_push(message="before")
    material.write_maps(bpy.data.objects["Plane"], two_lobe(ndf))
    after = tree_state(bpy.data.materials["Skin"].node_tree)
    bpy.ops.ed.undo_push(message="written")
    bpy.ops.ed.undo()
    assert tree_state(bpy.data.materials["Skin"].node_tree) == before
    assert not bpy.data.node_groups and "irpso" not in bpy.data.objects["Plane"]
    bpy.ops.ed.redo()
    assert tree_state(bpy.data.materials["Skin"].node_tree) == after
    material.write_maps(bpy.data.objects["Plane"], two_lobe(ndf))
    assert tree_state(bpy.data.materials["Skin"].node_tree) == after


def test_materials_of_different_models(empty) -> None:
    """One set of images for all; each material's nodes are those of its own model."""
    models = {"Chalk": "lambert", "Wood": "one-lobe", "Silk": "one-lobe-specular"} | dict.fromkeys(
        ("Skin", "Lips"), "two-lobe")
    obj = make_plane(materials=tuple(models))
    solution = replace(make_solution(models, wide_maps()), levels={"Silk": 0.75})
    for _ in range(2):
        assert material.write_maps(obj, solution) == ()
    shaders = {name: bpy.data.materials[name] for name in models}
    for name in ("Chalk", "Wood", "Silk"):
        roughness = principled_of(shaders[name]).inputs["Roughness"].links[0].from_socket
        assert (roughness.node.bl_idname, roughness.name) == ("ShaderNodeSeparateColor", "Red")
        assert source(shaders[name], "Base Color").image == bpy.data.images["Plane_basecolor"]
    levels = [principled_of(shaders[n]).inputs["Specular IOR Level"].default_value for n in ("Chalk", "Wood", "Silk")]
    assert levels == [0.0, 0.5, 0.75]
    groups = {group_of(shaders[name]).node_tree for name in ("Skin", "Lips")}
    assert len(groups) == len(bpy.data.node_groups) == 1
    assert len(bpy.data.images) == 6


def test_a_map_of_the_specular_level_comes_and_goes(empty) -> None:
    obj = make_plane()
    shader = obj.material_slots[0].material
    socket, tree = principled_of(shader).inputs["Specular IOR Level"], shader.node_tree
    value = tree.nodes.new("ShaderNodeValue")
    tree.links.new(value.outputs[0], socket)
    socket.default_value = 0.25
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    before = tree_state(tree)
    textured = make_solution({"Skin": "one-lobe-specular"}, replace(make_maps(), specular=make_maps(seed=3).roughness))
    (message,) = material.write_maps(obj, textured)
    assert "Specular IOR Level was linked" in message
    once = tree_state(tree)
    assert material.write_maps(obj, textured) == ()
    assert tree_state(tree) == once
    image = source(shader, "Specular IOR Level").image
    assert image == bpy.data.images["Plane_specular"] and image.colorspace_settings.is_data
    material.write_maps(obj, replace(make_solution({"Skin": "one-lobe-specular"}), levels={"Skin": 0.125}))
    assert not socket.is_linked and socket.default_value == 0.125
    assert "Plane_specular" not in bpy.data.images and "specular" not in obj["irpso"]
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert tree_state(tree) == before  # the user's own link is back


def test_metallic_comes_goes_and_is_read_back(empty) -> None:
    obj, shader = rich_plane()
    tree, inputs = shader.node_tree, principled_of(shader).inputs
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    before = tree_state(tree)
    metal = replace(make_solution({"Skin": "one-lobe-metallic"}), metallic={"Skin": 0.75}, levels={"Skin": 0.25})
    (message,) = material.write_maps(obj, metal)
    assert "Metallic was linked; unlinked and set to 0.75" in message
    once = tree_state(tree)
    assert material.write_maps(obj, metal) == ()
    assert tree_state(tree) == once
    assert (inputs["Metallic"].default_value, inputs["Specular IOR Level"].default_value) == (0.75, 0.25)
    read = solve_region.last_result(obj)
    assert (read.model, read.metallic, read.levels) == ({"Skin": "one-lobe-metallic"}, {"Skin": 0.75}, {"Skin": 0.25})
    material.write_maps(obj, replace(metal, levels={}, metallic={"Skin": 0.5}))
    assert (inputs["Metallic"].default_value, inputs["Specular IOR Level"].default_value) == (0.5, 0.5)
    assert solve_region.last_result(obj).levels == {}
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert tree_state(tree) == before  # the user's own link is back


def test_a_map_of_metallic_comes_goes_and_is_read_back(empty) -> None:
    """Of metal and paint: the user's own link comes back, and nothing of ours is left."""
    obj, shader = rich_plane()
    tree, socket = shader.node_tree, principled_of(shader).inputs["Metallic"]
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    before = tree_state(tree)
    beside = np.where(make_maps(seed=3).roughness > 0.5, np.float32(0.75), np.float32(0))
    painted = replace(make_solution({"Skin": "one-lobe-metallic"}, replace(make_maps(), metallic=beside)),
                      metallic={"Skin": 0.75}, paint={"Skin": float(np.mean(beside == 0))})
    (message,) = material.write_maps(obj, painted)
    assert message == "material 'Skin': Metallic was linked; linked to the solved map instead"
    once = tree_state(tree)
    assert material.write_maps(obj, painted) == ()
    assert tree_state(tree) == once
    image = source(shader, "Metallic").image
    assert image == bpy.data.images["Plane_metallic"] and image.colorspace_settings.is_data
    read = solve_region.last_result(obj)
    assert (read.model, read.metallic) == ({"Skin": "one-lobe-metallic"}, {"Skin": 0.75})
    assert read.paint == painted.paint
    np.testing.assert_array_equal(files.read_maps(obj).metallic, beside)
    material.write_maps(obj, replace(painted, maps=make_maps(), paint={}))
    assert not socket.is_linked and socket.default_value == 0.75
    assert "Plane_metallic" not in bpy.data.images and "metallic" not in obj["irpso"]
    material.write_maps(obj, painted)
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert tree_state(tree) == before
    assert solve_region.last_result(obj).paint == {}


def test_cycles_shows_the_map_of_metallic(empty) -> None:
    obj = make_plane()
    beside = np.where(make_maps(seed=3).roughness > 0.5, np.float32(0.75), np.float32(0))
    material.write_maps(obj, replace(
        make_solution({"Skin": "one-lobe-metallic"}, replace(make_maps(), metallic=beside)), metallic={"Skin": 0.75},
        paint={"Skin": 0.5}))
    np.testing.assert_allclose(bake(obj, obj.data.materials[0], "Metallic")[..., 0], beside, atol=1e-6)


def test_a_coat_comes_goes_and_is_read_back(empty) -> None:
    """The user's own coat, with its links, comes back; the solved one follows the material's normals."""
    obj, shader = rich_plane()
    tree, principled = shader.node_tree, principled_of(shader)
    inputs, noise = principled.inputs, tree.nodes.new("ShaderNodeTexNoise")
    inputs["Coat IOR"].default_value, inputs["Coat Tint"].default_value = 1.8, (0.5, 0.25, 1.0, 1.0)
    tree.links.new(noise.outputs[0], inputs["Coat Weight"])
    tree.links.new(noise.outputs[0], inputs["Coat Normal"])
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    before = tree_state(tree)
    coated = replace(make_solution({"Skin": "one-lobe-specular"}), levels={"Skin": 0.25},
                     coats={"Skin": Coat(0.75, 0.125)})
    (message,) = material.write_maps(obj, coated)
    assert "Coat Weight was linked; unlinked and set to 0.75" in message
    once = tree_state(tree)
    assert material.write_maps(obj, coated) == ()
    assert tree_state(tree) == once
    assert [inputs[f"Coat {name}"].default_value for name in ("Weight", "Roughness", "IOR")] == [0.75, 0.125, 1.5]
    assert tuple(inputs["Coat Tint"].default_value) == (1, 1, 1, 1)
    (own,), (normal,) = inputs["Coat Normal"].links, inputs["Normal"].links
    assert own.from_socket == normal.from_socket
    read = solve_region.last_result(obj)
    assert (read.model, read.coats, read.levels) == (
        {"Skin": "one-lobe-specular"}, {"Skin": Coat(0.75, 0.125)}, {"Skin": 0.25})
    metal = replace(coated, model={"Skin": "one-lobe-metallic"}, metallic={"Skin": 0.5})
    material.write_maps(obj, metal)
    read = solve_region.last_result(obj)
    assert (read.model, read.coats, read.metallic) == (
        {"Skin": "one-lobe-metallic"}, {"Skin": Coat(0.75, 0.125)}, {"Skin": 0.5})
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert tree_state(tree) == before
    assert solve_region.last_result(obj).coats == {}


@pytest.mark.parametrize("level", [None, 0.25])
def test_a_diffuse_roughness_comes_goes_and_is_read_back(empty, level: float | None) -> None:
    """The user's own, with its link, comes back."""
    obj, shader = rich_plane()
    tree, principled = shader.node_tree, principled_of(shader)
    socket, noise = principled.inputs["Diffuse Roughness"], tree.nodes.new("ShaderNodeTexNoise")
    socket.default_value = 0.5
    tree.links.new(noise.outputs[0], socket)
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    before = tree_state(tree)
    model, levels = ("one-lobe", {}) if level is None else ("one-lobe-specular", {"Skin": level})
    rough = replace(make_solution({"Skin": model}), levels=levels, diffuse_roughness={"Skin": 0.75})
    (message,) = material.write_maps(obj, rough)
    assert "Diffuse Roughness was linked; unlinked and set to 0.75" in message
    once = tree_state(tree)
    assert material.write_maps(obj, rough) == ()
    assert tree_state(tree) == once and socket.default_value == 0.75
    read = solve_region.last_result(obj)
    assert (read.model, read.diffuse_roughness, read.levels) == ({"Skin": model}, {"Skin": 0.75}, levels)
    material.write_maps(obj, make_solution({"Skin": "two-lobe"}, wide_maps()))
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert tree_state(tree) == before
    assert solve_region.last_result(obj).diffuse_roughness == {}


@pytest.mark.parametrize("packed", [True, False])
def test_the_maps_come_back_from_the_file(empty, tmp_path: Path, packed: bool) -> None:
    """What `irpso export` writes from a solved .blend is what was solved."""
    maps = wide_maps(specular=True)
    confidence = np.where(maps.filled, 0, np.maximum(maps.confidence, 0.01)).astype("f4")
    maps = replace(maps, confidence=confidence, coverage=~maps.filled, metallic=(confidence > 0.5).astype("f4"))
    obj = make_plane()
    material.write_maps(obj, make_solution({"Skin": "two-lobe"}, maps), packed=packed, directory=tmp_path)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "solved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "solved.blend"))
    read = layers(files.read_maps(bpy.data.objects["Plane"]))
    for name, array in layers(maps).items():
        np.testing.assert_array_equal(read[name], array, err_msg=name)
    obj = bpy.data.objects["Plane"]
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    back = files.read_maps(obj)
    assert back.lobes is None and back.specular is None and back.metallic is None


def test_a_file_of_an_older_solve_is_named(empty) -> None:
    obj = make_plane()
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    del obj["irpso"]["roughness_sigma"]
    with pytest.raises(BadInput, match="'Plane': its roughness_sigma map is gone; run 'irpso solve' again"):
        files.read_maps(obj)


@pytest.mark.parametrize("ndf", ["ggx", "beckmann"])
def test_the_next_solve_reads_what_this_one_wrote(empty, ndf: str) -> None:
    """The normal map is found through the group, and the group is no difference to warn of."""
    obj, shader = rich_plane()
    tree = shader.node_tree
    principled, output = principled_of(shader), tree.get_output_node("ALL")
    tree.links.new(principled.outputs[0], output.inputs["Surface"])
    tree.links.remove(principled.inputs["Metallic"].links[0])
    principled.inputs["Coat Weight"].default_value = 0.0
    shader.cycles.use_bump_map_correction = False

    def read() -> tuple[list[str], np.ndarray]:
        warnings: list[str] = []
        return warnings, read_normal_maps(obj, warnings.append)[0].pixels

    warnings, pixels = read()
    assert warnings == []
    material.write_maps(obj, two_lobe(ndf))
    warnings, again = read()
    assert warnings == []
    np.testing.assert_array_equal(again, pixels)


def test_a_shared_material_is_copied_with_its_group(empty) -> None:
    obj = make_plane("Mine")
    material.write_maps(obj, two_lobe())
    other = make_plane("Theirs")
    state = tree_state(bpy.data.materials["Skin"].node_tree)
    material.write_maps(other, two_lobe())
    assert tree_state(bpy.data.materials["Skin"].node_tree) == state
    assert group_of(other.material_slots[0].material).node_tree == group_of(bpy.data.materials["Skin"]).node_tree
    material.write_maps(other, make_solution({"Skin": "one-lobe"}))
    assert len(bpy.data.node_groups) == 1  # still in use by the first


def test_a_group_of_a_library_is_not_ours_to_use(empty, tmp_path: Path) -> None:
    """A linked material is refused; a material of this file gets a group of this file."""
    material.write_maps(make_plane("Far"), two_lobe())
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, into):
        into.materials = ["Skin"]
    obj = make_plane("Near", materials=())
    obj.data.materials.append(bpy.data.materials["Skin"])
    with pytest.raises(BadInput, match="Skin: this material is linked from a library"):
        material.write_maps(obj, two_lobe())
    assert "irpso" not in obj
    mine = make_material("Paint")
    obj.material_slots[0].material = mine
    material.write_maps(obj, two_lobe(Paint="two-lobe"))
    assert group_of(mine).node_tree.library is None


def test_nodes_that_are_animated_are_said(empty) -> None:
    obj, shader = rich_plane()
    principled_of(shader).inputs["Coat Weight"].keyframe_insert("default_value")
    (message,) = material.write_maps(obj, two_lobe())
    assert "Skin" in message and "animated" in message


def test_what_texels_were_drawn_to_is_read_back(empty) -> None:
    obj, _ = rich_plane()
    skin = next(slot.material for slot in obj.material_slots if slot.material.name == "Skin")
    for prior in (JointPrior(0.25, 200.0), JointPrior(0.5, 1e5, 0.125), JointPrior(0.25, 200.0, 0.0, (0.75, 0.5)),
                  JointPrior(0.25, 10.0, level=0.125, level_strength=0.5),
                  JointPrior(0.25, 1e5, base=(0.5, 0.0, 1.0), base_strength=8.0), JointPrior(0.25, 10.0)):
        material.write_maps(obj, replace(make_solution({"Skin": "one-lobe"}), priors={"Skin": prior}))
        assert solve_region.last_result(obj).priors == {"Skin": prior}
    for odd in ([0.25, 200.0], [0.25, -1.0, 0.0], [2.0, 200.0, 0.0], [0.25, 200.0, 0.0, 5.0], "sharp"):
        skin["irpso_prior"] = odd  # a file may hold anything
        assert solve_region.last_result(obj).priors == {}
    skin["irpso_prior"] = [0.25, 10.0, 0.0]
    for odd in ([0.5], [0.0, 1.0], [0.5, -1.0], "high"):
        skin["irpso_prior_level"] = odd
        assert solve_region.last_result(obj).priors == {"Skin": JointPrior(0.25, 10.0)}
    del skin["irpso_prior_level"]
    for odd in ([0.5, 0.5, 8.0], [0.5, 0.5, 0.5, -1.0], [0.5, 0.5, 1.5, 8.0], "red"):
        skin["irpso_prior_base"] = odd
        assert solve_region.last_result(obj).priors == {"Skin": JointPrior(0.25, 10.0)}
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert "irpso_prior_base" not in skin
    assert "irpso_prior" not in skin and "irpso_prior_level" not in skin
