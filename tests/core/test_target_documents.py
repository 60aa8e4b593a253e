"""Documents of the export's targets, by their specifications: glTF's binary, and MaterialX, read by its library."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.maps.target_export import Surface, losses
from tests.support.target_files import SIZE, cow, make_maps, pillow, write

# ---- glTF


def glb(path: Path) -> tuple[dict[str, Any], list[bytes]]:
    """The JSON and the buffer views of a GLB (glTF 2.0 specification, 4.4)."""
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert kind == b"JSON" and size % 4 == 0
    root = json.loads(content[20:20 + size])
    rest, kind = struct.unpack_from("<I4s", content, 20 + size)
    start = 28 + size
    assert kind == b"BIN\0" and start + rest == len(content) and root["buffers"] == [{"byteLength": rest}]
    views = [content[start + v["byteOffset"]:start + v["byteOffset"] + v["byteLength"]] for v in root["bufferViews"]]
    return root, views


@pytest.mark.parametrize(("level", "expected"), [
    (0.5, None), (0.25, {"specularFactor": 0.5}), (0.0, {"specularFactor": 0.0}),
    (0.75, {"specularFactor": 1.0, "specularColorFactor": [1.5, 1.5, 1.5]})])
def test_glb_holds_mesh_images_and_specular(tmp_path: Path, level: float, expected: Any) -> None:
    normal = np.full((4, 4, 3), 0.5, np.float32)
    obj = cow(Surface("Part 0", 0.0, level), normal=normal, name='Kuh "ä" <&>')
    files = write(obj, make_maps(), "gltf", tmp_path)
    (path,) = (path for path in files.values() if path.suffix == ".glb")
    root, views = glb(path)
    assert root["materials"][0].get("extensions") == (expected and {"KHR_materials_specular": expected})
    assert root.get("extensionsUsed") == (expected and ["KHR_materials_specular"])
    images = [views[image["bufferView"]] for image in root["images"]]
    assert images == [file.read_bytes() for file in files.values() if file.suffix == ".png"]
    assert root["nodes"][0]["name"] == 'Kuh "ä" <&>'
    primitive = root["meshes"][0]["primitives"][0]
    accessors = {name: root["accessors"][i] for name, i in primitive["attributes"].items()}
    order = np.frombuffer(views[root["accessors"][primitive["indices"]]["bufferView"]], "<u4")
    positions, normals, uvs = (np.frombuffer(views[accessors[name]["bufferView"]], "<f4").reshape(
        accessors[name]["count"], -1)[order] for name in ("POSITION", "NORMAL", "TEXCOORD_0"))
    assert accessors["POSITION"]["count"] == 8 and len(order) == 12  # corners of two quads
    x, y, z = obj.mesh.positions.reshape(-1, 3).T
    np.testing.assert_array_equal(positions, np.stack([x, z, -y], -1))  # Y up
    np.testing.assert_array_equal(normals, np.tile(np.float32([0, 1, 0]), (12, 1)))
    np.testing.assert_allclose(uvs, obj.mesh.uvs.reshape(-1, 2) * [1, -1] + [0, 1], atol=1e-7)
    assert accessors["POSITION"]["min"] == positions.min(0).tolist()


def test_a_map_of_the_level_and_a_value_beside_it(tmp_path: Path) -> None:
    specular = np.random.default_rng(2).random((SIZE, SIZE), np.float32)
    maps = replace(make_maps(), specular=specular)
    files = write(cow(Surface("Part 0", 0.0, None), Surface("Part 1", 0.0, 0.9)), maps, "gltf", tmp_path)
    weight = pillow(files["Cow_specularWeight.png"])
    assert (weight[..., :3] == 1).all()
    expected = specular.copy()
    expected[:, 20:] = 0.9
    factor = glb(files["Cow.glb"])[0]["materials"][0]["extensions"]["KHR_materials_specular"]
    assert factor["specularTexture"] == {"index": 2} and "specularFactor" not in factor
    # F0 = 0.04 * colour * weight (the extension), 0.08 * level (the Principled BSDF).
    np.testing.assert_allclose(0.04 * factor["specularColorFactor"][0] * weight[..., 3], 0.08 * expected, atol=2e-4)


# ---- MaterialX


def opened(path: Path) -> Any:
    """The document, read and found valid by the MaterialX library together with its standard libraries."""
    mx = pytest.importorskip("MaterialX")
    standard = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), standard)
    document = mx.createDocument()
    mx.readFromXmlFile(document, str(path))
    document.setDataLibrary(standard)
    valid, message = document.validate()
    assert valid, message
    return document


def surface_of(document: Any) -> Any:
    import MaterialX as mx

    (material,) = document.getMaterialNodes()
    (shader,) = mx.getShaderNodes(material)
    assert shader.getCategory() == "open_pbr_surface" and shader.getNodeDef() is not None
    return shader


def test_materialx_has_a_diffuse_roughness_that_other_targets_lose(tmp_path: Path) -> None:
    rough = Surface("Part 0", diffuse_roughness=0.625)
    files = write(cow(rough), make_maps(), "materialx", tmp_path)
    document = opened(files["Cow.mtlx"])
    shader = surface_of(document)
    assert shader.getInputValue("base_diffuse_roughness") == pytest.approx(0.625)
    assert document.validate()[0]
    assert losses(cow(rough), "materialx") == [] and losses(cow(), "unity") == []
    for target in ("unreal", "unity", "gltf", "substance", "blender"):
        (line,) = losses(cow(rough), target)
        assert "'Part 0'" in line and "no Diffuse Roughness; 0.625 is lost" in line
    both = cow(rough, Surface("Part 1"))  # one document has one value
    files = write(both, make_maps(), "materialx", tmp_path / "both")
    assert "base_diffuse_roughness" not in files["Cow.mtlx"].read_text()
    (line,) = losses(both, "materialx")
    assert "'Part 0'" in line and "0.625 is lost" in line


def test_materialx_has_a_coat_that_all_materials_share(tmp_path: Path) -> None:
    """Without the darkening of what lies below, which the Principled BSDF's coat lacks.  Else a line names it."""
    coated = Surface("Part 0", coat=0.6, coat_roughness=0.1)
    obj = cow(coated, normal=np.full((4, 4, 3), 0.5, np.float32))
    files = write(obj, make_maps(), "materialx", tmp_path / "one")
    document = opened(next(path for path in files.values() if path.suffix == ".mtlx"))
    shader = surface_of(document)
    values = [shader.getInputValue(f"coat_{name}") for name in ("weight", "roughness", "ior", "darkening")]
    assert values == pytest.approx([0.6, 0.1, 1.5, 0.0]) and losses(obj, "materialx") == []
    assert shader.getConnectedNode("geometry_coat_normal") == shader.getConnectedNode("geometry_normal")
    obj = cow(coated, Surface("Part 1"))
    files = write(obj, make_maps(), "materialx", tmp_path / "two")
    document = opened(next(path for path in files.values() if path.suffix == ".mtlx"))
    assert surface_of(document).getInput("coat_weight") is None and "coat of weight 0.6" in losses(obj, "materialx")[0]


