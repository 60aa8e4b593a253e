"""Projects of every kind: speed, broken files, and what holds for all."""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from irpso_addon.core.errors import BadInput
from irpso_addon.core.shoot.project_file import read_project
from tests.support.project_checks import ALL, AROUND, BROWN, INTRINSICS, OPENCV, PLAIN, ROW, SENSOR, WIDE, refused, seen
from tests.support.project_files import (
    Shot,
    quaternion,
    ring,
    similarity,
    write_alicevision,
    write_colmap_binary,
    write_colmap_text,
    write_metashape,
    write_realityscan,
    write_transforms,
)


def write_any(kind: str, folder: Path, shots: list[Shot]) -> Path:
    """A project of each kind, and what to open."""
    if kind == "metashape":
        return write_metashape(folder / "c.xml", shots, WIDE, chunk=similarity(AROUND, np.ones(3), 2.0))
    if kind == "realityscan":
        rows = [ROW | {"name": shot.name, "heading": n} for n, shot in enumerate(shots)]
        return write_realityscan(folder / "c.csv", rows, ALL)
    if kind == "colmap text":
        return write_colmap_text(folder, shots, OPENCV)
    if kind == "colmap binary":
        return write_colmap_binary(folder, shots, OPENCV)
    if kind == "alicevision":
        return write_alicevision(folder / "c.sfm", shots, "1.2.8", {**SENSOR, **INTRINSICS["1.2.8"][0],
                                                                    "distortionParams": BROWN})
    return write_transforms(folder / "t.json", shots, {}, PLAIN)


KINDS = ["metashape", "realityscan", "colmap text", "colmap binary", "alicevision", "transforms"]
SIZE = (6000, 4000)


@pytest.mark.parametrize("kind", KINDS)
def test_four_hundred_cameras_take_less_than_a_second(tmp_path, kind):
    path = write_any(kind, tmp_path, ring(400))
    start = time.process_time()
    project = read_project(path, lambda name: SIZE)
    assert len(project.cameras) == 400 and time.process_time() - start < 1


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_a_file_holds_it_is_a_project_or_one_line(tmp_path, kind, data):
    path = write_any(kind, tmp_path, ring(2))
    files = sorted(each for each in ([path] if path.is_file() else path.iterdir()) if each.is_file())
    spoilt = data.draw(st.sampled_from(files))
    whole = bytearray(spoilt.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, max(0, len(whole) - 1)))
        end = start + data.draw(st.integers(0, 12))
        whole[start:end] = data.draw(st.sampled_from([b"", b"\0", b"<", b"nan", b"-", b"1e308", b"9" * 30, b'"', b"[",
                                                      b"}", b",", b"\xff\xfe", b"\n", b" ", bytes(whole[:40])]))
    spoilt.write_bytes(whole)
    try:
        project = read_project(path, lambda name: SIZE)
    except BadInput as error:
        assert "\n" not in str(error) and len(str(error)) < 700
    else:
        for camera in project.cameras:
            assert np.isfinite(camera.world_from_camera).all() and camera.lens.fx > 0


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "realityscan"])  # its angles are a rotation
def test_rounded_rotations_are_mended(tmp_path, kind):
    """Files with four digits: the pose that is read is rigid, and near."""
    shots = ring(3)
    rough = [replace(shot, rotation=shot.rotation.round(4)) for shot in shots]
    found, true = (read_project(write_any(kind, tmp_path, each)).cameras for each in (rough, shots))
    for one, other in zip(found, true, strict=True):
        assert np.abs(one.world_from_camera - other.world_from_camera).max() < 1e-3
        assert np.abs(seen(one) - seen(other)).max() < 3


def test_quaternions_of_the_tests_are_right():
    """The writers' own conversion, against turning vectors."""
    w, *u = quaternion(AROUND)
    for vector in np.eye(3):
        turned = vector + 2 * np.cross(u, np.cross(u, vector) + w * vector)
        assert np.abs(turned - AROUND @ vector).max() < 1e-12


