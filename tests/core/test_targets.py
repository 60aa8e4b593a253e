"""Files of the export's targets, read back by other programs' readers: Pillow, OpenImageIO, the MaterialX library."""

from __future__ import annotations

import json
import os
import struct
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import Maps, MeshArrays
from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.maps.export import file_name, layers, write_maps
from irpso_addon.core.maps.map_set import MapFiles, MapReader
from irpso_addon.core.maps.target_export import ExportObject, Surface, losses, write_target
from irpso_addon.core.maps.targets import IRPSO, TARGETS
from irpso_addon.core.params import ExportSettings

oiio = pytest.importorskip("OpenImageIO")
Image = pytest.importorskip("PIL.Image")

SIZE = 40  # texels: of two blocks' size is TWO
TWO = 528
STEP8, STEP16 = 0.5001 / 255, 0.5001 / 65535  # rounding


def make_maps(size: int = SIZE, seed: int = 5) -> Maps:
    rng = np.random.default_rng(seed)
    grey = [rng.random((size, size), np.float32) for _ in range(5)]
    return Maps(rng.random((size, size, 3), np.float32), *grey[:3], grey[3] > 0.5, grey[3] > -1, grey[4], grey[0])


def make_mesh(name: str = "Cow", slots: tuple[int, ...] = (0, 0)) -> MeshArrays:
    """Two quads side by side that leave a gap of a fifth of the square between them; the quads' slots."""
    corners = []
    for left, right in ((0.0, 0.4), (0.6, 1.0)):
        a, b, c, d = (left, 0), (right, 0), (right, 1), (left, 1)
        corners += [(a, b, c), (a, c, d)]
    uvs = np.array(corners, np.float32)
    positions = np.concatenate([uvs * 2 + 1, np.full((4, 3, 1), 3, np.float32)], axis=-1)
    normals = np.zeros((4, 3, 3), np.float32)
    normals[..., 2] = 1
    return MeshArrays(name, positions, normals, uvs, np.repeat(np.int32(slots), 2),
                      tuple(f"Part {slot}" for slot in range(max(slots) + 1)))


def cow(*surfaces: Surface, normal: Any = None, name: str = "Cow") -> ExportObject:
    """The mesh with these materials, at most two."""
    surfaces = surfaces or (Surface("Part 0"),)
    return ExportObject(name, make_mesh(name, (0, len(surfaces) - 1)), surfaces, normal)


def write(obj: ExportObject, maps: Maps, target: str, out: Path) -> dict[str, Path]:
    """Paths by file name, all of which are there and nothing else."""
    paths = write_target(obj, MapReader.of_maps(maps), target, out)
    assert sorted(os.listdir(out)) == sorted(path.name for path in paths)
    return {path.name: path for path in paths}


def bits(path: Path) -> int:
    """Of a channel: byte 24 of a PNG file (PNG specification, IHDR)."""
    return path.read_bytes()[24]


def pillow(path: Path) -> np.ndarray:
    """(h, w, channels) 0..1 of an 8-bit file, row 0 at the bottom."""
    with Image.open(path) as image:
        pixels = np.asarray(image, np.float64) / 255
    return pixels.reshape(*pixels.shape[:2], -1)[::-1]


def openimageio(path: Path) -> np.ndarray:
    """The same of any file, by the other library."""
    buffer = oiio.ImageBuf(str(path))
    return np.asarray(buffer.get_pixels(oiio.FLOAT)).reshape(buffer.spec().height, buffer.spec().width, -1)[::-1]


