"""Maps that are files, one for each UDIM: Cycles shows the right one on the right faces, wherever the folder goes."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.blender.files import map_files
from irpso_addon.blender.material import material
from irpso_addon.blender.material.tags import maps_of
from irpso_addon.core.images.colour import linear_to_srgb
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.maps.export import write_maps
from tests.blender.materials import make_maps, make_material, make_solution, source

SIZE = 8  # texels of a square = pixels of a face
UDIMS = (1002, 1011, 1102)  # v reaches 10


def make_strip(udims: tuple[int, ...]) -> bpy.types.Object:
    """Squares of 1 m side by side, the UVs of each in a UDIM of its own, under a camera that sees a texel a pixel."""
    mesh, count = bpy.data.meshes.new("Strip"), len(udims)
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    mesh.from_pydata([(i + x, y, 0) for i in range(count) for x, y in corners], [],
                     [tuple(range(4 * i, 4 * i + 4)) for i in range(count)])
    layer = mesh.uv_layers.new(name="UVMap")
    for i, udim in enumerate(udims):
        v, u = divmod(udim - 1001, 10)
        for k, (x, y) in enumerate(corners):
            layer.data[4 * i + k].uv = (u + x, v + y)
    mesh.materials.append(make_material("Skin"))
    obj = bpy.data.objects.new("Strip", mesh)
    camera = bpy.data.objects.new("Cam", bpy.data.cameras.new("Cam"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", count, (count / 2, 0.5, 2)
    scene = bpy.context.scene
    for each in (obj, camera):
        scene.collection.objects.link(each)
    scene.camera, scene.render.engine = camera, "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.device = 1, False, "CPU"
    scene.render.resolution_x, scene.render.resolution_y = count * SIZE, SIZE
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    return obj


def shown(socket: str, path: Path) -> np.ndarray:
    """What Cycles sees of a socket of the Principled, (SIZE, faces * SIZE, 3)."""
    shader = bpy.data.objects["Strip"].material_slots[0].material
    tree, texture = shader.node_tree, source(shader, socket)
    texture.interpolation = "Closest"  # a render looks a little beside the texel's centre
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(texture.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs["Emission"], tree.get_output_node("CYCLES").inputs["Surface"])
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = np.empty(image.size[0] * image.size[1] * 4, "f4")
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[..., :3]


@pytest.mark.parametrize("kind", ["exr", "png"])
@pytest.mark.parametrize("udims", [(1001,), UDIMS])
def test_cycles_shows_each_square_on_its_faces(empty, tmp_path: Path, udims: tuple[int, ...], kind: str) -> None:
    obj, out = make_strip(udims), tmp_path / "out"
    out.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    maps = {udim: make_maps(SIZE, seed=udim) for udim in (*udims, 1003)}
    solution = make_solution({"Skin": "one-lobe"}, make_maps(4))
    for udim in (udims[-1], 1003):  # of an earlier solve
        write_image(out / f"Strip_basecolor.{udim}.exr", maps[1003].base_color, kind="exr", color=True)
    assert material.link_maps(obj, solution, out, kind, udims) == ()
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "solved.blend"), copy=True)
    for udim in udims:  # only now, as a solve publishes all at once
        write_maps(maps[udim], "Strip", tmp_path / str(udim), kind)
        for path in (tmp_path / str(udim)).iterdir():
            path.rename(out / (path.name if udims == (1001,) else path.name.replace(".", f".{udim}.")))
    moved = tmp_path / "elsewhere"
    out.rename(moved)
    bpy.ops.wm.open_mainfile(filepath=str(moved / "solved.blend"))
    image = maps_of(bpy.data.objects["Strip"])["base_color"]
    assert image.filepath.startswith("//") and image.packed_file is None
    if udims == (1001,):
        assert image.source == "FILE"
    else:
        assert [tile.number for tile in image.tiles] == list(udims)
    exact = kind == "exr"  # 16 bits are a step of 1 / 65535, of the base colour in sRGB
    for socket, role in (("Base Color", "base_color"), ("Roughness", "roughness")):
        want = np.concatenate([getattr(maps[udim], role) for udim in udims], 1)
        want = want if want.ndim == 3 else np.repeat(want[..., None], 3, -1)
        found = shown(socket, tmp_path / f"{role}.exr")
        if exact or role == "roughness":
            np.testing.assert_allclose(found, want, atol=2e-6 if exact else 1e-5)
        else:
            np.testing.assert_allclose(linear_to_srgb(found), linear_to_srgb(want), atol=2e-5)


def test_roles_that_point_to_one_image(empty) -> None:
    """Nobody but a broken file has that; each role gets an image of its own."""
    obj = make_strip((1001,))
    obj["irpso"] = dict.fromkeys(("base_color", "roughness"), bpy.data.images.new("odd", 4, 4))
    material.write_maps(obj, make_solution({"Skin": "one-lobe"}))
    images = maps_of(obj)
    assert images["base_color"].name == "Strip_basecolor" and images["roughness"].name == "Strip_roughness"


def test_a_large_solve_replaces_packed_maps_and_is_replaced_by_them(empty, tmp_path: Path) -> None:
    obj = make_strip((1001, 1002))
    solution = make_solution({"Skin": "one-lobe"})
    material.write_maps(obj, solution)
    count, nodes = len(bpy.data.images), len(obj.material_slots[0].material.node_tree.nodes)
    material.link_maps(obj, solution, tmp_path, "exr", (1001, 1002))
    assert {image.source for image in maps_of(obj).values()} == {"TILED"}
    material.write_maps(obj, solution)
    assert all(image.packed_file for image in maps_of(obj).values())
    assert (len(bpy.data.images), len(obj.material_slots[0].material.node_tree.nodes)) == (count, nodes)


@pytest.mark.parametrize("name", ["Strip", "my_basecolor"])
def test_the_filled_texels_are_found_by_the_objects_files(empty, tmp_path: Path, name: str) -> None:
    """They have no image in the .blend; an object may be called like a map."""
    obj = make_strip(UDIMS)
    obj.name = name
    material.link_maps(obj, make_solution({"Skin": "one-lobe"}, make_maps(4)), tmp_path, "exr", UDIMS)
    for udim in UDIMS:
        (tmp_path / f"{name}_filled.{udim}.exr").touch()
    assert map_files(obj).paths["filled"] == tmp_path / f"{name}_filled.<UDIM>.exr"
