"""AliceVision's .sfm in all its versions, and transforms.json."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.shoot.project_file import read_project
from tests.support.project_checks import BROWN, INTRINSICS, PLAIN, SENSOR, agrees, kannala, opencv, refused
from tests.support.project_files import Shot, ring, write_alicevision, write_transforms


@pytest.mark.parametrize("version", INTRINSICS)
def test_alicevision_projects_in_every_version(tmp_path, version):
    """Its pixels have whole coordinates at their centres; its meshes are turned half round x from 1.2.3 on."""
    intrinsic, fy = INTRINSICS[version]
    shots = ring(4)
    path = write_alicevision(tmp_path / "cameras.sfm", shots, version,
                             {**SENSOR, **intrinsic, "distortionParams": BROWN},
                             [{"viewId": "1", "poseId": "1", "intrinsicId": "55", "path": "lost.jpg"},
                              {"viewId": "2", "poseId": "100", "intrinsicId": "55", "path": "rig.jpg", "rigId": "3",
                               "subPoseId": "0"}])
    project = read_project(path)
    turned = version in ("1.2.3", "1.2.6", "1.2.8", "1.2.11")

    def pixel(shot, point):
        x, y = opencv(shot, point * [1, -1, -1] if turned else point, BROWN[:3], (BROWN[3], BROWN[4]))
        return 3010 + 5000 * x + 0.5, 1990 + fy * y + 0.5

    agrees(project, shots, pixel)
    assert [name for name, _ in project.left_out] == ["lost.jpg", "rig.jpg"] and not project.warnings


@pytest.mark.parametrize(("version", "kind", "values"), [
    ("1.0.0", "pinhole", []), ("1.0.0", "radial1", [-0.1]), ("1.0.0", "radial3", [-0.1, 0.05, -0.01]),
    ("1.0.0", "fisheye4", [0.1, -0.02, 0.003, 0.001]), ("1.2.8", "none", []), ("1.2.8", "radialk1", [-0.1]),
    ("1.2.8", "radialk3", [-0.1, 0.05, -0.01]), ("1.2.8", "fisheye", [0.1, -0.02, 0.003, 0.001]),
])
def test_alicevision_distortions(tmp_path, version, kind, values):
    named = {"type": kind} if version == "1.0.0" else {"type": "pinhole", "distortionType": kind,
                                                       "undistortionType": "none"}
    focal = {"pxFocalLength": 5000.0} if version == "1.0.0" else {"focalLength": 30.0}
    middle = [3000.0, 2000.0] if version == "1.0.0" else [0.0, 0.0]
    shots = ring(3)
    project = read_project(write_alicevision(tmp_path / "a.json", shots, version, {
        **SENSOR, **named, **focal, "principalPoint": middle, "distortionParams": values}))

    def pixel(shot, point):
        point = point * ([1, 1, 1] if version == "1.0.0" else [1, -1, -1])
        x, y = kannala(shot, point, values) if "fisheye" in kind else opencv(shot, point, values)
        return 3000.5 + 5000 * x, 2000.5 + 5000 * y

    agrees(project, shots, pixel)


@pytest.mark.parametrize(("version", "change", "words"), [
    ("1.0.0", {"type": "fisheye1", "distortionParams": [0.1]}, "fisheye1"),
    ("1.0.0", {"type": "3deanamorphic4"}, "3deanamorphic4"), ("1.2.8", {"type": "equidistant"}, "equidistant"),
    ("1.2.8", {"undistortionType": "3deradial4"}, "3deradial4"), ("2.0.0", {}, "version 2"),
    ("1.2.8", {"sensorWidth": 0.0}, "sensorWidth"), ("1.2.8", {"focalLength": "nan"}, "'nan'"),
    ("1.2.8", {"focalLength": -1}, "focal length"), ("1.2.8", {"width": "x"}, "width"),
    ("1.2.8", {"distortionParams": [1, 2]}, "2 numbers, not 5"), ("1.0.0", {"type": "brown"}, "pxFocalLength"),
])
def test_alicevision_refuses(tmp_path, version, change, words):
    intrinsic, _ = INTRINSICS["1.2.8"]
    refused(write_alicevision(tmp_path / "a.sfm", ring(2), version, {
        **SENSOR, **intrinsic, "distortionParams": BROWN, **change}), words)


def test_a_binary_sfm_is_refused_with_what_to_do(tmp_path):
    (tmp_path / "a.sfm").write_bytes(b"\x1c\0\0\0ASFM" + bytes(40))
    refused(tmp_path / "a.sfm", "binary", "ConvertSfMFormat")


def at(x: float, y: float, fx: float = 5000.0, fy: float = 5010.0) -> tuple[float, float]:
    return 3010 + fx * x, 1990 + fy * y


def placed(shots: list[Shot]) -> list[Shot]:
    return [replace(shot, name=f"images/{shot.name}") for shot in shots]


@pytest.mark.parametrize("where", ["shared", "own", "listed"])
def test_transforms_project_as_nerfstudio_says(tmp_path, where):
    shots = ring(4)
    lens = PLAIN | {"camera_model": "OPENCV"}
    if where == "listed":
        lens = {key: value for key, value in lens.items() if key[0] not in "kp"}
        lens["distortion_params"] = [-0.1, 0.05, 0.0, 0.0, 0.001, -0.002]
    path = write_transforms(tmp_path / "transforms.json", shots, lens if where == "shared" else {"k1": 9.0},
                            lens if where != "shared" else None)
    agrees(read_project(path), placed(shots), lambda s, p: at(*opencv(s, p, [-0.1, 0.05], (0.001, -0.002))))
    assert read_project(tmp_path).kind == "transforms.json"  # the folder will do


@pytest.mark.parametrize("named", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_transforms_of_a_fisheye(tmp_path, named):
    shots, k = ring(3), [0.1, -0.02, 0.003, 0.001]
    lens = {key: value for key, value in PLAIN.items() if key[0] not in "kp"}
    path = write_transforms(tmp_path / "t.json", shots, {**lens, **named, **dict(zip(["k1", "k2", "k3", "k4"], k,
                                                                                      strict=True))})
    agrees(read_project(path), placed(shots), lambda s, p: at(*kannala(s, p, k)))


def test_transforms_with_an_angle_take_the_pictures_size(tmp_path):
    """As the synthetic scenes of NeRF have it: one angle, names without suffix, no size."""
    shots = ring(3, suffix="")
    path = write_transforms(tmp_path / "transforms_train.json", shots, {"camera_angle_x": 0.6911112070083618})
    project = read_project(path, lambda name: (800, 600))
    focal = 400 / math.tan(0.6911112070083618 / 2)

    def pixel(shot, point):
        x, y = opencv(shot, point, [])
        return 400 + focal * x, 300 + focal * y

    agrees(project, placed(shots), pixel)
    refused(path, "IMG_0000", "size")


def test_one_lens_that_cannot_be_used_leaves_out_its_pictures_alone(tmp_path):
    path = write_transforms(tmp_path / "t.json", ring(3), PLAIN)
    content = json.loads(path.read_text())
    content["frames"][1]["camera_model"] = "EQUIRECTANGULAR"
    path.write_text(json.dumps(content))
    project = read_project(path)
    assert len(project.cameras) == 2
    assert project.left_out == (("images/IMG_0001.jpg", "its camera model EQUIRECTANGULAR cannot be used; write it "
                                 "with OPENCV or OPENCV_FISHEYE"),)
    intrinsic, _ = INTRINSICS["1.2.8"]
    path = write_alicevision(tmp_path / "a.sfm", ring(3), "1.2.8", {**SENSOR, **intrinsic, "distortionParams": BROWN})
    content = json.loads(path.read_text())
    content["intrinsics"].append(content["intrinsics"][0] | {"intrinsicId": "56", "type": "equidistant"})
    content["views"][2]["intrinsicId"] = "56"
    path.write_text(json.dumps(content))
    project = read_project(path)
    assert len(project.cameras) == 2 and [name for name, _ in project.left_out] == ["IMG_0002.jpg"]
    assert project.left_out[0][1].startswith("its camera model 'equidistant brown none' cannot be used; ")


def test_transforms_state_masks(tmp_path):
    path = write_transforms(tmp_path / "t.json", ring(2), PLAIN)
    content = json.loads(path.read_text())
    content["frames"][0]["mask_path"] = "alpha/m_1.png"
    path.write_text(json.dumps(content))
    assert [camera.mask for camera in read_project(path).cameras] == [tmp_path / "alpha" / "m_1.png", None]


def test_transforms_warn_of_cameras_that_were_moved(tmp_path):
    still, moved = np.eye(4)[:3].tolist(), [[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0]]
    for applied, warned in ((still, False), (moved, True)):
        path = write_transforms(tmp_path / "t.json", ring(2), {**PLAIN, "applied_transform": applied})
        assert ("applied_transform" in "".join(read_project(path).warnings)) == warned


@pytest.mark.parametrize(("change", "own", "words"), [
    ({"camera_model": "EQUIRECTANGULAR"}, {}, "EQUIRECTANGULAR"), ({"fl_x": 0, "fl_y": 0}, {}, "focal length of 0"),
    ({"w": 0}, {}, "0 x 4000"), ({"w": 1.5}, {}, "1.5 x 4000"), ({"k1": "a"}, {}, "'a'"), ({"k1": True}, {}, "True"),
    ({"distortion_params": [1, 2]}, {}, "2 numbers"), ({}, {"file_path": 3}, "file_path"),
    ({}, {"file_path": "a\nb"}, "not a picture's name"), ({}, {"file_path": "a" * 2000}, "not a picture's name"),
    ({}, {"file_path": "a"}, "two"), ({}, {"mask_path": 3}, "mask_path"),
    ({}, {"transform_matrix": [[1, 0], [0, 1]]}, "4 numbers"), ({}, {"transform_matrix": "1 2 3"}, "3 numbers"),
    ({}, {"transform_matrix": (np.eye(4) * 1.01).tolist()}, "not a rotation"),
    ({}, {"transform_matrix": np.diag([-1, 1, 1, 1]).tolist()}, "not a rotation"),
    ({}, {"transform_matrix": np.full((4, 4), 10**400, object).tolist()}, "transform_matrix"),
    ({}, {"transform_matrix": [[1, 0, 0, 1e300], [0, 1, 0, 0], [0, 0, 1, 0]]}, "1e+300"),
    ({"applied_transform": 3}, {}, "applied_transform"),
])
def test_transforms_refuse(tmp_path, change, own, words):
    refused(write_transforms(tmp_path / "t.json", ring(2), {**PLAIN, **change}, own), words)


@pytest.mark.parametrize("text", [
    "{", "{}", '{"frames": []}', '{"frames": 3}', '{"views": 3, "version": ["1", "2", "3"]}', '{"graph": {}}',
    '{"views": [3], "intrinsics": []}', '{"a":' * 100_000, '{"views": [], "version": "x"}',
    '{"a": ' + "9" * 5000 + "}",
])
def test_other_json_is_refused(tmp_path, text):
    path = tmp_path / "t.json"
    path.write_text(text)
    refused(path)