@pytest.mark.parametrize("name", ["Cow", "7 Kühe <&\"'>", "牛"])
def test_materialx_reads_the_document(tmp_path: Path, name: str) -> None:
    obj = cow(Surface("Part 0", 0.25, 0.3), normal=np.full((4, 4, 3), 0.5, np.float32), name=name)
    files = write(obj, make_maps(), "materialx", tmp_path)
    (path,) = (path for path in files.values() if path.suffix == ".mtlx")
    document = opened(path)  # whoever drops it loses its nodes
    shader = surface_of(document)
    for socket, kind, space in (
            ("base_color", "color3", "srgb_texture"), ("specular_roughness", "float", "lin_rec709")):
        image = shader.getConnectedNode(socket)
        file = image.getInput("file")
        assert (image.getCategory(), image.getType()) == ("image", kind)
        assert file.getActiveColorSpace() == space
        assert (tmp_path / file.getValueString()).is_file()
    assert shader.getInputValue("base_metalness") == pytest.approx(0.25)
    ior = shader.getInputValue("specular_ior")
    assert ((ior - 1) / (ior + 1)) ** 2 == pytest.approx(0.08 * 0.3, rel=1e-5)
    assert shader.getConnectedNode("geometry_normal").getCategory() == "normalmap"
    for node in document.getNodes():
        assert node.getNodeDef() is not None, node.getName()


def test_materialx_computes_the_index_of_refraction_of_a_map(tmp_path: Path) -> None:
    """The graph of nodes, followed in Python, gives F0 = 0.08 level."""
    obj = cow(Surface("Part 0", 0.0, None), Surface("Part 1", 1.0, None))
    files = write(obj, replace(make_maps(), specular=make_maps(seed=6).roughness), "materialx", tmp_path)
    assert {"Cow_specular_level.png", "Cow_base_metalness.png"} <= set(files)
    document = opened(files["Cow.mtlx"])
    shader = surface_of(document)
    assert shader.getConnectedNode("base_metalness").getInputValue("file") == "Cow_base_metalness.png"

    def value(node: Any, level: float) -> float:
        if node.getCategory() == "image":
            assert node.getInputValue("file") == "Cow_specular_level.png"
            return level
        inputs = [value(i.getConnectedNode(), level) if i.getConnectedNode() else i.getValue()
                  for i in node.getInputs()]
        return {"multiply": lambda a, b: a * b, "add": lambda a, b: a + b, "subtract": lambda a, b: a - b,
                "divide": lambda a, b: a / b, "sqrt": lambda a: a ** 0.5}[node.getCategory()](*inputs)

    for level in (0.0, 0.1, 0.5, 1.0):
        ior = value(shader.getConnectedNode("specular_ior"), level)
        assert ((ior - 1) / (ior + 1)) ** 2 == pytest.approx(0.08 * level, abs=1e-7)


def test_materialx_makes_shaders_of_the_document(tmp_path: Path) -> None:
    """Its generator resolves every node down to code."""
    mx = pytest.importorskip("MaterialX")
    from MaterialX import PyMaterialXGenGlsl as gen_glsl
    from MaterialX import PyMaterialXGenShader as gen

    obj = cow(Surface("Part 0", 0.5, None), normal=np.full((4, 4, 3), 0.5, np.float32))
    files = write(obj, replace(make_maps(), specular=make_maps(seed=6).roughness), "materialx", tmp_path)
    document = opened(files["Cow.mtlx"])
    generator = gen_glsl.GlslShaderGenerator.create()
    context = gen.GenContext(generator)
    context.registerSourceCodeSearchPath(mx.getDefaultDataSearchPath())
    shader = generator.generate("cow", document.getMaterialNodes()[0], context)
    code = shader.getSourceCode("pixel")
    images = ("base_color", "specular_roughness", "specular_level", "geometry_normal")
    assert all(f"{image}_image" in code for image in images)
