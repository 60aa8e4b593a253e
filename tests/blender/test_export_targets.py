"""Exports for other programs, read back by Blender itself: its glTF importer, Node Wrangler's names, Cycles' pixels."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from irpso_addon.blender.material import material
from irpso_addon.blender.material.surfaces import shown_surfaces, solved_surfaces
from irpso_addon.core.data import Coat
from tests.blender import cycles_rig
from tests.blender.export_ball import TEXELS, TOLERANCE, ball, difference, export, smooth_maps, solution
from tests.blender.materials import make_material, principled_of

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