def srgb(linear: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1."""
    linear = linear.astype("f8")
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def test_every_target_has_its_row_and_its_choice() -> None:
    (field,) = fields(ExportSettings)
    assert [key for key, _ in field.metadata["choices"]] == [IRPSO, *TARGETS]
    assert ExportSettings().target == IRPSO
    plain = {file_name("Cow", layer, "png") for layer in layers(replace(make_maps(), specular=make_maps().roughness))}
    assert not plain & {f"{file.name.format('Cow')}.png" for target in TARGETS.values() for file in target.files}


# ---- what the packed files hold


def test_gltf_is_packed_as_its_specification_says(tmp_path: Path) -> None:
    maps = make_maps()
    files = write(cow(Surface("Part 0", 0.25)), maps, "gltf", tmp_path)
    assert set(files) == {"Cow_baseColor.png", "Cow_occlusionRoughnessMetallic.png", "Cow.glb"}
    np.testing.assert_allclose(pillow(files["Cow_baseColor.png"]), srgb(maps.base_color), atol=STEP8)
    occlusion, roughness, metallic = np.moveaxis(pillow(files["Cow_occlusionRoughnessMetallic.png"]), -1, 0)
    assert (occlusion == 1).all()
    np.testing.assert_allclose(roughness, maps.roughness, atol=STEP8)
    np.testing.assert_allclose(metallic, 0.25, atol=STEP8)
    assert {bits(path) for path in files.values() if path.suffix == ".png"} == {8}


def test_unreal_is_packed_with_its_specular_input(tmp_path: Path) -> None:
    maps, normal = make_maps(), np.random.default_rng(0).random((5, 9, 3), np.float32)
    files = write(cow(Surface("Part 0", 1.0, 0.3), normal=normal), maps, "unreal", tmp_path)
    assert set(files) == {"T_Cow_BC.png", "T_Cow_ORM.png", "T_Cow_S.png", "T_Cow_N.png"}
    np.testing.assert_allclose(pillow(files["T_Cow_BC.png"]), srgb(maps.base_color), atol=STEP8)
    expected = np.stack([np.ones_like(maps.roughness), maps.roughness, np.ones_like(maps.roughness)], -1)
    np.testing.assert_allclose(pillow(files["T_Cow_ORM.png"]), expected, atol=STEP8)
    np.testing.assert_allclose(pillow(files["T_Cow_S.png"]), 0.3, atol=STEP8)
    np.testing.assert_allclose(pillow(files["T_Cow_N.png"])[..., 1], 1 - normal[..., 1], atol=STEP8)  # DirectX
    np.testing.assert_allclose(pillow(files["T_Cow_N.png"])[..., ::2], normal[..., ::2], atol=STEP8)


def test_unity_keeps_colours_where_alpha_is_small(tmp_path: Path) -> None:
    """Alpha is smoothness: nothing may be multiplied by it."""
    maps = make_maps()
    maps.roughness[:8] = 1.0  # smoothness 0
    files = write(cow(Surface("Part 0", 0.75)), maps, "unity", tmp_path)
    assert set(files) == {"Cow_BaseMap.png", "Cow_MaskMap.png"}
    metallic, occlusion, detail, smoothness = np.moveaxis(pillow(files["Cow_MaskMap.png"]), -1, 0)
    np.testing.assert_allclose(metallic, 0.75, atol=STEP8)
    assert (occlusion == 1).all() and (detail == 0).all()
    np.testing.assert_allclose(smoothness, 1 - maps.roughness, atol=STEP8)


@pytest.mark.parametrize(("target", "level_name", "green_up"), [
    ("blender", "Cow_Specular.png", True), ("substance", "Cow_SpecularLevel.png", False)])
def test_files_of_16_bits(tmp_path: Path, target: str, level_name: str, green_up: bool) -> None:
    maps, normal = make_maps(), np.random.default_rng(0).random((9, 5, 3), np.float32)
    files = write(cow(Surface("Part 0", 0.2, 0.0), normal=normal), maps, target, tmp_path)
    assert set(files) == {"Cow_BaseColor.png", "Cow_Roughness.png", "Cow_Metallic.png", "Cow_Normal.png", level_name}
    assert {bits(path) for path in files.values()} == {16}
    np.testing.assert_allclose(openimageio(files["Cow_BaseColor.png"]), srgb(maps.base_color), atol=STEP16 + 1e-7)
    np.testing.assert_allclose(openimageio(files["Cow_Roughness.png"])[..., 0], maps.roughness, atol=STEP16 + 1e-7)
    np.testing.assert_allclose(openimageio(files["Cow_Metallic.png"]), 0.2, atol=STEP16 + 1e-7)
    assert (openimageio(files[level_name]) == 0).all()
    green = normal[..., 1] if green_up else 1 - normal[..., 1]
    np.testing.assert_allclose(openimageio(files["Cow_Normal.png"])[..., 1], green, atol=STEP16 + 1e-7)


def test_one_level_of_a_half_has_no_file(tmp_path: Path) -> None:
    for target in TARGETS:
        files = write(cow(), make_maps(), target, tmp_path / target)
        assert not [name for name in files if "evel" in name or name.endswith(("Specular.png", "Weight.png", "_S.png"))]


@pytest.mark.parametrize("target", TARGETS)
def test_any_object_has_file_names(tmp_path: Path, target: str) -> None:
    obj = cow(Surface("Part 0", 1.0, 0.1), normal=np.full((4, 4, 3), 0.5, np.float32), name="../牛" * 80)
    assert len(write(obj, make_maps(), target, tmp_path)) >= 3


def test_two_lobes_become_their_mean(tmp_path: Path) -> None:
    """As a furnace sees them: each lobe reflects its weight's share, so the mean is w r1 + (1 - w) r2."""
    first, second, weight = np.random.default_rng(1).random((3, SIZE, SIZE), np.float32)
    maps = replace(make_maps(), lobes=np.stack([first, second, weight], -1))
    obj = cow(Surface("Part 0", lobes="beckmann"))
    files = write(obj, maps, "substance", tmp_path)
    expected = weight.astype("f8") * first + (1 - weight.astype("f8")) * second
    np.testing.assert_allclose(openimageio(files["Cow_Roughness.png"])[..., 0], expected, atol=STEP16 + 1e-6)
    (line,) = losses(obj, "substance")
    assert "'Part 0'" in line and "one roughness" in line and "Beckmann" in line and "\n" not in line
    assert losses(cow(), "unreal") == []


def test_unity_says_that_the_level_is_lost() -> None:
    (line,) = losses(cow(Surface("Part 0", level=0.31)), "unity")
    assert losses(cow(Surface("Part 0", level=0.31), Surface("Part 0", level=0.31)), "unity") == [line]  # in two slots
    assert "'Part 0'" in line and "0.31" in line
    assert losses(cow(Surface("Part 0", level=0.31)), "unreal") == []


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


# ---- materials that differ


def test_values_of_materials_go_to_their_texels(tmp_path: Path) -> None:
    files = write(cow(Surface("Part 0", 0.0, 0.5), Surface("Part 1", 1.0, 0.25)), make_maps(), "unreal", tmp_path)
    metallic, level = pillow(files["T_Cow_ORM.png"])[..., 2], pillow(files["T_Cow_S.png"])[..., 0]
    left, right = slice(0, 20), slice(20, 40)  # the gap between the islands is shared: 4 texels each
    assert (metallic[:, left] == 0).all() and (metallic[:, right] == 1).all()
    np.testing.assert_allclose(level[:, left], 0.5, atol=STEP8)
    np.testing.assert_allclose(level[:, right], 0.25, atol=STEP8)


def test_metal_and_paint_of_one_material_go_to_their_texels(tmp_path: Path) -> None:
    """In every file that holds Metallic; the other material keeps its one value."""
    maps = make_maps()
    maps = replace(maps, metallic=np.where(maps.confidence > 0.5, np.float32(1), np.float32(0)))
    obj = cow(Surface("Part 0", None, 0.5), Surface("Part 1", 0.75, 0.5))
    right = np.arange(SIZE) >= 20
    expected = np.where(right, np.float32(0.75), maps.metallic)
    for target, file, channel in (("unreal", "T_Cow_ORM.png", 2), ("gltf", "Cow_occlusionRoughnessMetallic.png", 2),
                                  ("unity", "Cow_MaskMap.png", 0)):
        files = write(obj, maps, target, tmp_path / target)
        np.testing.assert_allclose(pillow(files[file])[..., channel], expected, atol=STEP8)
        assert losses(obj, target) == []
    for target, file in (("blender", "Cow_Metallic.png"), ("substance", "Cow_Metallic.png"),
                         ("materialx", "Cow_base_metalness.png")):
        files = write(obj, maps, target, tmp_path / target)
        np.testing.assert_allclose(openimageio(files[file])[..., 0], expected, atol=STEP16 + 1e-7)
    document = (tmp_path / "materialx" / "Cow.mtlx").read_text()
    assert 'name="base_metalness" type="float" nodename="base_metalness_image"' in document


def test_metallic_of_blocks_is_read_from_their_files(tmp_path: Path) -> None:
    maps = make_maps(TWO)
    maps = replace(maps, metallic=np.where(maps.confidence > 0.5, np.float32(0.5), np.float32(0)))
    reader = MapReader.of_files(files_of(tmp_path / "maps", maps, (1001,)), ("basecolor", "roughness", "metallic"))
    paths = write_target(cow(Surface("Part 0", None)), reader, "unreal", tmp_path / "out")
    (orm,) = (path for path in paths if path.name.endswith("ORM.png"))
    np.testing.assert_allclose(pillow(orm)[..., 2], maps.metallic, atol=STEP8)


def test_a_material_without_faces_changes_nothing(tmp_path: Path) -> None:
    obj = ExportObject("Cow", make_mesh(slots=(1, 1)), (Surface("Unused", 1.0, 0.1), Surface("Part 1", 0.5)))
    assert (obj.metallic, obj.level) == (0.5, 0.5)
    files = write(obj, make_maps(), "unreal", tmp_path)
    np.testing.assert_allclose(pillow(files["T_Cow_ORM.png"])[..., 2], 0.5, atol=STEP8)


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


# ---- large maps, several UDIMs


def files_of(folder: Path, maps: Maps, udims: tuple[int, ...]) -> MapFiles:
    """As a large solve writes them."""
    tiled, paths = udims != (1001,), {}
    for udim in udims:
        for layer, path in zip(layers(maps), write_maps(maps, "Cow", folder, "exr"), strict=True):
            path.replace(folder / file_name("Cow", layer, "exr", udim if tiled else None))
            paths[layer] = folder / file_name("Cow", f"{layer}.<UDIM>" if tiled else layer, "exr")
    return MapFiles(paths, udims)


def test_maps_in_files_give_the_same_bytes(tmp_path: Path) -> None:
    maps = replace(make_maps(TWO), specular=make_maps(TWO, 9).roughness)
    obj = cow(Surface("Part 0", 0.25, None), Surface("Part 1", 0.75, 0.5))
    reader = MapReader.of_files(files_of(tmp_path / "maps", maps, (1001,)), ("basecolor", "roughness", "specular"))
    here = write(obj, maps, "gltf", tmp_path / "of memory")
    assert {p.name: p.read_bytes() for p in write_target(obj, reader, "gltf", tmp_path / "of files")} == {
        name: path.read_bytes() for name, path in here.items()}


def test_udims(tmp_path: Path) -> None:
    reader = MapReader.of_files(files_of(tmp_path / "maps", make_maps(), (1001, 1012)), ("basecolor", "roughness"))
    for target in ("gltf", "unity"):
        with pytest.raises(BadInput, match=r"^Cow: .*UDIM"):
            write_target(cow(), reader, target, tmp_path / target)
        assert not (tmp_path / target).exists()
    names = [path.name for path in write_target(cow(), reader, "materialx", tmp_path / "mtlx")]
    assert names == ["Cow_base_color.1001.png", "Cow_specular_roughness.1001.png", "Cow_base_color.1012.png",
                     "Cow_specular_roughness.1012.png", "Cow.mtlx"]
    assert 'value="Cow_base_color.&lt;UDIM&gt;.png"' in (tmp_path / "mtlx" / "Cow.mtlx").read_text()


def test_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(cow(), make_maps(seed=1), "gltf", tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    (tmp_path / "Cow.glb").unlink()
    (tmp_path / "Cow.glb").mkdir()
    with pytest.raises(BadInput, match=r"Cow\.glb"):
        write(cow(), make_maps(seed=2), "gltf", tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == {
        name: content for name, content in before.items() if name != "Cow.glb"}


def test_a_map_that_is_read_is_never_written(tmp_path: Path) -> None:
    """Names differ by case alone, which some systems do not tell apart: here a link stands in for that."""
    files = files_of(tmp_path, make_maps(), (1001,))
    os.link(files.of("roughness", 1001), tmp_path / "Cow_Roughness.png")
    before = files.of("roughness", 1001).read_bytes()
    with pytest.raises(BadInput, match=r"Cow_roughness\.exr.*another folder"):
        write_target(cow(), MapReader.of_files(files, ("basecolor", "roughness")), "substance", tmp_path)
    assert files.of("roughness", 1001).read_bytes() == before


# ---- documents


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


# ---- the writer


def test_8_bits_and_alpha(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((70, 3, 4), np.float32)
    values[..., 3] *= 0.01
    write_image(tmp_path / "a.png", values, kind="png8", color=False)
    np.testing.assert_allclose(pillow(tmp_path / "a.png"), values, atol=STEP8)
