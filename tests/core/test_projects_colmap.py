"""COLMAP's models, text and binary, against OpenCV's formulas."""

from __future__ import annotations

import math
import struct
from dataclasses import replace

import pytest

from irpso_addon.core.shoot.project_file import read_project
from tests.support.project_checks import OPENCV, agrees, kannala, opencv, refused
from tests.support.project_files import ring, write_colmap_binary, write_colmap_text

COLMAP = {
    "SIMPLE_PINHOLE": ([5000.0, 3010.0, 1990.0], lambda s, p: opencv(s, p, [])),
    "PINHOLE": ([5000.0, 5010.0, 3010.0, 1990.0], lambda s, p: opencv(s, p, [])),
    "SIMPLE_RADIAL": ([5000.0, 3010.0, 1990.0, -0.1], lambda s, p: opencv(s, p, [-0.1])),
    "RADIAL": ([5000.0, 3010.0, 1990.0, -0.1, 0.05], lambda s, p: opencv(s, p, [-0.1, 0.05])),
    "OPENCV": (OPENCV[3], lambda s, p: opencv(s, p, [-0.1, 0.05], (0.001, -0.002))),
    "FULL_OPENCV": ([*OPENCV[3], 0.02, 0.0, 0.0, 0.0], lambda s, p: opencv(s, p, [-0.1, 0.05, 0.02], (0.001, -0.002))),
    "OPENCV_FISHEYE": ([5000.0, 5010.0, 3010.0, 1990.0, 0.1, -0.02, 0.003, 0.001],
                       lambda s, p: kannala(s, p, [0.1, -0.02, 0.003, 0.001])),
    "SIMPLE_RADIAL_FISHEYE": ([5000.0, 3010.0, 1990.0, 0.1], lambda s, p: kannala(s, p, [0.1])),
    "RADIAL_FISHEYE": ([5000.0, 3010.0, 1990.0, 0.1, -0.02], lambda s, p: kannala(s, p, [0.1, -0.02])),
}


@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
@pytest.mark.parametrize("model", COLMAP)
def test_colmap_projects_as_opencv_says(tmp_path, model, write):
    values, flat = COLMAP[model]
    shots = [replace(shot, name=f"left cam/{shot.name}") for shot in ring(4)]
    project = read_project(write(tmp_path, shots, (model, 6000, 4000, values)))
    fx, fy = values[:2] if values[1] == 5010 else values[:1] * 2

    def pixel(shot, point):
        x, y = flat(shot, point)
        return 3010 + fx * x, 1990 + fy * y

    agrees(project, shots, pixel)
    assert project.kind == "COLMAP"


@pytest.mark.parametrize("model", [("FULL_OPENCV", 12), ("FOV", 5), ("THIN_PRISM_FISHEYE", 12)])
@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
def test_colmap_refuses_models_by_name(tmp_path, model, write):
    values = [5000.0, 5010.0, 3010.0, 1990.0, *[0.01] * (model[1] - 4)]
    refused(write(tmp_path, ring(2), (model[0], 6000, 4000, values)), "IMG_0000", model[0])


def test_colmap_is_found_in_its_workspace(tmp_path):
    (tmp_path / "dense").mkdir()
    (tmp_path / "meshed-poisson.ply").write_bytes(b"ply\nelement vertex 3\nelement face 1\nend_header\n")
    (tmp_path / "fused.ply").write_bytes(b"ply\nelement vertex 3\nend_header\n")
    folder = write_colmap_text(tmp_path / "sparse" / "0", ring(2), OPENCV)
    for start in (tmp_path, tmp_path / "sparse", folder, folder / "images.txt", folder / "cameras.txt"):
        project = read_project(start)
        assert (project.path, project.meshes) == (folder, (tmp_path / "meshed-poisson.ply",))


