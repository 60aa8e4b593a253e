"""Exports for other programs, read back by Blender itself: its glTF importer, Node Wrangler's names, Cycles' pixels."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest

from irpso_addon.blender import files
from irpso_addon.blender.export_object import export_object, with_strength
from irpso_addon.blender.material import material
from irpso_addon.blender.material.surfaces import shown_surfaces, solved_surfaces
from irpso_addon.core.data import Coat, Maps, Solution
from irpso_addon.core.errors import BadInput
from irpso_addon.core.maps.target_export import Surface
from irpso_addon.core.maps.targets import TARGETS
from tests.blender import cycles_rig
from tests.blender.materials import make_material, make_plane, principled_of

TEXELS, PIXELS, SAMPLES = 256, 96, 16
# Mean difference of pixels over their mean.  Measured: 8 bits 0.003 to 0.005; 16 bits 0.0007, most of it by Cycles,
# which interpolates sRGB values before it decodes them.  Maps upside down make 0.18.
TOLERANCE = {8: 0.008, 16: 0.0015}

# ---- the scene


def smooth_maps(specular: bool = False) -> Maps:
    """Waves of base colour and roughness, without symmetry: a flip shows."""
    v, u = np.mgrid[0:TEXELS, 0:TEXELS].astype("f4") / TEXELS
    base = np.stack([0.2 + 0.6 * u, 0.1 + 0.7 * v * u, 0.5 + 0.3 * np.sin(9 * v)], -1)
    roughness = 0.25 + 0.5 * v * (0.5 + 0.5 * np.sin(7 * u))
    none = np.zeros_like(u)
    return Maps(base, roughness, none + 1, none, none > 0, none < 1, none, none,
                specular=0.1 + 0.4 * u * v if specular else None)


def solution(model: str, maps: Maps | None = None, **values: Any) -> Solution:
    return replace(Solution.of_maps(smooth_maps() if maps is None else maps, {"Skin": model}), **values)


def ball(normal_map: bool = False) -> bpy.types.Object:
    """A smooth sphere with UVs, turned, in an empty scene with a camera and two lamps."""
    cycles_rig.scene(PIXELS, SAMPLES)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, rotation=(0.3, -0.4, 1.1), location=(0.2, 0.1, 0))
    obj = bpy.context.object
    obj.name = "Ball"
    obj.data.shade_smooth()
    obj.data.materials.append(make_material("Skin"))
    if normal_map:
        add_normal_map(obj.data.materials[0])
    cycles_rig.camera((0, -4, 1), (0.2, 0.1, 0), 35)
    cycles_rig.lamp("POINT", (2, -3, 2), energy=400)
    cycles_rig.lamp("POINT", (-3, -2, 1), energy=200)
    return obj


def add_normal_map(shader: bpy.types.Material, strength: float = 0.7, seed: float = 0.0) -> np.ndarray:
    """A bumpy normal map on a material; its pixels."""
    v, u = np.mgrid[0:48, 0:32].astype("f4")
    normals = np.stack([0.3 * np.sin(u / 3 + seed), 0.2 + 0.2 * np.cos(v / 4), np.ones_like(u)], -1)
    normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True) * 0.5 + 0.5).astype("f4")
    image = bpy.data.images.new("Bumps", 32, 48, float_buffer=True, is_data=True)
    image.pixels.foreach_set(np.concatenate([normals, np.ones((48, 32, 1), "f4")], -1).ravel())
    image.pack()
    nodes, links = shader.node_tree.nodes, shader.node_tree.links
    texture, node = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeNormalMap")
    texture.image, node.inputs["Strength"].default_value = image, strength
    links.new(texture.outputs["Color"], node.inputs["Color"])
    links.new(node.outputs["Normal"], principled_of(shader).inputs["Normal"])
    return normals


def export(obj: bpy.types.Object, target: str, out: Path) -> list[str]:
    """As the command line does it; the lines that say what is lost."""
    lost: list[str] = []
    _, more = export_object(obj, files.read_maps(obj), shown_surfaces(obj, lost.append), target, out)
    return lost + more


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference over the mean, where the picture shows the object."""
    there = a.sum(-1) > 0
    assert there.mean() > 0.2
    return float(np.abs(a - b)[there].mean() / a[there].mean())


