"""A shoot by Cycles through ``irpso import`` and ``irpso solve``, against the numbers that it was made from."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest

from irpso_addon.blender import files
from irpso_addon.blender.jobs import solve_object
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.images.colour import linear_to_srgb
from irpso_addon.core.images.image_file import open_image
from irpso_addon.core.images.reference_image import read_reference
from irpso_addon.core.images.response import curved
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.projection import pixels_of
from irpso_addon.core.shoot.grey_patch import CHART_GREYS
from tests.support.photo_shoot import FLASH_POWER, UNIT, save_dng
from tests.support.picture_files import save

ROOT = Path(__file__).resolve().parents[2]
VIEWS, PIXELS = 14, 120
FORMATS = ("transforms.json", "metashape.xml", "colmap_text", "colmap_binary")
FLASH = ("--flash-right", 60, "--flash-above", 10, "--flash-size", 20)  # photo_shoot.OFFSET and FLASH_SIZE, mm
POWER = FLASH_POWER * UNIT**2  # watts in a scene of metres
PIXEL = 0.05  # greatest difference: floats of the .blend are single


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a shoot.  Read only."""
    folder = tmp_path_factory.mktemp("shoot")
    done = subprocess.run([sys.executable, "-m", "tests.support.photo_shoot", str(folder), "--views", str(VIEWS),
                           "--pixels", str(PIXELS)], cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def bring(irpso_here, made, tmp_path):
    """``bring("metashape.xml", ...)``: the command; the scene that it has written, and its lines on stderr."""
    def run(project="transforms.json", *more, images=made / "pictures", mesh=made / "mesh.obj", code=0):
        out = tmp_path / "out" / "shoot.blend"
        done = irpso_here("import", made / project, "--images", images, "--mesh", mesh, "--out", out, "--scale", UNIT,
                          *more)
        lines = [line for line in done.stderr.splitlines() if "irpso: " in line and " % " not in line[:14]]
        assert done.returncode == code and "Traceback" not in done.stderr, done.stderr
        if code:
            assert not out.parent.exists() and len(lines) == 1, lines
            return lines[0]
        assert out.exists()
        files.open_blend(out)
        return read_scene(None, None, None), lines
    return run


def test_a_mesh_without_normals_and_uvs_gets_both(bring, made, tmp_path) -> None:
    """As most programs write a scan: Blender reads it flat.  Its normals then are those that the file had."""
    own, _ = bring()
    shutil.rmtree(tmp_path / "out")
    bare = tmp_path / "bare.obj"
    kept = [line for line in (made / "mesh.obj").read_text().splitlines() if line.split(" ")[0] in ("v", "f")]
    bare.write_text("\n".join(re.sub(r"/\S*", "", line) for line in kept))
    found, lines = bring(mesh=bare)
    assert any("'bare': its file has no normals, so it was shaded smooth" in line for line in lines)
    assert any("'bare': has no UV map; one was made" in line for line in lines)
    assert len(found.mesh.normals) == len(own.mesh.normals)
    between = np.einsum("tik,tik->ti", found.mesh.normals, own.mesh.normals).clip(-1, 1)
    flat = np.cross(*(own.mesh.positions[:, n] - own.mesh.positions[:, 0] for n in (1, 2)))
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    facets = np.einsum("tk,tik->ti", flat, own.mesh.normals).clip(-1, 1)
    assert np.median(np.arccos(between)) < 0.1 * np.median(np.arccos(facets))


def frames(made: Path) -> dict[str, dict]:
    """What transforms.json says of each picture: the shoot's own numbers."""
    listed = json.loads((made / "transforms.json").read_text())["frames"]
    return {Path(frame["file_path"]).stem: frame for frame in listed}


def points(made: Path) -> np.ndarray:
    """(N, 3) some places of the mesh, in the project's units."""
    lines = (made / "mesh.obj").read_text().splitlines()
    return np.array([line.split()[1:4] for line in lines if line.startswith("v ")][::97], float)


def seen(frame: dict, places: np.ndarray, k3: float) -> np.ndarray:
    """(N, 2) pixels from the upper left corner, by Brown (1966) as OpenCV writes it."""
    matrix = np.array(frame["transform_matrix"])
    x, y, z = (np.linalg.inv(matrix[:3, :3]) @ (places - matrix[:3, 3]).T) * [[1], [-1], [-1]]
    x, y = x / z, y / z
    s = x * x + y * y
    radial = 1 + frame["k1"] * s + frame["k2"] * s**2 + k3 * s**3
    p1, p2 = frame["p1"], frame["p2"]
    u = x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x)
    v = y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y
    return np.stack([frame["cx"] + frame["fl_x"] * u, frame["cy"] + frame["fl_y"] * v], -1)


