"""Files of the export's targets, read back by other programs' readers: Pillow and OpenImageIO."""

from __future__ import annotations

import os
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import Maps
from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.maps.export import file_name, layers, write_maps
from irpso_addon.core.maps.map_set import MapFiles, MapReader
from irpso_addon.core.maps.target_export import ExportObject, Surface, losses, write_target
from irpso_addon.core.maps.targets import IRPSO, TARGETS
from irpso_addon.core.params import ExportSettings
from tests.support.target_files import SIZE, STEP8, STEP16, cow, make_maps, make_mesh, pillow, write

oiio = pytest.importorskip("OpenImageIO")
TWO = 528  # texels: of two blocks


def bits(path: Path) -> int:
    """Of a channel: byte 24 of a PNG file (PNG specification, IHDR)."""
    return path.read_bytes()[24]


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


# ---- the writer


def test_8_bits_and_alpha(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((70, 3, 4), np.float32)
    values[..., 3] *= 0.01
    write_image(tmp_path / "a.png", values, kind="png8", color=False)
    np.testing.assert_allclose(pillow(tmp_path / "a.png"), values, atol=STEP8)