MODELS: dict[str, dict[str, Any]] = {
    "lambert": {}, "one-lobe": {}, "one-lobe-specular": {"levels": {"Skin": 0.2}},
    "one-lobe-metallic": {"metallic": {"Skin": 0.7}, "levels": {"Skin": 0.4}},
}


# ---- glTF, by Blender's importer


@pytest.mark.parametrize("model", MODELS)
def test_gltf_renders_alike(tmp_path: Path, model: str) -> None:
    obj = ball()
    material.write_maps(obj, solution(model, **MODELS[model]))
    before = cycles_rig.render()["rgb"]
    assert export(obj, "gltf", tmp_path / "out") == []
    bpy.data.objects.remove(obj)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "out" / "Ball.glb"))
    assert difference(before, cycles_rig.render()["rgb"]) < TOLERANCE[8]


def test_gltf_renders_alike_with_a_normal_map_and_a_map_of_the_level(tmp_path: Path) -> None:
    obj = ball(normal_map=True)
    material.write_maps(obj, solution("one-lobe-specular", smooth_maps(specular=True)))
    before = cycles_rig.render()["rgb"]
    assert export(obj, "gltf", tmp_path / "out") == []
    bpy.data.objects.remove(obj)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "out" / "Ball.glb"))
    shader = principled_of(bpy.context.selected_objects[0].data.materials[0])
    assert shader.inputs["Specular IOR Level"].is_linked and shader.inputs["Normal"].is_linked
    assert difference(before, cycles_rig.render()["rgb"]) < TOLERANCE[8]


def test_gltf_renders_a_coat_alike(tmp_path: Path) -> None:
    """No line then says that it is lost; where only one of two materials has it, a line names it."""
    obj = ball()
    material.write_maps(obj, solution("one-lobe"))
    bare = cycles_rig.render()["rgb"]
    made = solution("one-lobe", coats={"Skin": Coat(0.75, 0.125)})
    material.write_maps(obj, made)
    before = cycles_rig.render()["rgb"]
    assert difference(before, bare) > 5 * TOLERANCE[8]
    assert export(obj, "gltf", tmp_path / "out") == [] and solved_surfaces(obj, made) == shown_surfaces(obj, print)
    obj.data.materials.append(make_material("Matt"))
    obj.data.polygons[0].material_index = 1
    (line,) = export(obj, "gltf", tmp_path / "two")
    assert line == "material 'Skin': its files for glTF have no coat; the coat of weight 0.75 is lost"
    bpy.data.objects.remove(obj)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "out" / "Ball.glb"))
    assert difference(before, cycles_rig.render()["rgb"]) < TOLERANCE[8]


