"""A scene small enough to solve in a second, with its answer: what `irpso doctor` tries on a machine.

A flat square with a colour ramp under a camera and sixteen lamps, drawn by the float64 twin of the BRDF.  It
proves driver, shaders and solver together; Blender and Cycles have no part in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..data import F32, F64, Camera, Light, MeshArrays, RadianceImage, SceneData, View
from ..shading.brdf import principled
from ..shading.lights import light_irradiance

PIXELS, TEXELS = 64, 48
EDGE = 1.1  # half the camera's width in metres; the square's is 1
ROUGHNESS = 0.4
HEIGHT = 2.5  # metres of the lamps above the square


@dataclass(frozen=True)
class SelfTest:
    """The scene, its images (no file exists), and the base colour at every texel."""

    scene: SceneData
    read_image: Callable[[View], RadianceImage]
    base_color: F32  # (texels, texels, 3) linear, row 0 bottom


def build(texels: int = TEXELS) -> SelfTest:
    """The whole test; texels: on a side of the maps that it is to be solved for."""
    camera = _camera()
    turns = 2.399963 * np.arange(16)  # the golden angle
    lamps = [_lamp(i, turn, 2.2 * np.sqrt((i + 0.5) / 16)) for i, turn in enumerate(turns)]
    views = tuple(View(Path(f"lamp {i}"), camera, (lamp,)) for i, lamp in enumerate(lamps))
    scene = SceneData("self-test", _square(), np.zeros((0, 3, 3), np.float32), views)
    centres = (np.arange(texels) + 0.5) / texels * 2 - 1
    x, y = np.meshgrid(centres, centres)
    return SelfTest(scene, _draw, _paint(x, y).astype(np.float32))


def _paint(x: F64, y: F64) -> F64:
    """Base colour at a point of the square."""
    return np.stack([0.5 + 0.3 * x, 0.4 + 0.2 * y, 0.3 + 0.1 * x * y], -1)


def _draw(view: View) -> RadianceImage:
    """What the camera sees: each pixel at its centre."""
    centres = EDGE * ((np.arange(PIXELS) + 0.5) / PIXELS * 2 - 1)
    x, y = np.meshgrid(centres, centres)
    points = np.stack([x, y, np.zeros_like(x)], -1)
    normals, towards_camera = np.broadcast_to([0.0, 0.0, 1.0], points.shape), np.array([0.0, 0.0, 1.0])
    lamp = view.lights[0]
    to_lamp = lamp.matrix[:3, 3] - points
    to_lamp /= np.linalg.norm(to_lamp, axis=-1, keepdims=True)
    inside = (abs(x) <= 1) & (abs(y) <= 1)
    reflected = principled(_paint(x, y), np.full(x.shape, ROUGHNESS), to_lamp, towards_camera, normals)
    irradiance = light_irradiance(lamp, points, normals)[..., None] * lamp.power
    radiance = reflected * irradiance * inside[..., None]
    return RadianceImage(radiance.astype(np.float32), inside.astype(np.float32), np.ones_like(inside))


def _camera() -> Camera:
    """Orthographic, straight above."""
    world_to_camera = np.eye(4)
    world_to_camera[2, 3] = -4.0
    return Camera(
        "above", world_to_camera, np.diag([1 / EDGE, 1 / EDGE, -0.1, 1.0]), np.array([0.0, 0.0, 4.0]),
        np.array([0.0, 0.0, -1.0]), orthographic=True, aspect=1.0)


def _lamp(index: int, turn: float, distance: float) -> Light:
    matrix = np.eye(4)
    matrix[:3, 3] = distance * np.cos(turn), distance * np.sin(turn), HEIGHT
    return Light(f"lamp {index}", "POINT", np.full(3, 100.0), matrix)


def _square() -> MeshArrays:
    """Two triangles from -1 to 1, UVs from 0 to 1."""
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)[[[0, 1, 2], [0, 2, 3]]]
    return MeshArrays(
        "Square", corners, np.broadcast_to(np.array([0, 0, 1], np.float32), corners.shape).copy(),
        ((corners[..., :2] + 1) / 2).astype(np.float32), np.zeros(2, np.int32), ("Paint",))