def upwards(pixels: np.ndarray, height: float) -> np.ndarray:
    """Rows counted from the bottom, as `pixels_of` counts."""
    return pixels * (1, -1) + (0, height)


@pytest.mark.parametrize("project", FORMATS)
def test_cameras_are_those_of_the_shoot(bring, made, project):
    scene, _ = bring(project, *FLASH, "--flash-power", POWER)
    known, places = frames(made), points(made)
    count = VIEWS if project == "transforms.json" else VIEWS - VIEWS // 4  # the others have the landscape pictures
    assert len(scene.views) == count and len({view.camera.name for view in scene.views}) == count
    for view in scene.views:
        assert view.image.exists()
        frame = known[view.image.stem]
        # COLMAP's OPENCV model has no k3; transforms.json has it only where it is written.
        k3 = frame.get("k3", 0.0) if project in ("transforms.json", "metashape.xml") else 0.0
        want = upwards(seen(frame, places, k3), frame["h"])
        found = pixels_of(view.camera, places * UNIT, (frame["w"], frame["h"]))
        assert np.abs(found - want).max() < PIXEL
        light = view.lights[0]
        local = view.camera.world_to_camera @ light.matrix[:, 3]
        np.testing.assert_allclose(local[:3], (0.06, 0.01, 0), atol=1e-6)
        np.testing.assert_allclose(light.power, POWER, rtol=1e-6)
        assert light.radius == pytest.approx(0.01) and view.lights == (light,)
    assert scene.scale_known and bpy.context.scene.irpso.photographs


def test_the_power_is_found(bring):
    """Nothing says how white the vase is: 98 of 100 of its pixels are darker than 0.8 if the power is right."""
    scene, lines = bring("transforms.json", *FLASH)
    assert any("its power is not known" in line for line in lines) and not scene.scale_known
    assert 0.7 < scene.views[0].lights[0].power[0] / POWER < 1.3


def test_a_chart_in_a_picture_that_has_no_camera(bring, made, tmp_path):
    """PNG files with a tone curve, and a chart of 24 patches with the same one: the views get it, and with it the power
    is found as without a curve.
    """
    folder = tmp_path / "developed"
    folder.mkdir()
    for picture in (made / "pictures").glob("*.exr"):
        pixels = oiio.ImageBuf(str(picture)).get_pixels(oiio.FLOAT)[..., :3]
        save(folder / f"{picture.stem}.png", linear_to_srgb(curved(np.clip(pixels, 0, 1), 1.2, 6.0)), "uint16")
    chart = np.full((80, 260, 3), 0.02)
    for number, grey in enumerate(CHART_GREYS):
        chart[20:60, 10 + 40 * number:45 + 40 * number] = 0.9 * grey
    save(folder / "chart.png", linear_to_srgb(curved(chart, 1.2, 6.0)), "uint16")
    scene, lines = bring("transforms.json", *FLASH, "--chart", "chart.png", 27, 40, 227, 40, images=folder)
    assert any("now set for all views" in line for line in lines)
    assert any("chart.png: has no camera, so that the light on the chart is not known" in line for line in lines)
    assert {(round(view.response, 2), round(view.shoulder, 1)) for view in scene.views} == {(1.2, 6.0)}
    assert any("its power is not known" in line for line in lines) and not scene.scale_known
    assert 0.7 < scene.views[0].lights[0].power[0] / POWER < 1.3
    shutil.rmtree(tmp_path / "out")
    for given, words in ((("none.png", 27, 40, 227, 40), "none.png: no view has this picture"),
                         (("chart.png", 27, 40, 227, "ten"), "--chart chart.png 27 40 227 ten: XW, YW, XB and YB must "
                          "be numbers"),
                         (("chart.png", 227, 40, 27, 40), "click white first, then black")):
        assert words in bring("transforms.json", *FLASH, "--chart", *given, images=folder, code=3)