def test_gltf_renders_metal_beside_paint_alike(tmp_path: Path) -> None:
    obj, maps = ball(), smooth_maps()
    wide = np.kron(np.arange(64).reshape(8, 8) % 3 > 0, np.ones((TEXELS // 8, TEXELS // 8), bool))
    material.write_maps(obj, solution(
        "one-lobe-metallic", replace(maps, metallic=wide.astype("f4")), metallic={"Skin": 1.0}, paint={"Skin": 0.3}))
    before = cycles_rig.render()["rgb"]
    assert export(obj, "gltf", tmp_path / "out") == []
    bpy.data.objects.remove(obj)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "out" / "Ball.glb"))
    assert difference(before, cycles_rig.render()["rgb"]) < TOLERANCE[8]


# ---- the other targets, by what their programs' manuals say of the files


class Reader:
    """Nodes that show files as a program would."""

    def __init__(self, folder: Path, obj: bpy.types.Object) -> None:
        obj.data.materials.clear()
        obj.data.materials.append(make_material("Read"))
        self.folder, self.shader = folder, obj.data.materials[0]
        self.tree = self.shader.node_tree
        self.principled = principled_of(self.shader)

    def texture(self, name: str, colour: bool = False) -> bpy.types.Node:
        node = self.tree.nodes.new("ShaderNodeTexImage")
        node.image = bpy.data.images.load(str(self.folder / name))
        node.image.colorspace_settings.name = "sRGB" if colour else "Non-Color"
        node.image.alpha_mode = "CHANNEL_PACKED"
        return node

    def parts(self, texture: bpy.types.Node) -> Any:
        node = self.tree.nodes.new("ShaderNodeSeparateColor")
        self.tree.links.new(texture.outputs["Color"], node.inputs[0])
        return node.outputs

    def set(self, socket: str, output: bpy.types.NodeSocket) -> None:
        self.tree.links.new(output, self.principled.inputs[socket])

    def minus(self, output: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
        """1 - output."""
        node = self.tree.nodes.new("ShaderNodeMath")
        node.operation, node.inputs[0].default_value = "SUBTRACT", 1.0
        self.tree.links.new(output, node.inputs[1])
        return node.outputs[0]

    def normal(self, name: str, green_down: bool) -> None:
        node, texture = self.tree.nodes.new("ShaderNodeNormalMap"), self.texture(name)
        colour = texture.outputs["Color"]
        if green_down:
            red, green, blue = self.parts(texture)
            combined = self.tree.nodes.new("ShaderNodeCombineColor")
            for value, socket in zip((red, self.minus(green), blue), combined.inputs, strict=False):
                self.tree.links.new(value, socket)
            colour = combined.outputs[0]
        self.tree.links.new(colour, node.inputs["Color"])
        self.set("Normal", node.outputs["Normal"])


def read_unreal(read: Reader) -> None:
    """Specular 0.5 is 4 %, as here; DirectX normals."""
    read.set("Base Color", read.texture("T_Ball_BC.png", colour=True).outputs["Color"])
    _, roughness, metallic = read.parts(read.texture("T_Ball_ORM.png"))
    read.set("Roughness", roughness)
    read.set("Metallic", metallic)
    read.set("Specular IOR Level", read.texture("T_Ball_S.png").outputs["Color"])
    read.normal("T_Ball_N.png", green_down=True)


def read_unity(read: Reader) -> None:
    """Its dielectric has 4 %, its mask map Metallic in red and smoothness in alpha."""
    read.set("Base Color", read.texture("Ball_BaseMap.png", colour=True).outputs["Color"])
    mask = read.texture("Ball_MaskMap.png")
    read.set("Metallic", read.parts(mask)[0])
    read.set("Roughness", read.minus(mask.outputs["Alpha"]))
    read.normal("Ball_NormalMap.png", green_down=False)


def read_plain(level: str, green_down: bool) -> Callable[[Reader], None]:
    def read_files(read: Reader) -> None:
        read.set("Base Color", read.texture("Ball_BaseColor.png", colour=True).outputs["Color"])
        read.set("Roughness", read.texture("Ball_Roughness.png").outputs["Color"])
        read.set("Metallic", read.texture("Ball_Metallic.png").outputs["Color"])
        read.set("Specular IOR Level", read.texture(f"Ball_{level}.png").outputs["Color"])
        read.normal("Ball_Normal.png", green_down)
    return read_files


def read_materialx(read: Reader) -> None:
    """By the MaterialX library; OpenPBR's inputs are those of the Principled BSDF by other names."""
    mx = pytest.importorskip("MaterialX")
    document = mx.createDocument()
    mx.readFromXmlFile(document, str(read.folder / "Ball.mtlx"))
    (shader,) = (node for node in document.getNodes() if node.getCategory() == "open_pbr_surface")
    for socket, name in (("Base Color", "base_color"), ("Roughness", "specular_roughness")):
        file = shader.getConnectedNode(name).getInput("file")
        colour = file.getActiveColorSpace() == "srgb_texture"
        read.set(socket, read.texture(file.getValueString(), colour).outputs["Color"])
    read.principled.inputs["Metallic"].default_value = shader.getInputValue("base_metalness")
    read.principled.inputs["IOR"].default_value = shader.getInputValue("specular_ior")
    inputs = read.principled.inputs
    for name in ("Weight", "Roughness", "IOR"):
        if shader.getInput(f"coat_{name.lower()}") is not None:
            inputs[f"Coat {name}"].default_value = shader.getInputValue(f"coat_{name.lower()}")
    normal = shader.getConnectedNode("geometry_normal").getConnectedNode("in")
    read.normal(normal.getInputValue("file"), green_down=False)
    if shader.getConnectedNode("geometry_coat_normal") == shader.getConnectedNode("geometry_normal"):
        read.set("Coat Normal", inputs["Normal"].links[0].from_socket)


READERS: dict[str, tuple[Callable[[Reader], None], int]] = {
    "blender": (read_plain("Specular", False), 16), "unreal": (read_unreal, 8), "unity": (read_unity, 8),
    "substance": (read_plain("SpecularLevel", True), 16), "materialx": (read_materialx, 16),
}


@pytest.mark.parametrize("target", READERS)
def test_files_render_alike(tmp_path: Path, target: str) -> None:
    obj, (read, bits) = ball(normal_map=True), READERS[target]
    level = 0.5 if target == "unity" else 0.3
    material.write_maps(obj, solution(
        "one-lobe-metallic", metallic={"Skin": 0.4}, levels={"Skin": level}))
    before = cycles_rig.render()["rgb"]
    assert export(obj, target, tmp_path / "out") == []
    read(Reader(tmp_path / "out", obj))
    assert difference(before, cycles_rig.render()["rgb"]) < TOLERANCE[bits]


def test_materialx_renders_a_coat_alike(tmp_path: Path) -> None:
    """Over the normal map, as below it."""
    obj = ball(normal_map=True)
    material.write_maps(obj, solution("one-lobe"))
    bare = cycles_rig.render()["rgb"]
    material.write_maps(obj, solution("one-lobe", coats={"Skin": Coat(0.75, 0.125)}))
    before = cycles_rig.render()["rgb"]
    assert difference(before, bare) > 5 * TOLERANCE[16]
    assert export(obj, "materialx", tmp_path / "out") == []
    read_materialx(Reader(tmp_path / "out", obj))
    assert difference(before, cycles_rig.render()["rgb"]) < TOLERANCE[16]


def test_node_wrangler_knows_the_names(tmp_path: Path) -> None:
    """Its "Add Principled Setup" finds the socket of each file of target blender by its name."""
    obj = ball(normal_map=True)
    material.write_maps(obj, solution("one-lobe-specular", levels={"Skin": 0.2}))
    export(obj, "blender", tmp_path)
    bpy.ops.preferences.addon_enable(module="node_wrangler")
    from node_wrangler.utils.paths import match_files_to_socket_names

    tags = bpy.context.preferences.addons["node_wrangler"].preferences.principled_tags
    sockets = [[name, getattr(tags, key).split(), None] for name, key in (
        ("Base Color", "base_color"), ("Metallic", "metallic"), ("Specular IOR Level", "specular"),
        ("Roughness", "rough"), ("Normal", "normal"), ("Gloss", "gloss"), ("Bump", "bump"))]

    class Named:
        def __init__(self, name: str) -> None:
            self.name = name

    match_files_to_socket_names([Named(name) for name in sorted(os.listdir(tmp_path))], sockets)
    assert {name: file for name, _, file in sockets} == {
        "Base Color": "Ball_BaseColor.png", "Metallic": "Ball_Metallic.png", "Roughness": "Ball_Roughness.png",
        "Specular IOR Level": "Ball_Specular.png", "Normal": "Ball_Normal.png", "Gloss": None, "Bump": None}


# ---- what materials say


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


# ---- the command and the operator


@pytest.fixture
def solved(tmp_path: Path) -> Path:
    """A .blend of the ball with maps."""
    obj = ball()
    material.write_maps(obj, solution("one-lobe-specular", levels={"Skin": 0.2}))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "ball.blend"))
    return tmp_path / "ball.blend"