def test_meshes_lie_beside_the_project(tmp_path):
    for name in ("b.obj", "a.PLY", "points.ply", "c.txt", "d.glb"):
        (tmp_path / name).write_bytes(b"ply\nelement face 3\n" if name == "a.PLY" else b"x")
    (tmp_path / "folder.obj").mkdir()
    project = read_project(write_any("metashape", tmp_path, ring(2)))
    assert [mesh.name for mesh in project.meshes] == ["a.PLY", "b.obj", "d.glb"]


def test_cameras_far_from_the_origin_are_told(tmp_path):
    shots = [replace(shot, place=shot.place + 4e6) for shot in ring(3)]
    for each, warned in ((shots, True), (ring(3), False)):
        project = read_project(write_any("transforms", tmp_path, each))
        assert ("single floats" in "".join(project.warnings)) == warned


def test_a_lens_that_turns_back_is_told(tmp_path):
    for k1, warned in ((-0.9, True), (-0.1, False), (-1e-200, False)):
        project = read_project(write_transforms(tmp_path / "t.json", ring(2), {**PLAIN, "fl_x": 3000.0, "fl_y": 3000.0,
                                                                               "k1": k1, "k2": 0.0}))
        assert ("reverses" in "".join(project.warnings)) == warned


def test_lenses_that_turn_back_are_told_in_one_line(tmp_path):
    """Of a project in which each picture has a lens of its own."""
    path = write_transforms(tmp_path / "t.json", ring(9), PLAIN)
    content = json.loads(path.read_text())
    for n, frame in enumerate(content["frames"]):
        frame |= {**PLAIN, "fl_x": 3000.0 + n, "fl_y": 3000.0, "k1": -0.9 if n else -0.1, "k2": 0.0}
    path.write_text(json.dumps(content))
    (line,) = read_project(path).warnings
    assert "and 5 more: the lens has a distortion that reverses" in line and "'" + ring(9)[0].name not in line


@pytest.mark.parametrize(("name", "words"), [
    ("a.psx", "Export Cameras"), ("a.rcproj", "RealityScan"), ("a.mg", "cameras.sfm"), ("a.abc", "is not a project"),
    ("database.db", "sparse model"), ("a.txt", "is not a project"), ("none.xml", "cannot be opened"),
])
def test_files_that_only_their_program_reads(tmp_path, name, words):
    if name != "none.xml":
        (tmp_path / name).write_bytes(b"whatever")
    refused(tmp_path / name, words)


def test_folders_and_pipes_are_refused(tmp_path):
    refused(tmp_path, "neither")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "a.xml")
        refused(tmp_path / "a.xml", "not a file")
    refused(Path("a\0b"), "not a path")


def test_an_utf8_mark_is_no_obstacle(tmp_path):
    for kind in ("metashape", "realityscan", "alicevision", "transforms"):
        path = write_any(kind, tmp_path, ring(2))
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
        assert len(read_project(path, lambda name: SIZE).cameras) == 2
    folder = write_any("colmap text", tmp_path, ring(2))
    for name in ("cameras.txt", "images.txt"):
        (folder / name).write_bytes(b"\xef\xbb\xbf" + (folder / name).read_bytes())
    assert len(read_project(folder).cameras) == 2


@pytest.mark.parametrize("kind", ["metashape", "realityscan", "alicevision", "transforms"])
def test_utf16_is_named(tmp_path, kind):
    path = write_any(kind, tmp_path, ring(2))
    text = path.read_text(encoding="utf-8")
    for encoding, mark in (("utf-16-le", b"\xff\xfe"), ("utf-16-be", b"\xfe\xff")):
        path.write_bytes(mark + text.encode(encoding))
        refused(path, "is UTF-16 text; save it as UTF-8")


def test_a_file_with_all_its_points_is_told(tmp_path):
    path = write_any("alicevision", tmp_path, ring(2))
    with open(path, "r+b") as file:
        file.truncate(64_000_001)
    refused(path, "is larger than 64 MB", "ConvertSfMFormat with Structure off")


def test_json_text_holds_no_numbers_that_are_not(tmp_path):
    """Python reads NaN and Infinity in JSON."""
    path = write_transforms(tmp_path / "t.json", ring(2), {**PLAIN, "cx": float("nan")})
    assert "NaN" in path.read_text() and json.loads(path.read_text())
    refused(path, "cx")
