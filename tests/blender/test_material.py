"""Maps onto materials: Cycles shows just the maps' values, and nothing else in the file changes."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.blender.material import material, material_sharing
from irpso_addon.blender.scene.scene_mesh import read_mesh
from irpso_addon.core.errors import BadInput
from tests.blender.materials import (
    SIZE,
    bake,
    make_maps,
    make_material,
    make_plane,
    make_solution,
    principled_of,
    source,
    tree_state,
)

ENDS = ["basecolor", "basecolor_sigma", "confidence", "error", "roughness", "roughness_sigma"]  # sorted


@pytest.mark.parametrize("where", ["packed", "reopened", "saved"])
def test_cycles_shows_the_values_of_the_maps(empty, tmp_path: Path, where: str) -> None:
    obj, maps = make_plane(), make_maps()
    if where == "saved":
        material.write_maps(obj, make_solution({"Skin": "one-lobe"}, maps), packed=False, directory=tmp_path / "maps")
        assert (tmp_path / "maps" / "Plane_basecolor.exr").exists()
    else:
        material.write_maps(obj, make_solution({"Skin": "one-lobe"}, maps))
    if where == "reopened":
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "x.blend"))
        obj = bpy.data.objects["Plane"]
    shader = obj.material_slots[0].material
    # 1e-6: grey goes through a luminance sum in float32
    np.testing.assert_allclose(bake(obj, shader, "Base Color"), maps.base_color, atol=1e-6)
    np.testing.assert_allclose(bake(obj, shader, "Roughness")[..., 0], maps.roughness, atol=1e-6)
    images = {name: image for name, image in bpy.data.images.items() if name.startswith("Plane_")}
    assert sorted(images) == [f"Plane_{end}" for end in ENDS]
    assert all(image.is_float and bool(image.packed_file) == (where != "saved") for image in images.values())
    pixels = np.empty(SIZE * SIZE * 4, "f4")
    images["Plane_confidence"].pixels.foreach_get(pixels)
    np.testing.assert_array_equal(pixels[::4].reshape(SIZE, SIZE), maps.confidence)


def test_colour_spaces(empty) -> None:
    material.write_maps(make_plane(), make_solution({"Skin": "one-lobe"}))
    assert bpy.data.images["Plane_basecolor"].colorspace_settings.name == "Linear Rec.709"
    for role in ENDS[1:]:
        assert bpy.data.images[f"Plane_{role}"].colorspace_settings.is_data


def test_running_twice_leaves_one_set_and_the_rest_alone(empty) -> None:
    """A tree with a mix shader, a value on Base Color, a normal map and comments: only two links are new."""
    obj = make_plane()
    shader = obj.material_slots[0].material
    tree = shader.node_tree
    nodes, links = tree.nodes, tree.links
    output, principled = tree.get_output_node("ALL"), principled_of(shader)
    mix, glossy = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeBsdfGlossy")
    mix.inputs["Fac"].default_value = 0.125
    links.new(glossy.outputs[0], mix.inputs[1])
    links.new(principled.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], output.inputs["Surface"])
    noise, bump = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeBump")
    links.new(noise.outputs["Color"], principled.inputs["Base Color"])
    links.new(noise.outputs[0], bump.inputs["Height"])
    links.new(bump.outputs["Normal"], principled.inputs["Normal"])
    other = make_material("Other")
    before, other_before = tree_state(tree), tree_state(other.node_tree)

    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    once = tree_state(tree)
    counts = len(bpy.data.images), len(bpy.data.materials), len(bpy.data.node_groups)
    mine = {n.name for n in nodes if n.get("irpso")}
    assert len(mine) == 3  # two textures and their frame
    assert {k: v for k, v in once.items() if k not in mine | {"links"}} == {
        k: v for k, v in before.items() if k != "links"}
    gone = set(before["links"]) - set(once["links"])
    assert gone == {(noise.name, "Color", principled.name, "Base Color")}
    assert {link[2:] for link in set(once["links"]) - set(before["links"])} == {
        (principled.name, "Base Color"), (principled.name, "Roughness")}

    maps = make_maps(2 * SIZE, seed=1)  # another size and other values
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}, maps))
    assert tree_state(tree) == once
    assert (len(bpy.data.images), len(bpy.data.materials), len(bpy.data.node_groups)) == counts
    assert tuple(bpy.data.images["Plane_basecolor"].size) == (2 * SIZE, 2 * SIZE)
    assert tree_state(other.node_tree) == other_before
    np.testing.assert_allclose(bake(obj, shader, "Base Color", 2 * SIZE), maps.base_color, atol=1e-6)


def test_a_renamed_object_keeps_one_set(empty) -> None:
    obj = make_plane()
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    obj.name = "Cöw"
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert sorted(bpy.data.images.keys()) == [f"Cöw_{end}" for end in ENDS]


def test_an_object_that_is_renamed_during_a_solve(empty) -> None:
    """Some of its images are there before, some come after."""
    obj, layers = make_plane(), material.layers_of(make_maps())
    early = {role: layers.pop(role) for role in ("base_color", "roughness")}
    images = material.write_images(obj, early)
    obj.name = "Cöw"
    material.adopt(obj, images | material.write_images(obj, layers))
    assert sorted(bpy.data.images.keys()) == [f"Cöw_{end}" for end in ENDS]


def test_long_names_stay_distinct(empty) -> None:
    obj = make_plane("é" * 31)
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert {name.split("_", 1)[1] for name in bpy.data.images.keys()} == set(ENDS)


def test_an_image_of_the_user_with_the_same_name_is_left_alone(empty) -> None:
    own = bpy.data.images.new("Plane_basecolor", 4, 4)
    own.use_fake_user = True
    obj = make_plane()
    for _ in range(2):
        material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert tuple(own.size) == (4, 4)
    assert len(bpy.data.images) == 1 + len(ENDS)


def test_several_slots_share_the_images(empty) -> None:
    obj = make_plane(materials=("A", "B", "A", "Unsolved"))
    state = tree_state(bpy.data.materials["Unsolved"].node_tree)
    assert material.write_maps(obj, make_solution({"A": "one-lobe", "B": "lambert"})) == ()
    assert [s.material.name for s in obj.material_slots] == ["A", "B", "A", "Unsolved"]
    a, b = bpy.data.materials["A"], bpy.data.materials["B"]
    assert source(a, "Base Color").image == source(b, "Base Color").image == bpy.data.images["Plane_basecolor"]
    assert len(a.node_tree.nodes) == len(b.node_tree.nodes) == 5
    assert tree_state(bpy.data.materials["Unsolved"].node_tree) == state


def test_lambert_switches_the_highlight_off_and_one_lobe_brings_it_back(empty) -> None:
    obj = make_plane()
    shader = obj.material_slots[0].material
    socket = principled_of(shader).inputs["Specular IOR Level"]
    socket.default_value = 0.25
    value = shader.node_tree.nodes.new("ShaderNodeValue")
    for _ in range(2):
        material.write_maps(obj, make_solution({"Skin": "lambert"}))
        assert socket.default_value == 0.0
        assert source(shader, "Roughness").image.name == "Plane_roughness"
    for _ in range(2):
        assert material.write_maps(obj, make_solution({"Skin": "one-lobe"})) == ()
        assert socket.default_value == 0.25
    shader.node_tree.links.new(value.outputs[0], socket)
    messages = material.write_maps(obj, make_solution({"Skin": "lambert"}))
    assert not socket.is_linked and socket.default_value == 0.0
    assert any("unlinked" in message for message in messages)


def test_a_material_of_another_object_is_copied(empty) -> None:
    obj, other = make_plane("Mine"), make_plane("Theirs")
    shared = other.material_slots[0].material
    state = tree_state(shared.node_tree)
    messages = material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert any("'Skin'" in m and "Mine" in m for m in messages)
    assert other.material_slots[0].material == shared
    assert tree_state(shared.node_tree) == state
    assert source(obj.material_slots[0].material, "Base Color").image.name == "Mine_basecolor"
    # The same solution again finds its slot although the copy has another name; no second copy.
    assert material.write_maps(obj, make_solution({"Skin": "one-lobe"})) == ()
    assert len(bpy.data.materials) == 2


def test_another_object_that_was_given_the_solved_material_keeps_its_maps(empty) -> None:
    obj, maps, later = make_plane("Mine"), make_maps(), make_maps(seed=5)
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}, maps))
    other = make_plane("Theirs")  # by hand, not as a duplicate
    messages = material.write_maps(obj, make_solution({"Skin": "one-lobe"}, later))
    assert any("'Theirs' uses it too" in message for message in messages)
    images = len(bpy.data.images)
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}, later))
    assert len(bpy.data.images) == images  # what nobody else shows is replaced
    mine, theirs = obj.material_slots[0].material, other.material_slots[0].material
    np.testing.assert_allclose(bake(other, theirs, "Base Color"), maps.base_color, atol=1e-6)
    other.select_set(False)
    np.testing.assert_allclose(bake(obj, mine, "Base Color"), later.base_color, atol=1e-6)


@pytest.mark.parametrize("nested", [False, True])
def test_a_material_that_geometry_nodes_give_another_object_is_copied(empty, nested: bool) -> None:
    obj, maps, later = make_plane("Mine"), make_maps(), make_maps(seed=5)
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}, maps))
    skin = obj.material_slots[0].material
    group = bpy.data.node_groups.new("Skinned", "GeometryNodeTree")
    group.nodes.new("GeometryNodeSetMaterial").inputs["Material"].default_value = skin
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}, maps))
    assert obj.material_slots[0].material == skin  # nobody uses the nodes
    if nested:
        outer = bpy.data.node_groups.new("Outer", "GeometryNodeTree")
        outer.nodes.new("GeometryNodeGroup").node_tree = group
        group = outer
    obj.modifiers.new("Own", "NODES").node_group = group
    assert material_sharing.shared_with(obj) == {}
    other = make_plane("Theirs", materials=())
    other.modifiers.new("Skin", "NODES").node_group = group
    assert material_sharing.shared_with(obj) == {"Skin": ["Theirs"]}
    obj.modifiers.clear()
    state = tree_state(skin.node_tree)
    messages = material.write_maps(obj, make_solution({"Skin": "one-lobe"}, later))
    assert any("'Theirs' uses it too" in message for message in messages)
    assert obj.material_slots[0].material != skin and tree_state(skin.node_tree) == state
    pixels = np.empty(SIZE * SIZE * 4, np.float32)
    source(skin, "Base Color").image.pixels.foreach_get(pixels)
    np.testing.assert_array_equal(pixels.reshape(SIZE, SIZE, 4)[..., :3], maps.base_color)


def test_a_material_that_geometry_nodes_give_the_object_itself_is_not_copied(empty) -> None:
    """On a copy in its slot the maps would not show."""
    obj, other = make_plane("Mine"), make_plane("Theirs", materials=())
    group = bpy.data.node_groups.new("Skinned", "GeometryNodeTree")
    nodes, links = group.nodes, group.links
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    begin, paint, end = (nodes.new(kind) for kind in (
        "NodeGroupInput", "GeometryNodeSetMaterial", "NodeGroupOutput"))
    paint.inputs["Material"].default_value = obj.material_slots[0].material
    links.new(begin.outputs[0], paint.inputs["Geometry"])
    links.new(paint.outputs[0], end.inputs[0])
    for each in (obj, other):
        each.modifiers.new("Skin", "NODES").node_group = group
    messages = material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert any("'Theirs' shows the maps too, because Geometry Nodes give it to Mine" in text for text in messages)
    shown = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).material_slots[0].material.original
    assert source(shown, "Base Color").image.name == "Mine_basecolor"


def test_a_shared_mesh_keeps_its_material(empty) -> None:
    obj = make_plane("Mine")
    twin = bpy.data.objects.new("Twin", obj.data)
    bpy.context.scene.collection.objects.link(twin)
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    assert twin.material_slots[0].material.name == "Skin"
    assert obj.material_slots[0].material != twin.material_slots[0].material


def test_a_duplicate_gets_its_own_images(empty) -> None:
    obj = make_plane("Mine")
    maps, later = make_maps(), make_maps(seed=5)
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}, maps))
    twin = obj.copy()
    bpy.context.scene.collection.objects.link(twin)
    twin.name = "Twin"
    material.write_maps(twin, make_solution({"Skin": "one-lobe"}, later))
    material.write_maps(twin, make_solution({"Skin.001": "one-lobe"}, later))
    assert len(bpy.data.images) == 2 * len(ENDS)
    mine, theirs = obj.material_slots[0].material, twin.material_slots[0].material
    np.testing.assert_allclose(bake(twin, theirs, "Base Color"), later.base_color, atol=1e-6)
    twin.select_set(False)
    np.testing.assert_allclose(bake(obj, mine, "Base Color"), maps.base_color, atol=1e-6)


@pytest.mark.parametrize("slots", [0, 1])
def test_an_object_without_material_gets_one(empty, slots: int) -> None:
    obj = make_plane(materials=())
    for _ in range(slots):
        obj.data.materials.append(None)
    for _ in range(2):
        material.write_maps(obj, make_solution({"": "one-lobe"}))
    assert [s.material.name for s in obj.material_slots] == ["Plane"]
    assert len(bpy.data.materials) == 1
    assert source(obj.material_slots[0].material, "Roughness").image.name == "Plane_roughness"


def test_an_empty_tree_gets_a_principled(empty) -> None:
    obj = make_plane()
    shader = obj.material_slots[0].material
    shader.node_tree.nodes.clear()
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    output = shader.node_tree.get_output_node("ALL")
    assert output.inputs["Surface"].links[0].from_node == principled_of(shader)


def test_the_uv_map_that_renders_is_the_one_that_was_read(empty) -> None:
    """Not the selected one: scene.read_scene and the Image Texture nodes must mean the same map."""
    obj = make_plane()
    mirrored = obj.data.uv_layers.new(name="Mirrored")
    for corner, uv in zip(mirrored.data, [(1, 0), (0, 0), (0, 1), (1, 1)], strict=True):
        corner.uv = uv
    mirrored.active_render = True
    obj.data.uv_layers.active = obj.data.uv_layers["UVMap"]  # a bake writes by this one
    read = read_mesh(obj, bpy.context.evaluated_depsgraph_get(), {}, lambda _: None)
    np.testing.assert_allclose(read.uvs[..., 0], 1 - read.positions[..., 0])
    maps = make_maps()
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}, maps))
    baked = bake(obj, obj.material_slots[0].material, "Base Color")
    np.testing.assert_allclose(baked, maps.base_color[:, ::-1], atol=1e-6)


def test_nodes_do_not_lie_on_others(empty) -> None:
    obj = make_plane()
    tree = obj.material_slots[0].material.node_tree
    left = tree.nodes.new("ShaderNodeTexNoise")
    left.location = (-900, 200)
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    textures = [n for n in tree.nodes if n.get("irpso") in ("base_color", "roughness")]
    assert all(n.location_absolute.x + n.width <= left.location_absolute.x for n in textures)
    assert {n.parent.label for n in textures} == {"IRPSO"}
    assert abs(textures[0].location_absolute.y - textures[1].location_absolute.y) >= 280


# ---- what cannot be done is said before anything changes


def refuses(obj: bpy.types.Object, model: dict[str, str], *words: str) -> None:
    count = len(bpy.data.images), len(bpy.data.materials)
    with pytest.raises(BadInput) as caught:
        material.write_maps(obj, make_solution(model))
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words), message
    assert (len(bpy.data.images), len(bpy.data.materials)) == count
    assert "irpso" not in obj


def test_no_principled_is_named(empty) -> None:
    obj = make_plane(materials=("Fine", "Glow"))
    tree = bpy.data.materials["Glow"].node_tree
    tree.nodes.remove(principled_of(bpy.data.materials["Glow"]))
    glow = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(glow.outputs[0], tree.get_output_node("ALL").inputs["Surface"])
    refuses(obj, {"Fine": "one-lobe", "Glow": "one-lobe"}, "Glow", "Principled")
    assert len(bpy.data.materials["Fine"].node_tree.nodes) == 2


def test_an_output_for_eevee_alone_is_named(empty) -> None:
    """The maps would go to nodes of their own, which EEVEE and Material Preview do not show."""
    obj = make_plane()
    tree = obj.material_slots[0].material.node_tree
    tree.get_output_node("ALL").target = "EEVEE"
    refuses(obj, {"Skin": "one-lobe"}, "Skin", "EEVEE", "Target")
    assert len(tree.nodes) == 2


def test_other_materials_than_were_solved(empty) -> None:
    refuses(make_plane(), {"Gone": "one-lobe"}, "Plane", "Gone", "solve again")
    bare = make_plane("Bare", materials=())
    refuses(bare, {"Gone": "one-lobe"}, "Bare", "Gone", "solve again")
    assert len(bare.material_slots) == 0


def test_linked_data_is_refused(empty, tmp_path: Path) -> None:
    make_plane("Far")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, into):
        into.objects, into.materials = ["Far"], ["Skin"]
    refuses(bpy.data.objects["Far"], {"Skin": "one-lobe"}, "Far", "library")
    obj = make_plane(materials=())
    obj.data.materials.append(bpy.data.materials["Skin"])
    refuses(obj, {"Skin": "one-lobe"}, "Skin", "library")


def linked(folder: Path, kind: str, name: str) -> bpy.types.ID:
    """The only thing of that kind in the open file, linked into an empty one."""
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "library.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(folder / "library.blend"), link=True) as (_, into):
        setattr(into, kind, [name])
    return getattr(into, kind)[0]


def test_an_overridden_material_is_refused(empty, tmp_path: Path) -> None:
    """Blender would save none of its new nodes."""
    make_material("Skin").use_fake_user = True
    override = linked(tmp_path, "materials", "Skin").override_create()
    obj = make_plane(materials=())
    obj.data.materials.append(override)
    count = len(override.node_tree.nodes)
    refuses(obj, {"Skin": "one-lobe"}, "Skin", "override", "local")
    assert len(override.node_tree.nodes) == count


@pytest.mark.parametrize("users", [1, 2])
def test_a_linked_mesh_with_an_empty_slot(empty, tmp_path: Path, users: int) -> None:
    """Its slots cannot be changed, those of the object can."""
    make_plane(materials=()).data.materials.append(None)
    mesh = linked(tmp_path, "meshes", "Plane")
    first, *others = (bpy.data.objects.new(f"Mine {number}", mesh) for number in range(users))
    messages = material.write_maps(first, make_solution({"": "one-lobe"}))
    assert any("empty material slot" in message for message in messages)
    assert source(first.material_slots[0].material, "Roughness").image.name == "Mine 0_roughness"
    assert mesh.materials[0] is None and all(other.material_slots[0].material is None for other in others)


def test_an_overridden_object_keeps_no_result(empty, tmp_path: Path) -> None:
    """So Blender has it: custom properties that an override gets are gone when the file is opened again."""
    make_plane()
    linked(tmp_path, "objects", "Plane")
    obj = bpy.data.objects["Plane"].override_create()
    bpy.context.scene.collection.objects.link(obj)
    obj.material_slots[0].link, obj.material_slots[0].material = "OBJECT", make_material("Mine")
    messages = material.write_maps(obj, make_solution({"Mine": "one-lobe"}))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "mine.blend"))
    obj = next(obj for obj in bpy.data.objects if obj.override_library is not None)
    assert source(obj.material_slots[0].material, "Base Color").image.name == "Plane_basecolor"
    assert ("irpso" in obj) == (not any("override" in message for message in messages))


def test_a_lamp_is_refused(empty) -> None:
    refuses(bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT")), {"": "one-lobe"}, "Lamp", "mesh")