def test_the_command(solved: Path, irpso_here, tmp_path: Path) -> None:
    done = irpso_here("export", solved, "--target", "gltf", "--out", tmp_path / "gltf")
    assert (done.returncode, done.stderr) == (0, "")
    assert [Path(line).name for line in done.stdout.splitlines()] == [
        "Ball_baseColor.png", "Ball_occlusionRoughnessMetallic.png", "Ball.glb"]
    assert all(Path(line).is_file() for line in done.stdout.splitlines())
    done = irpso_here("export", solved, "--target", "unity", "--out", tmp_path / "unity")
    assert done.returncode == 0 and done.stderr.startswith("irpso: warning: material 'Skin': Unity has no Specular")
    assert done.stderr.count("\n") == 1


def test_wrong_usage(solved: Path, irpso_here, tmp_path: Path) -> None:
    done = irpso_here("export", solved, "--target", "gltf", "--format", "tiff", "--out", tmp_path / "out")
    assert done.returncode == 3 and "--format" in done.stderr and done.stderr.count("\n") == 1
    assert irpso_here("export", solved, "--target", "godot").returncode == 2
    assert not (tmp_path / "out").exists()


def test_a_mesh_that_lost_its_uv_map(solved: Path, irpso_here, tmp_path: Path) -> None:
    bpy.ops.wm.open_mainfile(filepath=str(solved))
    mesh = bpy.data.objects["Ball"].data
    mesh.uv_layers.remove(mesh.uv_layers[0])
    bpy.ops.wm.save_mainfile()
    done = irpso_here("export", solved, "--target", "gltf", "--out", tmp_path / "out")
    assert done.returncode == 3 and "UV map" in done.stderr and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
    with pytest.raises(BadInput, match="UV map"):
        export(bpy.data.objects["Ball"], "unreal", tmp_path / "out")