def test_the_blend_can_be_moved_with_its_pictures(bring):
    scene, _ = bring()
    views = bpy.context.scene.irpso.views
    assert all(view.image.startswith("//") for view in views) and len(views) == len(scene.views) == VIEWS
    lights = [obj for obj in bpy.data.objects if obj.type == "LIGHT"]
    assert len(lights) == VIEWS and len({light.data for light in lights}) == 1
    assert all(light.hide_render and light.hide_viewport for light in lights)  # none lights a render by itself


def test_fixed_lamps_are_left_to_the_user(bring, irpso_here):
    with pytest.raises(Exception, match="no light that renders"):
        bring("transforms.json", "--rig", "lamps")
    assert not [obj for obj in bpy.data.objects if obj.type == "LIGHT"]
    assert not any(len(view.lights) for view in bpy.context.scene.irpso.views)


def some_frames(made: Path, folder: Path, stems: list[str], **more) -> Path:
    """A transforms.json of some pictures beside a copy of the mesh."""
    listed = [{**frame, **more} for stem, frame in frames(made).items() if stem in stems]
    shutil.copy(made / "mesh.obj", folder)
    (folder / "transforms.json").write_text(json.dumps({"frames": listed}))
    return folder / "transforms.json"


def test_raw_files_beside_a_project_of_full_size(bring, made, tmp_path):
    """DNGs of 240 x 160 samples are pictures of 120 x 80; the project was made from 240 x 160 pixels."""
    stem = "IMG_0001"
    frame = frames(made)[stem]
    double = {key: 2 * frame[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
    project = some_frames(made, tmp_path, [stem], **double)
    picture = open_image(made / "pictures" / f"{stem}.exr")
    rgb = picture.read(0, picture.height)[..., :3]
    (tmp_path / "raw").mkdir()
    save_dng(tmp_path / "raw" / f"{stem}.dng", rgb)
    scene, lines = bring(project, *FLASH, "--flash-power", POWER, images=tmp_path / "raw")
    (view,) = scene.views
    assert view.image.suffix == ".dng" and not any("RAW" in line for line in lines)
    found = pixels_of(view.camera, points(made) * UNIT, (120, 80))
    assert np.abs(found - upwards(seen(frame, points(made), 0.0), 80)).max() < PIXEL
    image = read_reference(view)
    np.testing.assert_allclose(image.rgb[::-1], rgb, atol=0.02 * rgb.max())
    (full,) = solve_object.read(None, None, None, SolveSettings(raw_size="full"), writes=False).data.views
    whole = read_reference(full).rgb[::-1]
    assert whole.shape == (160, 240, 3) and not view.full_raw
    assert np.median(np.abs(whole.reshape(80, 2, 120, 2, 3).mean((1, 3)) - rgb)) < 0.01 * rgb.max()


def test_a_developed_picture_among_raw_files(bring, made, tmp_path):
    stems = ["IMG_0001", "IMG_0002"]
    project = some_frames(made, tmp_path, stems)
    (tmp_path / "mixed").mkdir()
    shutil.copy(made / "pictures" / f"{stems[0]}.exr", tmp_path / "mixed")
    save_dng(tmp_path / "mixed" / f"{stems[1]}.dng", np.full((80, 120, 3), 0.1, np.float32))
    _, lines = bring(project, *FLASH, "--flash-power", POWER, images=tmp_path / "mixed")
    assert [line.split(": ")[1] for line in lines if "not RAW as the other pictures are" in line] == ["'IMG_0001.exr'"]


def test_masks_of_raw_files_that_hold_more_than_the_project(bring, made, tmp_path):
    """DNGs of 240 x 160 samples; the project was made from the middle 236 x 158 pixels, and so was the mask, maybe."""
    stem = "IMG_0001"
    frame = frames(made)[stem]
    part = {key: 2 * frame[key] for key in ("fl_x", "fl_y")} | {
        "w": 236, "h": 158, "cx": 2 * frame["cx"] - 2, "cy": 2 * frame["cy"] - 1}
    project = some_frames(made, tmp_path, [stem], **part)
    picture = open_image(made / "pictures" / f"{stem}.exr")
    (tmp_path / "raw").mkdir()
    save_dng(tmp_path / "raw" / f"{stem}.dng", picture.read(0, picture.height)[..., :3])
    save(tmp_path / "raw" / f"{stem}_mask.png", np.ones((158, 236, 1), np.float32), "uint8", "Y")
    _, lines = bring(project, *FLASH, "--flash-power", POWER, images=tmp_path / "raw")
    text = "\n".join(lines)
    assert "1 picture: the RAW files hold a few more pixels (240 x 160)" in text
    assert f"'pictures/{stem}.exr': the mask is taken to cover the whole RAW file" in text


def test_masks_that_the_project_states(bring, made, tmp_path):
    project = some_frames(made, tmp_path, ["IMG_0002", "IMG_0004"])
    content = json.loads(project.read_text())
    for frame, mask in zip(content["frames"], ("cut/a.png", "cut/b.png"), strict=True):
        frame["mask_path"] = mask
    project.write_text(json.dumps(content))
    (tmp_path / "cut").mkdir()
    save(tmp_path / "cut" / "a.png", np.ones((80, 120, 1)), "uint8", "Y")
    scene, lines = bring(project, *FLASH, "--flash-power", POWER)
    masks = [view.mask for view in scene.views]
    assert [mask and mask.name for mask in masks] == ["a.png", None] and masks[0].samefile(tmp_path / "cut" / "a.png")
    assert len([line for line in lines if "the project states a mask, but there is no such file" in line]) == 1


def test_portraits_that_the_project_has_lying(bring, made, tmp_path):
    """The program read the pictures as they are stored; a viewer turns them upright, and so does the solver."""
    stems = ["IMG_0000", "IMG_0001"]
    project = some_frames(made, tmp_path, stems)
    (tmp_path / "p").mkdir()
    for stem, orientation in zip(stems, (6, 1), strict=True):
        picture = open_image(made / "pictures" / f"{stem}.exr")
        save(tmp_path / "p" / f"{stem}.tif", np.clip(picture.read(0, 80)[..., :3], 0, 1), "uint16",
             Orientation=orientation)
    scene, lines = bring(project, *FLASH, "--flash-power", POWER, images=tmp_path / "p")
    assert sum("1 picture: the project stores them as the camera did" in line for line in lines) == 1
    view = next(view for view in scene.views if view.image.stem == stems[0])
    assert (view.camera.lens.width, view.camera.lens.height) == (80, 120)
    u, v = seen(frames(made)[stems[0]], points(made), 0.0).T
    found = pixels_of(view.camera, points(made) * UNIT, (80, 120))
    assert np.abs(found - upwards(np.stack([80 - v, u], -1), 120)).max() < PIXEL
    # Right of the body is down in the picture, above it right.
    local = view.camera.world_to_camera @ view.lights[0].matrix[:, 3]
    np.testing.assert_allclose(local[:3], (0.01, -0.06, 0), atol=1e-6)
    assert read_reference(view).rgb.shape[:2] == (120, 80)


def test_small_pictures_of_a_large_project_and_masks(bring, made, tmp_path):
    stem = "IMG_0002"
    project = some_frames(made, tmp_path, [stem, "IMG_0004"])
    (tmp_path / "small").mkdir()
    values = np.full((40, 60, 3), 0.5, np.float32)
    save(tmp_path / "small" / f"{stem}.exr", values)
    save(tmp_path / "small" / f"{stem}_mask.png", np.eye(40, 60)[..., None], "uint8", "Y")
    save(tmp_path / "small" / "other.exr", values)
    scene, lines = bring(project, *FLASH, "--flash-power", POWER, images=tmp_path / "small")
    (view,) = scene.views
    assert view.mask is not None and view.mask.name == f"{stem}_mask.png"
    found = pixels_of(view.camera, points(made) * UNIT, (60, 40))
    assert np.abs(found - upwards(seen(frames(made)[stem], points(made), 0.0) / 2, 40)).max() < PIXEL
    text = "\n".join(lines)
    assert "'pictures/IMG_0004.exr': the project has a camera, but the folder has no picture" in text
    assert "1 picture of the folder: not in the project" in text


@pytest.mark.one_python
def test_from_photographs_to_maps(bring, made, irpso_here, tmp_path):
    """64 texels from 14 small pictures: medians where the solve is confident."""
    bring("transforms.json", *FLASH, "--flash-power", POWER)
    done = irpso_here("solve", tmp_path / "out" / "shoot.blend", "--out", tmp_path / "maps", "--size", 64, "--model",
                      "one-lobe")
    assert done.returncode == 0, done.stderr
    base, rough, confidence = (values(tmp_path / "maps" / f"mesh_{name}.exr")
                               for name in ("basecolor", "roughness", "confidence"))
    truth = [values(made / "truth" / f"mesh_{name}.exr") for name in ("basecolor", "roughness")]
    true_base, true_rough = (each.reshape(64, len(each) // 64, 64, -1, 3).mean((1, 3)) for each in truth)
    seen_by_some = confidence[..., 0] > 0
    assert seen_by_some.mean() > 0.7
    ratio = (base / true_base)[seen_by_some]
    assert abs(np.median(ratio) - 1) < 0.05 and np.median(np.abs(ratio - 1)) < 0.15
    error = np.abs(rough - true_rough)[seen_by_some]
    flat = np.abs(true_rough - true_rough[seen_by_some].mean())[seen_by_some]
    assert np.median(error) < 0.1 and np.median(error) < 0.7 * np.median(flat)  # than a map of the mean roughness


def values(path: Path) -> np.ndarray:
    """(h, w, 3)"""
    file = open_image(path)
    return file.read(0, file.height)[..., :3]


# ---- what cannot be imported


def test_bad_projects(bring, made, tmp_path):
    (tmp_path / "notes.xml").write_text("hello")
    assert "there.xml: cannot be opened" in bring(tmp_path / "there.xml", code=3)
    assert "notes.xml: is not a project that can be read" in bring(tmp_path / "notes.xml", code=3)
    assert "nowhere: folder not found" in bring(images=tmp_path / "nowhere", code=3)
    assert "has none of the project's pictures (" in bring(images=tmp_path, code=3)


MESHES = {
    "mesh.txt": (b"", "is not a mesh file"), "points.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        b"0 0 0\n", "has 1 points and no face"),
    "far.obj": (b"v 90 0 0\nv 91 0 0\nv 90 1 0\nf 1 2 3\n", "of the cameras look at it; its coordinates differ"),
    "noise.glb": (bytes(range(256)), "noise.glb: "),
    "noise.fbx": (bytes(range(256)), "noise.fbx: "), "empty.obj": (b"", "empty.obj: "),
    "noise.usdc": (bytes(range(256)), "noise.usdc: "),
    "node.gltf": (b'{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 5}]}',
                  "node.gltf: Blender cannot read it ("),
}


@pytest.mark.parametrize("name", MESHES)
def test_bad_meshes(bring, tmp_path, name):
    content, words = MESHES[name]
    (tmp_path / name).write_bytes(content)
    line = bring(mesh=tmp_path / name, code=3)
    assert words in line and "Location" not in line and "mesh_file.py" not in line
    assert "there.obj: file not found" in bring(mesh=tmp_path / "there.obj", code=3)


def test_bad_pictures(bring, made, tmp_path):
    stem = "IMG_0000"
    project = some_frames(made, tmp_path, [stem])
    folder = tmp_path / "p"
    folder.mkdir()
    picture = folder / f"{stem}.exr"
    grey = np.full((80, 120, 3), 0.5, np.float32)
    save(picture, grey[:, :100])
    assert f"{stem}.exr: is 100 x 80 pixels, but the project's camera" in bring(project, images=folder, code=3)
    picture.write_bytes(picture.read_bytes()[:40])
    assert f"{stem}.exr: cannot be read as an image" in bring(project, images=folder, code=3)
    save(picture, 0 * grey)
    assert "mesh 'mesh': it is black in every picture" in bring(project, images=folder, code=3)
    save(picture, grey)
    save(folder / f"{stem}_mask.png", grey[:, :100, :1], "uint8", "Y")
    assert f"{stem}_mask.png: is 100 x 80 pixels, but the picture that it masks" in bring(
        project, images=folder, code=3)
    (folder / f"{stem}_mask.png").unlink()
    (folder / "again").mkdir()
    shutil.copy(picture, folder / "again")
    assert "can be the project's picture" in bring(project, images=folder, code=3)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_names_that_are_no_text(bring, made, tmp_path):
    """Blender keeps paths as UTF-8."""
    project = some_frames(made, tmp_path, ["IMG_0000"])
    folder = tmp_path / os.fsdecode(b"p\xff")
    folder.mkdir()
    shutil.copy(made / "pictures" / "IMG_0000.exr", folder)
    shutil.copy(made / "mesh.obj", folder)
    assert "its name is not UTF-8" in bring(project, images=folder, code=3)
    assert "its name is not UTF-8" in bring(project, mesh=folder / "mesh.obj", code=3)


def test_other_mistakes(bring, made, irpso_here, tmp_path):
    done = irpso_here("import", made / "transforms.json", "--images", made / "pictures", "--out", tmp_path / "a.txt")
    assert done.returncode == 3 and done.stderr.strip() == (
        f"irpso: {tmp_path / 'a.txt'}: must end in .blend; change --out")
    done = irpso_here("import", made / "transforms.json", "--images", made / "pictures", "--out", tmp_path / "a.blend",
                      "--rig", "lamps", "--grey", "IMG_0000.exr", 60, 40, 6, 0.18)
    assert done.returncode == 3 and "--grey: sets the power of the flash, and --rig lamps brings no lamp" in done.stderr
    project = some_frames(made, tmp_path, ["IMG_0000"])
    shutil.copy(made / "mesh.obj", tmp_path / "other.obj")
    done = irpso_here("import", project, "--images", made / "pictures", "--out", tmp_path / "new" / "a.blend")
    assert done.returncode == 3 and "has several meshes beside it: mesh.obj, other.obj;" in done.stderr
    assert not (tmp_path / "new").exists()


def test_no_file_is_replaced(made, irpso_here, tmp_path):
    """Refused before anything is read, also where the name is that of a link to nothing."""
    for out in (tmp_path / "a.blend", tmp_path / "b.blend"):
        if out.stem == "a":
            out.write_bytes(b"work of days")
        else:
            out.symlink_to(tmp_path / "nowhere")
        done = irpso_here("import", made / "transforms.json", "--images", made / "pictures", "--out", out)
        assert done.returncode == 3 and done.stderr.strip() == (
            f"irpso: {out}: already exists, and an import replaces no file; change --out, or move the file away")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.blend", "b.blend"]
    assert (tmp_path / "a.blend").read_bytes() == b"work of days"


def test_oiio_writes_the_orientation(tmp_path):
    """Else the portraits above would test nothing."""
    path = save(tmp_path / "a.tif", np.zeros((4, 6, 3), np.float32), "uint16", Orientation=6)
    assert oiio.ImageInput.open(str(path)).spec().get_int_attribute("Orientation") == 6
