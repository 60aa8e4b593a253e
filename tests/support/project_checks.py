"""What tests of project readers share: lenses, OpenCV's formulas, and comparison of pixels."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.shoot.project import Project, ProjectCamera
from irpso_addon.core.shoot.project_file import read_project
from tests.support.project_files import Shot, polynomial

POINTS = np.random.default_rng(5).uniform(-0.6, 0.6, (20, 3))  # world, about the origin at which all cameras look
PIXEL = 1e-6  # tolerance
AROUND = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])  # a rotation
# A 24 mm lens on 50 million pixels, as Metashape calibrated it for a museum; b1, b2 and k4 added.
WIDE = {"f": 5998.2593, "cx": 5.3306, "cy": -18.1234, "b1": -3.25, "b2": 1.5, "k1": -0.10746863, "k2": 0.10306167,
        "k3": -0.01342632, "k4": 0.001, "p1": -0.00019654584, "p2": 0.00046072909}
OPENCV = ("OPENCV", 6000, 4000, [5000.0, 5010.0, 3010.0, 1990.0, -0.1, 0.05, 0.001, -0.002])
ALL = ["name", "x", "y", "alt", "heading", "pitch", "roll", "f", "px", "py", "k1", "k2", "k3", "k4", "t1", "t2"]
ROW = {"name": "a.jpg", "x": 4.5, "y": -1.25, "alt": 2.0, "heading": 170.25, "pitch": 85.5, "roll": -22.75,
       "f": 24.5, "px": -9.482e-4, "py": 2.446e-3, "k1": 0.0311, "k2": -0.0402, "k3": 0.0179, "k4": 0.002,
       "t1": 0.0003, "t2": -0.0004}
SENSOR = {"width": 6000, "height": 4000, "sensorWidth": 36.0, "sensorHeight": 24.0}
BROWN = [-0.1, 0.05, -0.01, 0.001, -0.002]
MIDDLE = [10.0, -10.0]  # the principal point, from the middle
INTRINSICS = {  # file version: an intrinsic of fx 5000, fy 5010, principal point (3010, 1990) in AliceVision's pixels
    "1.0.0": ({"type": "brown", "pxFocalLength": 5000.0, "principalPoint": [3010.0, 1990.0]}, 5000.0),
    "1.2.0": ({"type": "brown", "pxFocalLength": [5000.0, 5010.0], "principalPoint": [3010.0, 1990.0]}, 5010.0),
    "1.2.1": ({"type": "brown", "pxFocalLength": [5000.0, 5010.0], "principalPoint": MIDDLE}, 5010.0),
    "1.2.3": ({"type": "brown", "focalLength": 30.0, "pixelRatio": 5000 / 5010, "principalPoint": MIDDLE}, 5010.0),
    "1.2.6": ({"type": "brown", "focalLength": 30.0, "pixelRatio": 5010 / 5000, "principalPoint": MIDDLE}, 5010.0),
    "1.2.8": ({"type": "pinhole", "distortionType": "brown", "undistortionType": "none", "focalLength": 30.0,
               "pixelRatio": 5010 / 5000, "principalPoint": MIDDLE}, 5010.0),
    "1.2.11": ({"type": "pinhole", "distortionType": "brown", "undistortionType": "none", "focalLength": 30.06,
                "pixelRatio": 5010 / 5000, "principalPoint": MIDDLE}, 5010.0),
}
PLAIN = {"w": 6000, "h": 4000, "fl_x": 5000.0, "fl_y": 5010.0, "cx": 3010.0, "cy": 1990.0, "k1": -0.1, "k2": 0.05,
         "p1": 0.001, "p2": -0.002}


def seen(camera: ProjectCamera, points: np.ndarray = POINTS) -> np.ndarray:
    """Pixels of world points by what was read."""
    world = camera.world_from_camera
    assert np.abs(world[:3, :3].T @ world[:3, :3] - np.eye(3)).max() < 1e-12
    assert world[3].tolist() == [0, 0, 0, 1]
    return camera.lens.project((points - world[:3, 3]) @ world[:3, :3])


def opencv(shot: Shot, point: np.ndarray, k: list[float], p: tuple[float, float] = (0.0, 0.0)) -> tuple[float, float]:
    """x', y' by OpenCV's documentation."""
    x, y, z = shot.rotation.T @ (point - shot.place)
    x, y = x / z, y / z
    r = math.hypot(x, y)
    return (x * polynomial(k, r) + 2 * p[0] * x * y + p[1] * (r * r + 2 * x * x),
            y * polynomial(k, r) + p[0] * (r * r + 2 * y * y) + 2 * p[1] * x * y)


def kannala(shot: Shot, point: np.ndarray, k: list[float]) -> tuple[float, float]:
    """x', y' of OpenCV's fisheye."""
    x, y, z = shot.rotation.T @ (point - shot.place)
    theta = math.acos(z / math.sqrt(x * x + y * y + z * z))
    bent = theta * polynomial(k, theta) / math.hypot(x, y)
    return x * bent, y * bent


def agrees(project: Project, shots: list[Shot], pixel, points: np.ndarray = POINTS) -> None:
    """Each camera sees each point where ``pixel`` (shot, point) says."""
    assert [camera.name for camera in project.cameras] == [shot.name for shot in shots]
    for camera, shot in zip(project.cameras, shots, strict=True):
        expected = np.array([pixel(shot, point) for point in points])
        assert not np.isnan(expected).any()
        assert np.abs(seen(camera, points) - expected).max() < PIXEL


def refused(path: Path, *words: str, size_of=None) -> str:
    with pytest.raises(BadInput) as caught:
        read_project(path, size_of)
    message = str(caught.value)
    assert "\n" not in message and "; " in message
    assert [word for word in words if word not in message] == [], message
    return message
