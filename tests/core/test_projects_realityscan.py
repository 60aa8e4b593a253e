"""RealityScan's CSV against its documented angles and lens."""

from __future__ import annotations

import math

import numpy as np
import pytest

from irpso_addon.core.shoot.project_file import read_project
from tests.support.project_checks import ALL, PIXEL, POINTS, ROW, refused, seen
from tests.support.project_files import polynomial, write_realityscan


def rotated(vector: np.ndarray, axis: int, degrees: float) -> np.ndarray:
    """By a quaternion q v q*, w + (x, y, z)."""
    half = math.radians(degrees) / 2
    w, u = math.cos(half), np.eye(3)[axis] * math.sin(half)
    return vector + 2 * np.cross(u, np.cross(u, vector) + w * vector)


def realityscan_pixel(row: dict[str, float], size: tuple[int, int], point: np.ndarray) -> tuple[float, float]:
    away = point - [row["x"], row["y"], row["alt"]]
    for axis, angle in ((2, row["heading"]), (0, -row["pitch"]), (1, -row["roll"])):
        away = rotated(away, axis, angle)
    x, y = away[0] / -away[2], -away[1] / -away[2]  # that camera looks along -z, with y up
    r = math.hypot(x, y)
    radial = polynomial([row.get(f"k{n}", 0.0) for n in (1, 2, 3, 4)], r)
    t1, t2 = row.get("t1", 0.0), row.get("t2", 0.0)
    u = x * radial + t2 * (r * r + 2 * x * x) + 2 * t1 * x * y
    v = y * radial + t1 * (r * r + 2 * y * y) + 2 * t2 * x * y
    longer = max(size)
    return (longer * (row["f"] / 36 * u + row.get("px", 0.0)) + size[0] / 2,
            longer * (row["f"] / 36 * v + row.get("py", 0.0)) + size[1] / 2)


@pytest.mark.parametrize("size", [(6000, 4000), (4000, 6000)])
@pytest.mark.parametrize("columns", [ALL, ALL[:8], [*ALL[7:], *ALL[:7]]], ids=["all", "pose", "other order"])
def test_realityscan_projects_as_documented(tmp_path, size, columns):
    rows = [ROW, ROW | {"name": "sub/b.jpg", "heading": -20, "pitch": 3, "roll": 120, "x": 0, "y": 0, "alt": 6}]
    rows = [{column: row[column] for column in columns} for row in rows]
    project = read_project(write_realityscan(tmp_path / "r.csv", rows, columns, counted=columns is ALL),
                           {"a.jpg": size, "sub/b.jpg": size}.__getitem__)
    assert project.kind == "RealityScan"
    for camera, row in zip(project.cameras, rows, strict=True):
        ahead = camera.world_from_camera[:3, 3] + 5 * camera.world_from_camera[:3, 2]
        points = ahead + POINTS
        assert camera.name == row["name"]
        assert np.abs(seen(camera, points) - [realityscan_pixel(row, size, point) for point in points]).max() < PIXEL


def test_a_name_may_begin_as_comments_do(tmp_path):
    rows = [ROW, ROW | {"name": "#2 left.jpg"}]
    project = read_project(write_realityscan(tmp_path / "r.csv", rows, ALL, counted=True), lambda name: (6000, 4000))
    assert [camera.name for camera in project.cameras] == ["a.jpg", "#2 left.jpg"]


@pytest.mark.parametrize("separator", [";", "\t"])
@pytest.mark.parametrize("quote", ["", '"'])
@pytest.mark.parametrize("decimal", [",", "."])
def test_realityscan_saved_again_by_a_spreadsheet(tmp_path, separator, quote, decimal):
    """As in countries whose decimals follow a comma; names keep theirs."""
    rows = [ROW | {"name": "a, left.jpg"}, ROW | {"name": "b.jpg", "heading": -20}]
    write_realityscan(tmp_path / "plain.csv", [row | {"name": row["name"].replace(",", "")} for row in rows], ALL)
    plain = read_project(tmp_path / "plain.csv", lambda name: (6000, 4000))
    cells = [[row["name"], *(str(row[key]).replace(".", decimal) for key in ALL[1:])] for row in rows]
    lines = [separator.join(f"{quote}{cell}{quote}" for cell in line) for line in (["#name", *ALL[1:]], *cells)]
    (tmp_path / "r.csv").write_text("\ufeff" + "\r\n".join(lines) + "\r\n", encoding="utf-8", newline="")
    project = read_project(tmp_path / "r.csv", lambda name: (6000, 4000))
    assert [camera.name for camera in project.cameras] == ["a, left.jpg", "b.jpg"]
    for camera, other in zip(project.cameras, plain.cameras, strict=True):
        assert camera.lens == other.lens and (camera.world_from_camera == other.world_from_camera).all()


def test_realityscan_columns_of_other_exports_are_named(tmp_path):
    for columns, words in ((["name", "x", "y", "alt", "yaw", "pitch", "roll", "f"], "'yaw' instead of 'heading'"),
                           (["name", "x", "y", "z", "omega", "phi", "kappa"], "no column 'alt'"),
                           (["name", "x", "y", "alt"], "no column 'heading'")):
        refused(write_realityscan(tmp_path / "r.csv", [dict.fromkeys(columns, 1)], columns), words)


def test_realityscan_angles_mean_compass_and_tilt(tmp_path):
    """Pitch 0 looks down with north up in the picture; pitch 90 and heading 90 look east with the sky above."""
    rows = [ROW | {"name": f"{angle}.jpg", "heading": angle, "pitch": angle, "roll": 0} for angle in (0, 90)]
    project = read_project(write_realityscan(tmp_path / "r.csv", rows, ALL), lambda name: (6000, 4000))
    down, east = (camera.world_from_camera[:3, :3].round(12).T.tolist() for camera in project.cameras)
    assert down == [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    assert east == [[0, -1, 0], [0, 0, -1], [1, 0, 0]]


@pytest.mark.parametrize(("rows", "columns", "words"), [
    ([ROW], ALL[:7], ["column 'f'"]), ([ROW | {"f": "wide"}], ALL, ["'a.jpg'", "f is 'wide'"]),
    ([], ALL, ["no camera"]), ([ROW, ROW], ALL, ["two cameras"]), ([ROW | {"x": "inf"}], ALL, ["x is 'inf'"]),
    ([ROW | {"f": -1}], ALL, ["focal"]), ([ROW | {"name": "a.jpg,1"}], ALL, ["17 columns"]),
    ([ROW | {"name": " "}], ALL, ["not a picture's name"]), ([ROW | {"name": '"'}], ALL, ["1 columns"]),
    ([ROW | {"name": '"' + "a" * 200_000}], ALL, ["not complete CSV"]),
])
def test_realityscan_refuses(tmp_path, rows, columns, words):
    refused(write_realityscan(tmp_path / "r.csv", rows, columns), *words, size_of=lambda name: (6000, 4000))


def test_realityscan_needs_the_pictures_sizes(tmp_path):
    refused(write_realityscan(tmp_path / "r.csv", [ROW], ALL), "'a.jpg'", "folder of the pictures")


def test_realityscan_with_the_wrong_folder_of_pictures(tmp_path):
    message = refused(write_realityscan(tmp_path / "r.csv", [ROW], ALL), size_of=lambda name: None)
    assert message == (f"{tmp_path / 'r.csv'}: the chosen folder has none of the project's pictures ('a.jpg'); choose "
                       "the folder of the pictures")
