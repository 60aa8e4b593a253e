"""Photogrammetry projects as their programs write them, from cameras given as plain numbers.

Written from the formats' descriptions, without the readers' code.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Shot:
    """A picture and its pose; axes of the camera x right, y down, z forward."""

    name: str
    rotation: np.ndarray  # (3, 3) camera to world
    place: np.ndarray  # (3,)


def ring(count: int, suffix: str = ".jpg", seed: int = 0) -> list[Shot]:
    """Cameras about the origin that look nearly at it, none of them level."""
    rng = np.random.default_rng(seed)
    return [_shot(f"IMG_{number:04d}{suffix}", rng) for number in range(count)]


def _shot(name: str, rng: np.random.Generator) -> Shot:
    place = rng.normal(size=3)
    place *= (4 + rng.uniform()) / np.linalg.norm(place)
    forward = -place + rng.normal(size=3) * 0.1
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, rng.normal(size=3))
    right /= np.linalg.norm(right)
    return Shot(name, np.column_stack([right, np.cross(forward, right), forward]), place)


def write_metashape(path: Path, shots: list[Shot], calibration: dict[str, float], **parts: Any) -> Path:
    """A camera XML of one sensor.

    ``parts``: size, kind (frame or fisheye), chunk (a transform element's content), components (an element), reference,
    attributes (of each camera), sensor (a whole element instead of the usual one), more (after the cameras).
    """
    width, height = parts.get("size", (8688, 5792))
    kind, chunk = parts.get("kind", "frame"), parts.get("chunk")
    numbers = "".join(f"<{key}>{value!r}</{key}>" for key, value in calibration.items())
    sensor = parts.get("sensor") or (
        f'<sensor id="0" label="a lens" type="{kind}"><resolution width="{width}" height="{height}"/>'
        f'<calibration type="{kind}" class="initial"><resolution width="{width}" height="{height}"/><f>1.0</f>'
        f'</calibration><calibration type="{kind}" class="adjusted"><resolution width="{width}" height="{height}"/>'
        f"{numbers}</calibration></sensor>")
    cameras = "".join(
        f'<camera id="{number}" sensor_id="0" {parts.get("attributes", "")} label="{shot.name}"><transform>'
        f"{' '.join(repr(float(value)) for value in _matrix(shot).ravel())}</transform></camera>"
        for number, shot in enumerate(shots))
    text = (f'<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0"><chunk label="Chunk 1" enabled="true">'
            f'<sensors next_id="1">{sensor}</sensors>{parts.get("components", "")}'
            f'<cameras next_id="{len(shots)}" next_group_id="0">{cameras}{parts.get("more", "")}</cameras>')
    text += f"<transform>{chunk}</transform>" if chunk else ""
    text += f"<reference>{parts['reference']}</reference>" if "reference" in parts else ""
    text += "</chunk></document>"
    path.write_text(text, encoding="utf-8")
    return path


def similarity(rotation: np.ndarray, translation: np.ndarray, scale: float | None) -> str:
    """The content of a Metashape transform."""
    text = f'<rotation locked="false">{" ".join(repr(float(value)) for value in rotation.ravel())}</rotation>'
    text += f'<translation locked="false">{" ".join(repr(float(value)) for value in translation)}</translation>'
    return text + (f'<scale locked="false">{scale!r}</scale>' if scale is not None else "")


def _matrix(shot: Shot) -> np.ndarray:
    return np.vstack([np.column_stack([shot.rotation, shot.place]), [0, 0, 0, 1]])


def write_realityscan(path: Path, rows: list[dict[str, Any]], columns: list[str], counted: bool = False) -> Path:
    lines = [f"#cameras {len(rows)}"] if counted else []
    lines += ["#" + ",".join(columns)] + [",".join(str(row[column]) for column in columns) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


COLMAP_NUMBERS = {
    "SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "OPENCV_FISHEYE": 5,
    "FULL_OPENCV": 6, "FOV": 7, "SIMPLE_RADIAL_FISHEYE": 8, "RADIAL_FISHEYE": 9, "THIN_PRISM_FISHEYE": 10,
}


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(w, x, y, z) of a rotation: the eigenvector to eigenvalue 1 of Bar-Itzhack's symmetric matrix (2000)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    matrix = np.array([[a - e - i, d + b, g + c, h - f], [d + b, e - a - i, h + f, c - g],
                       [g + c, h + f, i - a - e, d - b], [h - f, c - g, d - b, a + e + i]]) / 3
    x, y, z, w = np.linalg.eigh(matrix)[1][:, -1]
    return np.array([w, x, y, z]) * (1 if w >= 0 else -1)


def colmap_pose(shot: Shot) -> list[float]:
    """World to camera: quaternion and translation."""
    return [*quaternion(shot.rotation.T), *(-shot.rotation.T @ shot.place)]


def write_colmap_text(folder: Path, shots: list[Shot], camera: tuple[str, int, int, list[float]]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    model, width, height, values = camera
    (folder / "cameras.txt").write_text(
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        f"# Number of cameras: 1\n7 {model} {width} {height} {' '.join(map(repr, values))}\n")
    lines = ["# Image list with two lines of data per image:", "#   POINTS2D[] as (X, Y, POINT3D_ID)"]
    for number, shot in enumerate(shots):
        lines.append(f"{number + 1} {' '.join(repr(float(value)) for value in colmap_pose(shot))} 7 {shot.name}")
        lines.append("" if number % 2 else "2362.39 248.498 58396 1784.7 268.254 -1")
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    return folder


def write_colmap_binary(folder: Path, shots: list[Shot], camera: tuple[str, int, int, list[float]]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    model, width, height, values = camera
    (folder / "cameras.bin").write_bytes(
        struct.pack("<QIiQQ", 1, 7, COLMAP_NUMBERS[model], width, height) + struct.pack(f"<{len(values)}d", *values))
    data = struct.pack("<Q", len(shots))
    for number, shot in enumerate(shots):
        data += struct.pack("<I7dI", number + 1, *colmap_pose(shot), 7) + shot.name.encode() + b"\0"
        data += struct.pack("<Q", number % 3) + struct.pack("<ddq", 1.5, 2.5, -1) * (number % 3)
    (folder / "images.bin").write_bytes(data)
    return folder


def write_alicevision(path: Path, shots: list[Shot], version: str, intrinsic: dict[str, Any],
                      more: list[dict[str, Any]] | None = None) -> Path:
    """As boost writes it: every number is text.  ``more``: views without pose."""
    poses = [{"poseId": str(100 + number), "pose": {"locked": "0", "transform": {
        "rotation": [repr(float(value)) for value in shot.rotation.T.ravel(order="F")],
        "center": [repr(float(value)) for value in shot.place]}}} for number, shot in enumerate(shots)]
    views = [{"viewId": str(100 + number), "poseId": str(100 + number), "intrinsicId": "55", "path": shot.name,
              "metadata": ""} for number, shot in enumerate(shots)]
    path.write_text(json.dumps({"version": version.split("."), "views": [*views, *(more or [])],
                                "intrinsics": [{"intrinsicId": "55", **_texts(intrinsic)}], "poses": poses}))
    return path


def _texts(record: dict[str, Any]) -> dict[str, Any]:
    return {key: [str(each) for each in value] if isinstance(value, list) else str(value)
            for key, value in record.items()}


def write_transforms(path: Path, shots: list[Shot], shared: dict[str, Any],
                     own: dict[str, Any] | None = None) -> Path:
    frames = []
    for shot in shots:
        matrix = _matrix(shot)
        matrix[:, 1:3] = -matrix[:, 1:3]
        frames.append({"file_path": f"./images/{shot.name}", "transform_matrix": matrix.tolist(), **(own or {})})
    path.write_text(json.dumps({**shared, "frames": frames}))
    return path


def polynomial(values: list[float], r: float) -> float:
    """1 + k1 r^2 + k2 r^4 + ..."""
    return 1 + math.fsum(value * r ** (2 * power + 2) for power, value in enumerate(values))