@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
def test_colmap_leaves_out_pictures_of_a_model_that_cannot_be_used(tmp_path, write):
    """An action camera of model FOV beside another: its pictures are named; alone they are refused."""
    shots = ring(4)
    write(tmp_path / "fov", shots[2:], ("FOV", 600, 400, [500.0, 500.0, 300.0, 200.0, 0.9]))
    assert "camera model FOV cannot be used; run the bundle" in refused(tmp_path / "fov", "IMG_0002")
    both = write(tmp_path / "both", shots, OPENCV)
    if write is write_colmap_text:
        with (both / "cameras.txt").open("a") as file:
            file.write("8 FOV 600 400 500.0 500.0 300.0 200.0 0.9\n")
        text = (both / "images.txt").read_text()
        (both / "images.txt").write_text(text.replace("7 IMG_0002", "8 IMG_0002").replace("7 IMG_0003", "8 IMG_0003"))
    else:
        cameras = (both / "cameras.bin").read_bytes()
        (both / "cameras.bin").write_bytes(struct.pack("<Q", 2) + cameras[8:] + struct.pack(
            "<IiQQ5d", 8, 7, 600, 400, 500.0, 500.0, 300.0, 200.0, 0.9))
        images = (both / "images.bin").read_bytes()
        for number in (2, 3):
            images = images.replace(struct.pack("<I", 7) + b"IMG_%04d" % number,
                                    struct.pack("<I", 8) + b"IMG_%04d" % number)
        (both / "images.bin").write_bytes(images)
    project = read_project(both)
    assert [camera.name for camera in project.cameras] == ["IMG_0000.jpg", "IMG_0001.jpg"]
    assert [name for name, _ in project.left_out] == ["IMG_0002.jpg", "IMG_0003.jpg"]
    assert all(why.startswith("its camera model FOV cannot be used; ") for _, why in project.left_out)


def test_other_models_are_told_of(tmp_path):
    """The mapper numbers them in the order of their making, not by size."""
    first = write_colmap_text(tmp_path / "sparse" / "0", ring(2), OPENCV)
    second = write_colmap_binary(tmp_path / "sparse" / "1", ring(5), OPENCV)
    for start in (tmp_path, tmp_path / "sparse"):
        project = read_project(start)
        assert len(project.cameras) == 2 and len(project.warnings) == 1
        assert "'0' is used: if another ('1') has more of the pictures, choose its folder" in project.warnings[0]
    assert not read_project(first).warnings and len(read_project(second).cameras) == 5


def test_colmap_cut_anywhere_is_refused(tmp_path):
    write_colmap_binary(tmp_path, ring(3), OPENCV)
    for name in ("cameras.bin", "images.bin"):
        whole = (tmp_path / name).read_bytes()
        for end in range(len(whole)):
            (tmp_path / name).write_bytes(whole[:end])
            refused(tmp_path, name)
        (tmp_path / name).write_bytes(whole)
    assert len(read_project(tmp_path).cameras) == 3


def one_image(w: float = 1.0, i: float = 0.0, x: float = 0.0, name: int = 1, points: int = 0) -> bytes:
    return struct.pack("<QI7dI", 1, 1, w, i, 0, 0, x, 0, 0, 7) + b"a" * name + b"\0" + struct.pack("<Q", points)


@pytest.mark.parametrize(("name", "data", "words"), [
    ("images.bin", struct.pack("<Q", 2**63), "states"), ("cameras.bin", struct.pack("<Q", 0), "camera 7 is not"),
    ("cameras.bin", struct.pack("<QIiQQ", 1, 7, 99, 1, 1), "model 99"), ("images.bin", one_image(name=9000), "an end"),
    ("images.bin", one_image(points=2**62), "too early"), ("images.bin", one_image(1.0, 1.0), "length 1.41"),
    ("images.bin", one_image(x=math.nan), "its pose"),
    ("images.bin", struct.pack("<Q", 0), "no camera with a pose"),
])
def test_colmap_binary_refuses(tmp_path, name, data, words):
    write_colmap_binary(tmp_path, ring(3), OPENCV)
    (tmp_path / name).write_bytes(data)
    refused(tmp_path, words)


@pytest.mark.parametrize(("name", "text", "words"), [
    ("cameras.txt", "7 OPENCV 10 10 1 1\n", "unknown"), ("cameras.txt", "7 OPENCV\n", "not a camera"),
    ("cameras.txt", "-7 PINHOLE 10 10 1 1 1 1\n", "'-7'"), ("cameras.txt", "7 PINHOLE 10 10 x 1 1 1\n", "fx is 'x'"),
    ("images.txt", "1 1 0 0 0 0 0 0 7\n", "not an image"), ("images.txt", "", "no camera with a pose"),
    ("images.txt", "1 1 0 0 0 0 0 0 7 a.jpg\n\n2 1 0 0 0 0 0 0 7 a.jpg", "two cameras"),
    ("images.txt", "\udcff", "UTF-8"),
])
def test_colmap_text_refuses(tmp_path, name, text, words):
    write_colmap_text(tmp_path, ring(2), OPENCV)
    (tmp_path / name).write_text(text, errors="surrogateescape")
    refused(tmp_path, words)