def test_a_mesh_of_another_scene(tmp_path: Path) -> None:
    """Its modifiers are not known there; the line names the scene that is open."""
    obj = ball()
    obj.modifiers.new("Smooth", "SUBSURF")
    material.write_maps(obj, solution("one-lobe"))
    empty_scene = bpy.data.scenes.new("Other")
    with bpy.context.temp_override(scene=empty_scene, view_layer=empty_scene.view_layers[0]), pytest.raises(
            BadInput, match=r"object 'Ball': is not in scene 'Other', .*; open a scene that has it"):
        export(obj, "gltf", tmp_path)


def test_the_operator(extension, module, tmp_path: Path) -> None:
    """Folder and target are the panel's; what is lost is a warning; the file stays as it is."""
    obj = ball()
    bpy.context.view_layer.objects.active = obj
    Solved = module("core.data").Solution
    maps = module("core.data").Maps(**{name: getattr(smooth_maps(), name) for name in Maps.__dataclass_fields__})
    found = replace(Solved.of_maps(maps, {"Skin": "one-lobe-specular"}), levels={"Skin": 0.2})
    module("blender.jobs.session").session.keep(obj, found)
    before = {name: list(getattr(bpy.data, name)) for name in ("images", "materials", "meshes", "objects", "scenes")}
    settings = bpy.context.scene.irpso
    settings.out, settings.target = str(tmp_path / "panel"), "unreal"
    assert bpy.ops.irpso.export_maps() == {"FINISHED"}
    assert sorted(os.listdir(tmp_path / "panel")) == ["T_Ball_BC.png", "T_Ball_ORM.png", "T_Ball_S.png"]
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path / "glb"), target="gltf") == {"FINISHED"}
    assert "Ball.glb" in os.listdir(tmp_path / "glb")
    settings.out = " "
    with pytest.raises(RuntimeError, match="Folder: is empty"):  # not into the folder where Blender was started
        bpy.ops.irpso.export_maps()
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path / "all"), target="irpso", format="png") == {"FINISHED"}
    assert "Ball_roughness_sigma.png" in os.listdir(tmp_path / "all")
    assert {name: list(getattr(bpy.data, name)) for name in before} == before


@pytest.mark.parametrize("target", TARGETS)
def test_the_operator_and_the_command_write_the_same(extension, module, irpso_here, tmp_path: Path, target) -> None:
    """What the user has set on the material counts in both; of what the material does not show, the result counts."""
    obj = ball()
    bpy.context.view_layer.objects.active = obj
    maps = module("core.data").Maps(**{name: getattr(smooth_maps(), name) for name in Maps.__dataclass_fields__})
    made = module("core.data").Solution.of_maps(maps, {"Skin": "one-lobe"})
    module("blender.jobs.session").session.keep(obj, made)
    inputs = principled_of(obj.data.materials[0]).inputs
    inputs["Metallic"].default_value, inputs["Coat Weight"].default_value = 0.75, 0.5
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path / "solved"), target=target) == {"FINISHED"}
    assert bpy.ops.irpso.write_maps() == {"FINISHED"}
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path / "panel"), target=target) == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "ball.blend"))
    assert irpso_here("export", tmp_path / "ball.blend", "--target", target, "--out", tmp_path / "cli").returncode == 0
    panel, command, solved = ({path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()}
                              for folder in ("panel", "cli", "solved"))
    assert panel == command != solved
